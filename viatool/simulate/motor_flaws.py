"""Motors and clocks within an error model: robots that follow late, slowly, too fast or aside, and are commanded so.

The velocity v of each part is drawn to ``w = u + e (relative |u| + absolute)``, e within -1 and 1, by
``v' = sign(w - v) min(a, |w - v| / tau)``. Commands are computed from observations that are up to `sensing` old and act
after the delay, so a command acts ``age + delay`` after its observation, and until the next one does. Everything may be
another one in every interval; e changes within it as well. Times are cut exactly where another command acts, and into
pieces of 10 ms at most, in which the velocity of the middle counts.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from viatool.arrays import Booleans, Floats, Indices
from viatool.motion.arcs import drive_arc
from viatool.motion.twists import HeldTwist
from viatool.uncertainty import ErrorModel

_FINE = 0.01
_FASTER = 4.0
"""Times the least acceleration that is drawn at most, where the model bounds it from below alone."""
_SOONER = 1e-3
"""Seconds that observations are apart at least."""


@dataclass(frozen=True, eq=False)
class MotorState:
    """E robots: poses and velocities (E, 3), W commands (E, W, A) with seconds (E, W) at which they act, and ages (E,).

    Seconds count from the present observation, which is `age` seconds old when its command is given.
    """

    poses: Floats
    velocity: Floats
    commands: Floats
    acts: Floats
    age: Floats

    def select(self, which: Any) -> MotorState:
        """Return some of the robots."""
        return MotorState(*(getattr(self, one.name)[which] for one in fields(self)))


@dataclass(frozen=True, eq=False)
class Choice:
    """What E robots do for one interval with what the model leaves open.

    Parameters
    ----------
    interval, delay, age : ndarray
        (E,) seconds until the next command is given, on which this one is under way, and of the next observation.
    rate, lag : ndarray
        (E, 2, 3) acceleration and deceleration, and (E, 3) time constants.
    errors, slip : ndarray
        (E, K, 3) and (E, K) within -1 and 1, in each of K parts of the interval.
    """

    interval: Floats
    delay: Floats
    age: Floats
    rate: Floats
    lag: Floats
    errors: Floats
    slip: Floats


@dataclass(frozen=True, eq=False)
class MotorFlaws:
    """How robots move that are not ideal.

    Parameters
    ----------
    kinematics : HeldTwist
        How velocities make paths.
    model : ErrorModel
        Its sections `actuation` and `timing`.
    interval, delay : float
        Control interval and dead time where the model does not say them, in seconds.
    """

    kinematics: HeldTwist
    model: ErrorModel
    interval: float
    delay: float

    @property
    def pending(self) -> int:
        """Return W, how many commands may be under way, with the one that acts."""
        _, age, delay = self._times
        return math.ceil((age[1] + delay[1]) / self._times[0][0]) + 2

    @property
    def _times(self) -> tuple[tuple[float, float], tuple[float, float], tuple[float, float]]:
        """Return from and to: interval, age, delay."""
        timing = self.model.timing
        delay = timing.delay or (self.delay, self.delay)
        return timing.interval or (self.interval, self.interval), (0.0, timing.sensing or 0.0), delay

    def at_rest(self, poses: Floats) -> MotorState:
        """Return robots that stand at (E, 3)."""
        count, axes = len(poses), len(self.kinematics.axes)
        acts = np.full((count, self.pending), -np.inf)
        return MotorState(
            poses, np.zeros((count, 3)), np.zeros((count, self.pending, axes)), acts, np.zeros(count)
        )

    def choose(self, robots: int, rng: np.random.Generator, *, corners: bool) -> Choice:
        """Draw what is left open: evenly, or at corners that last for the whole interval."""
        parts = 1 if corners else 5

        def share(*shape: int) -> Floats:
            return rng.integers(0, 2, shape).astype(float) if corners else rng.random(shape)

        def between(ends: tuple[float, float]) -> Floats:
            return ends[0] + (ends[1] - ends[0]) * share(robots)

        interval, age, delay = self._times
        low, high, lags = self._responses()
        return Choice(
            interval=between(interval),
            delay=between(delay),
            age=between(age),
            rate=low + (high - low) * share(robots, 2, 3),
            lag=lags[0] + (lags[1] - lags[0]) * share(robots, 3),
            errors=2.0 * share(robots, parts, 3) - 1.0,
            slip=2.0 * share(robots, parts) - 1.0,
        )

    def _responses(self) -> tuple[Floats, Floats, Floats]:
        """Return least and largest accelerations and decelerations, (2, 3) each, and lags (2, 3)."""
        actuation = self.model.actuation
        rates, lags = np.full((2, 2, 3), 1e9), np.zeros((2, 3))
        for number, axis in enumerate((actuation.linear, actuation.lateral, actuation.angular)):
            stated = (
                axis.acceleration,
                axis.acceleration if axis.deceleration is None else axis.deceleration,
            )
            for way, limit in enumerate(stated):
                if limit is not None:
                    ends = limit if isinstance(limit, tuple) else (limit, _FASTER * limit)
                    rates[:, way, number] = ends
            if axis.lag is not None:
                lags[:, number] = axis.lag
        return rates[0], rates[1], lags

    def give(self, state: MotorState, command: Floats, choice: Choice) -> MotorState:
        """Give commands (E, A) that were computed from the present observations."""
        acts = np.maximum(state.age + choice.delay, state.acts[:, 0])  # none overtakes the one before
        return replace(
            state,
            commands=np.concatenate([command[:, None], state.commands[:, :-1]], axis=1),
            acts=np.concatenate([acts[:, None], state.acts[:, :-1]], axis=1),
        )

    def follow(self, state: MotorState, choice: Choice) -> MotorState:
        """Move until the next observation."""
        age = np.minimum(choice.age, state.age + choice.interval - _SOONER)
        until = choice.interval + state.age - age
        parts, robots = choice.errors.shape[1], np.arange(len(until))
        pieces = parts * math.ceil(float(until.max()) / (parts * _FINE))
        grid = np.linspace(0.0, 1.0, pieces + 1) * until[:, None]
        edges = np.sort(np.concatenate([grid, np.clip(state.acts, 0.0, until[:, None])], axis=1), axis=1)
        poses, velocity = state.poses, state.velocity
        for begin, end in zip(edges.T[:-1], edges.T[1:], strict=True):
            middle, seconds = 0.5 * (begin + end), end - begin
            acting = (state.acts <= middle[:, None]).argmax(axis=1)  # the newest of those that act
            wanted = np.stack(self.kinematics.parts(state.commands[robots, acting]), axis=1)
            part = np.minimum((parts * middle / until).astype(int), parts - 1)
            target = wanted + choice.errors[robots, part] * self._error(wanted)
            half = _approach(velocity, target, 0.5 * seconds, choice)
            velocity = _approach(half, target, 0.5 * seconds, choice)
            poses = self._move(poses, half, seconds, choice.slip[robots, part])
        return replace(state, poses=poses, velocity=velocity, acts=state.acts - until[:, None], age=age)

    def _error(self, wanted: Floats) -> Floats:
        actuation = self.model.actuation
        axes = (actuation.linear, actuation.lateral, actuation.angular)
        relative, absolute = (
            np.array([getattr(axis, name) or 0.0 for axis in axes]) for name in ("relative", "absolute")
        )
        moves = [part in self.kinematics.velocity for part in ("ahead", "left", "turn")]
        return np.asarray((relative * np.abs(wanted) + absolute) * moves)

    def _move(self, poses: Floats, velocity: Floats, seconds: Floats, slip: Floats) -> Floats:
        aside = (self.model.actuation.slip or 0.0) * slip * np.hypot(velocity[:, 0], velocity[:, 1])
        return drive_arc(poses, velocity[:, 0], velocity[:, 2], seconds, velocity[:, 1] + aside)


def _approach(velocity: Floats, target: Floats, seconds: Floats, choice: Choice) -> Floats:
    """Follow targets (E, 3) for some seconds (E,): to rest by one limit, if that is between, and on by the other."""
    gap, time = target - velocity, np.broadcast_to(seconds[:, None], target.shape)
    speeding, slowing = choice.rate[:, 0], choice.rate[:, 1]
    turns = velocity * target < 0.0
    until = np.where(turns, np.minimum(_time_to(np.abs(gap), np.abs(target), slowing, choice.lag), time), 0.0)
    left = np.where(turns, _gap_after(np.abs(gap), until, slowing, choice.lag), np.abs(gap))
    rate = np.where(turns | (velocity * gap >= 0.0), speeding, slowing)
    return np.asarray(target - np.sign(gap) * _gap_after(left, time - until, rate, choice.lag))


def _gap_after(gap: Floats, seconds: Floats, rate: Floats, lag: Floats) -> Floats:
    """Return what is left of a gap that closes by ``min(rate, gap / lag)``."""
    ramp = np.clip(gap / rate - lag, 0.0, seconds)
    left, rest = np.maximum(gap - rate * ramp, 0.0), seconds - ramp
    fade = np.where(lag > 0.0, np.exp(-rest / np.where(lag > 0.0, lag, 1.0)), rest <= 0.0)
    return np.asarray(left * fade)


def _time_to(gap: Floats, smaller: Floats, rate: Floats, lag: Floats) -> Floats:
    """Return after how many seconds a smaller gap, above 0, is left."""
    linear = np.maximum(gap - np.maximum(rate * lag, smaller), 0.0) / rate
    soft = np.minimum(gap, np.maximum(rate * lag, smaller)) / np.where(smaller > 0.0, smaller, 1.0)
    return np.asarray(linear + lag * np.log(np.maximum(soft, 1.0)))


def chosen_of(states: Sequence[MotorState], which: Indices) -> MotorState:
    """Return of several outcomes the one of each robot that is named, (E,)."""
    robots = np.arange(len(which))
    stacked = (np.stack([getattr(state, one.name) for state in states]) for one in fields(MotorState))
    return MotorState(*(array[which, robots] for array in stacked))


def placed(state: MotorState, index: Indices | Booleans, begun: MotorState) -> MotorState:
    """Return the robots with some of them begun anew."""
    arrays = []
    for one in fields(MotorState):
        array = getattr(state, one.name).copy()
        array[index] = getattr(begun, one.name)
        arrays.append(array)
    return MotorState(*arrays)
