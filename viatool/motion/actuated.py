"""What a robot with real motors and real timing may do: the boxes of its velocity from the observation on.

Known are a box of the velocity that it has, boxes of the commands before, and the box of the new one. In every
*phase* (`Timing.phases`) the commands that may act draw the velocity to a target between the least and the greatest
of theirs; within these it follows `Actuation.extremes`, from the box with which the phase
before ended. Where the velocity was not measured, it was anything that the robot can have when the oldest command
that is known was surely the only one to act, and has followed the known ones since.

**Stopping.** From the time at which the robot may have begun to stop until it surely has, every part of its velocity
lies between 0 and what it would be without. Then it stops from the velocity that it has: no point within `rim`
decelerates by less than the robot's deceleration b, unless all of it does so as far as the turning speed has a limit
of its own,

    S = max((speed + rim turn) / b, turn / b_turn),

and all speeds fall at least in proportion to time, or faster: each part lies between 0 and ``1 - t / S`` of what it
was, for the largest S of the box, as that share grows with S. The way of turning is not assumed to be kept: anything
between 0 and that share of the turning speed may go with anything between 0 and that share of the speed. Motors with
a lag tau follow the brake late: the share falls by ``min(1 / S, share / tau)``, and has an endless tail. From a time
on that is the same for all commands of a state, the share is at most ``q e^(-t / tau)``; with the clock ``tau (1 -
e^(-t / tau))``, which runs from 0 to tau, the robot moves at no more than q of its speeds, so the tail is a stage of
tau seconds. It matters only where the robot is, not when.

**Standing.** What moves counts until the robot stands. One without a lag does at the end of its profile. One with a lag
never quite does; it is taken to stand when none of its points that count is faster than `STANDING`. At the time T at
which the tail begins, the share is at most q, so that the points are no faster than ``q (speed + rim turn)``, and since
that falls by ``e^(-t / tau)``, the robot stands from

    T + tau max(0, log(q (speed + rim turn) / STANDING))

on. In the tail, whose clock is another one, things have moved for as long as that.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viatool.arrays import Floats, Indices
from viatool.motion.actuation import Actuation, remaining
from viatool.motion.profile import VaryingMotion, VelocityProfile
from viatool.motion.timing import Phase, Timing
from viatool.motion.twists import HeldTwist
from viatool.rounding import SLIGHTLY_MORE

_STAGES = 4
"""In which the velocity settles within a phase as long as an interval."""
_STOPPING = 6
"""In which it falls to 0."""
STANDING = 0.01
"""m/s of its fastest point up to which a robot whose motors lag is taken to stand."""
_MOST_HISTORY = 30
"""Commands that tell of the velocity at most; a robot that is slower to forget is one of which less is known."""


@dataclass(frozen=True, eq=False)
class Machine:
    """A robot with motors and timing of its own.

    Parameters
    ----------
    kinematics : HeldTwist
        What a command is.
    limits : tuple of ndarray
        (A,) least and largest command that it carries out.
    actuation : Actuation
        How its motors follow.
    timing : Timing
        When commands act.
    deceleration : float or None
        m/s^2 at which it stops instead of receiving the next command; None when nothing is asked of it then.
    rim : float
        Metres to the outermost point whose deceleration counts.
    """

    kinematics: HeldTwist
    limits: tuple[Floats, Floats]
    actuation: Actuation
    timing: Timing
    deceleration: float | None = None
    rim: float = 0.0

    @property
    def history(self) -> int:
        """Return how many of the commands before count: those that may still act, and those that the velocity tells of.

        With so many the velocity has settled, whatever it was before them.
        """
        if self.actuation.at_once:
            return self.timing.commands
        whole = self.reachable
        needed = float(self.actuation.settling(whole, whole)) / self.timing.interval[0]
        return self.timing.commands + min(max(1, math.ceil(needed)), _MOST_HISTORY)

    @property
    def lag(self) -> float:
        """Return how late the motors follow the brake at most, in seconds."""
        return float(self.actuation.of("lag")[:, 1].max())

    @cached_property
    def reachable(self) -> tuple[Floats, Floats]:
        """Return the ends (3,) of the velocities that the robot can have."""
        return self.actuation.targets(*self.velocities(*self.limits))

    def velocities(self, lower: Floats, upper: Floats) -> tuple[Floats, Floats]:
        """Return the ends (..., 3) of the velocities that commands between ends (..., A) ask for."""
        parts = self.kinematics.parts
        return np.stack(parts(lower), axis=-1), np.stack(parts(upper), axis=-1)

    def stopping(self, velocity: Floats) -> Floats:
        """Return how long the robot takes at most to stop from velocities (..., 3), without a lag: more from more."""
        assert self.deceleration is not None
        motors = self.actuation.of("deceleration")[:, 0]
        brake = min(self.deceleration, motors[0], motors[1] if self.kinematics.slides else math.inf)
        speed, turn = np.hypot(velocity[..., 0], velocity[..., 1]), np.abs(velocity[..., 2])
        return np.asarray(np.maximum((speed + self.rim * turn) / brake, turn / motors[2]))


@dataclass(frozen=True, eq=False)
class _Lasting:
    """Paths (C,) that last as long as is said, whatever their speeds."""

    lasting: Floats

    @property
    def interval(self) -> float:
        """Return for how long a command acts at most."""
        return float(self.lasting.max(initial=0.0))

    def seconds(self, speed: Floats, turn: Floats) -> Floats:
        """See `viatool.motion.law.Timed`."""
        return self.lasting


@dataclass(frozen=True, eq=False)
class ActuatedMotion(VaryingMotion):
    """What B robots of one make may do.

    Parameters
    ----------
    machine : Machine
        What they have in common.
    before : tuple of ndarray
        (B, H, A) ends of the commands before, the oldest first; NaN where one is not known, and may be any. At least as
        many as may still act.
    velocity : tuple of ndarray, optional
        (B, 3) ends of the velocity at the observation, in the order of profiles; NaN where it is not known. None if it
        is not known of any.
    """

    machine: Machine
    before: tuple[Floats, Floats]
    velocity: tuple[Floats, Floats] | None = None

    def __len__(self) -> int:
        """Return B."""
        return len(self.before[0])

    def select(self, which: NDArray[Any]) -> ActuatedMotion:
        """Return some of the robots, with all that is known of them before any new command."""

        def of(ends: tuple[Floats, Floats]) -> tuple[Floats, Floats]:
            return ends[0][which], ends[1][which]

        found = replace(
            self, before=of(self.before), velocity=None if self.velocity is None else of(self.velocity)
        )
        stages, box = self._waiting
        stages = [_Stages(part.end[:, which], part.lower[:, which], part.upper[:, which]) for part in stages]
        known: dict[str, Any] = {
            "_waiting": (stages, of(box)),
            "observed": of(self.observed),
            "_older": of(self._older),
        }
        known |= {name: getattr(self, name)[which] for name in ("end", "longest", "stands")}
        known["phases"] = self.phases
        vars(found).update(known)
        return found

    @cached_property
    def phases(self) -> tuple[Phase, ...]:
        """Return what changes when."""
        machine = self.machine
        return machine.timing.phases(self.before[0].shape[1], stops=machine.deceleration is not None)

    @cached_property
    def end(self) -> Floats:
        """See `VaryingMotion.end`: after a stop from any velocity that the robot can have, or was measured to have."""
        last = np.full(len(self), self.machine.timing.last)
        if self.machine.deceleration is None:
            return last
        return last + self.machine.stopping(self._largest) * SLIGHTLY_MORE**8 + 3.0 * self._brake_lag

    @cached_property
    def stands(self) -> Floats:
        """See `VaryingMotion.stands`, and the module for why."""
        machine, lag, largest = self.machine, self._brake_lag, self._largest
        if machine.deceleration is None or lag == 0.0:
            return self.end
        speed = np.hypot(largest[:, 0], largest[:, 1]) * (1.0 + machine.actuation.slip)
        stop = machine.stopping(largest) * SLIGHTLY_MORE
        tail = self.end - lag
        with np.errstate(divide="ignore"):
            left = remaining(np.ones_like(stop), tail - machine.timing.last, 1.0 / stop, np.asarray(lag))
        pace = left * (speed + machine.rim * largest[:, 2]) * SLIGHTLY_MORE**4
        return np.asarray(tail + lag * np.log(np.maximum(pace / STANDING, 1.0)) * SLIGHTLY_MORE**4)

    def counted(self, state: Indices, until: Floats) -> Floats:
        """See `VaryingMotion.counted`: as long as the clock says, and in a tail until the robot stands."""
        if self.machine.deceleration is None or self._brake_lag == 0.0:
            return until
        tail = (self.end[state] - self._brake_lag) / SLIGHTLY_MORE
        return np.where(until < tail, until, self.stands[state])

    @cached_property
    def _largest(self) -> Floats:
        """Bounds of the size of each part of the velocity at every instant, (B, 3)."""
        ends = [*self.machine.reachable, *(self.velocity or ())]
        largest = np.zeros((len(self), 3))
        for end in ends:
            largest = np.fmax(
                largest, np.abs(end)
            )  # NaN where a velocity is not known, and is one of the others
        return largest

    def shares(self, lower: Floats, upper: Floats, seconds: Floats, rim: float) -> Floats:
        """See `VaryingMotion.shares`."""
        once = np.ones(len(lower))
        return self.machine.kinematics.deviation(lower, upper, once, rim, _Lasting(seconds)).shares

    def profile(self, state: Indices, lower: Floats, upper: Floats) -> VelocityProfile:
        """See `VaryingMotion.profile`, and the module for why."""
        stages, box = self._held(state, lower, upper)
        if self.machine.deceleration is not None:
            stages.append(self._stop(box, self.end[state] - self.machine.timing.last))
        ends, lows, highs = (
            np.concatenate([getattr(part, name) for part in stages]) for name in ("end", "lower", "upper")
        )
        edges = np.concatenate([np.zeros((1, len(state))), ends]).T
        largest = np.maximum(np.abs(lows), np.abs(highs))
        slip = self.machine.actuation.slip * SLIGHTLY_MORE * np.hypot(largest[..., 0], largest[..., 1])
        lows[..., 1] -= slip
        highs[..., 1] += slip
        return VelocityProfile(edges, lows.swapaxes(0, 1), highs.swapaxes(0, 1))

    def _held(
        self, state: Indices, lower: Floats, upper: Floats
    ) -> tuple[list[_Stages], tuple[Floats, Floats]]:
        """Follow some robots (C,) until the next command would act: stages, and the box of velocities then."""
        known, box = self._waiting
        stages = [_Stages(part.end[:, state], part.lower[:, state], part.upper[:, state]) for part in known]
        box = box[0][state], box[1][state]
        older = self._older[0][state], self._older[1][state]
        for phase in self.phases:
            if phase.end > 0.0 and 0 in phase.commands:
                added, box = self._follow(phase, box, self._targets(phase, older, (lower, upper)))
                stages.append(added)
        return stages, box

    @cached_property
    def _older(self) -> tuple[Floats, Floats]:
        """The commands before, any where one is not known; (B, H, A) each."""
        lower, upper = self.before
        known = np.isfinite(lower) & np.isfinite(upper)
        least, most = self.machine.limits
        return np.where(known, lower, least), np.where(known, upper, most)

    @cached_property
    def _waiting(self) -> tuple[list[_Stages], tuple[Floats, Floats]]:
        """What happens to all B robots before the new command may act: stages, and the box of velocities then."""
        stages, box = [], self.observed
        for phase in self.phases:
            if phase.end > 0.0 and 0 not in phase.commands:
                added, box = self._follow(phase, box, self._targets(phase, self._older, None))
                stages.append(added)
        return stages, box

    @cached_property
    def longest(self) -> Floats:
        """A bound of the length of all paths, whatever the command, (B,) metres; cheaper than that of profiles.

        The share that is left falls linearly for S, or with a lag tau; its integral is at most ``S / 2 + tau``.
        """
        machine, largest = self.machine, self._largest
        seconds = np.full(len(self), machine.timing.last)
        if machine.deceleration is not None:
            seconds = seconds + 0.5 * machine.stopping(largest) + self._brake_lag
        speed = np.hypot(largest[:, 0], largest[:, 1]) * (1.0 + machine.actuation.slip)
        return np.asarray(speed * seconds * SLIGHTLY_MORE)

    @cached_property
    def observed(self) -> tuple[Floats, Floats]:
        """The velocities that the robots may have at the observation, (B, 3) each."""
        least, most = self.machine.reachable
        box = np.broadcast_to(least, (len(self), 3)), np.broadcast_to(most, (len(self), 3))
        for phase in self.phases:
            if phase.end <= 0.0:
                _, box = self._follow(phase, box, self._targets(phase, self._older, None))
        if self.velocity is None:
            return box
        lower, upper = self.velocity
        known = np.isfinite(lower) & np.isfinite(upper)
        return np.where(known, lower, box[0]), np.where(known, upper, box[1])

    def _targets(
        self, phase: Phase, older: tuple[Floats, Floats], new: tuple[Floats, Floats] | None
    ) -> tuple[Floats, Floats]:
        """Return the ends (C, 3) of what velocities may be drawn to in a phase."""
        lower = [older[0][:, -k] for k in phase.commands if k]
        upper = [older[1][:, -k] for k in phase.commands if k]
        if 0 in phase.commands and new is not None:
            lower, upper = [*lower, new[0]], [*upper, new[1]]
        least, most = np.stack(lower).min(axis=0), np.stack(upper).max(axis=0)
        return self.machine.actuation.targets(*self.machine.velocities(least, most))

    def _follow(
        self, phase: Phase, box: tuple[Floats, Floats], target: tuple[Floats, Floats]
    ) -> tuple[_Stages, tuple[Floats, Floats]]:
        """Draw velocities (C, 3) towards targets for a phase: its stages, and the box at its end."""
        machine, length = self.machine, phase.end - phase.start
        motors = machine.actuation
        if phase.stopping:  # a brake that has taken hold may be slower than motors that follow
            once = np.array([response.at_once for response in motors.responses])
            target = (
                np.where(once, target[0], np.minimum(target[0], box[0])),
                np.where(once, target[1], np.maximum(target[1], box[1])),
            )
        settled = np.minimum(motors.settling(box, target), length)
        pieces = math.ceil(_STAGES * length / machine.timing.interval[1])
        if motors.at_once or phase.end <= 0.0:  # of the past the end alone is of interest
            pieces = 0
        shares = np.arange(pieces + 1)[:, None] / max(pieces, 1)
        after = np.concatenate([shares * settled, np.full((1, len(settled)), length)])  # (S + 1, C)
        lows, highs = motors.extremes(box, target, after[..., None])
        last = lows[-1], highs[-1]
        low, high = np.minimum(lows[:-1], lows[1:]), np.maximum(highs[:-1], highs[1:])
        if phase.stopping:
            low, high = np.minimum(low, 0.0), np.maximum(high, 0.0)
        return _Stages(phase.start + after[1:], low, high), last

    @property
    def _brake_lag(self) -> float:
        """Return how late motors follow the brake at most, in seconds."""
        return self.machine.lag

    def _stopping(self, box: tuple[Floats, Floats]) -> Floats:
        """Return how long robots take at most to stop from boxes of velocities, (C,) seconds, without a lag."""
        return self.machine.stopping(np.maximum(np.abs(box[0]), np.abs(box[1]))) * SLIGHTLY_MORE

    def _stop(self, box: tuple[Floats, Floats], longest: Floats) -> _Stages:
        """Stop from boxes of velocities, (C, 3), within the longest time of the states, (C,)."""
        lag = np.asarray(self._brake_lag)
        low, high = np.minimum(box[0], 0.0), np.maximum(box[1], 0.0)
        stop = self._stopping(box)
        after = (stop + 2.0 * lag) * (np.arange(_STOPPING + 1)[:, None] / _STOPPING)
        if lag > 0.0:
            after = np.concatenate([after, [longest - lag, longest]])
        with np.errstate(divide="ignore"):
            share = remaining(np.ones_like(after), after, 1.0 / stop, lag)[:-1] * SLIGHTLY_MORE
        share = np.minimum(share, 1.0)[..., None]
        return _Stages(self.machine.timing.last + after[1:], low * share, high * share)


@dataclass(frozen=True, eq=False)
class _Stages:
    """S stages of C profiles: their ends in seconds, (S, C), and velocities, (S, C, 3)."""

    end: Floats
    lower: Floats
    upper: Floats
