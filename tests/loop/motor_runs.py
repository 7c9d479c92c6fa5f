"""Robots with motors and clocks of their own in a closed loop, driven by everything that an error model allows.

No code is shared with the bounds: velocities are followed through their law in fine steps, cut where another command
acts, and poses by the middle of each step.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

Floats = np.ndarray
STEPS = 16
"""Fine steps of an interval, beside the cuts."""
NONE = (np.inf, np.inf)


@dataclass
class Motors:
    """What is allowed: parts are ahead, to the left, turning; pairs are from and to."""

    relative: tuple[float, float, float] = (0.0, 0.0, 0.0)
    absolute: tuple[float, float, float] = (0.0, 0.0, 0.0)
    slip: float = 0.0
    speeding: tuple[tuple[float, float], ...] = (NONE, NONE, NONE)
    slowing: tuple[tuple[float, float], ...] = (NONE, NONE, NONE)
    lag: tuple[tuple[float, float], ...] = ((0.0, 0.0),) * 3
    interval: tuple[float, float] = (0.1, 0.1)
    delay: tuple[float, float] = (0.0, 0.0)
    sensing: float = 0.0


@dataclass
class Robots:
    """R robots: poses (R, 3), velocities (R, 3), commands (R, Q, 3) with the times at which they act, newest first."""

    poses: Floats
    velocity: Floats
    commands: Floats
    acts: Floats
    age: Floats
    passed: list = field(default_factory=list)


class Oracle:
    """Choices of R runs: a third keep a corner, a third draw corners anew, a third draw anything."""

    def __init__(self, motors: Motors, runs: int, seed: int = 0) -> None:
        self.motors, self.runs = motors, runs
        self.generator = np.random.default_rng(seed)
        self.kind = self.generator.integers(0, 3, runs)
        self.corner = self.generator.integers(0, 2, (runs, 32)).astype(float)

    def share(self, number: int) -> Floats:
        other = self.generator.integers(0, 2, self.runs).astype(float)
        return np.choose(self.kind, [self.corner[:, number], other, self.generator.random(self.runs)])

    def between(self, ends: tuple[float, float], number: int) -> Floats:
        low, high = (min(end, 1e9) for end in ends)
        return low + self.share(number) * (high - low)

    def begin(self, poses: Floats, velocity: Floats, before: Floats) -> Robots:
        """Robots that have observed at a time when commands (R, Q, 3) were given, the newest first."""
        age, queue = self.between((0.0, self.motors.sensing), 0), before.shape[1]
        computed, acts = age.copy(), np.zeros((self.runs, queue))
        for back in range(queue):
            computed = computed - self.between(self.motors.interval, 1)
            acts[:, back] = computed + self.between(self.motors.delay, 2)
        acts = np.maximum.accumulate(acts[:, ::-1], axis=1)[:, ::-1]
        acts[:, -1] = -np.inf  # the oldest has acted for long
        return Robots(poses, velocity, before, acts, age)

    def follow(self, some: Robots, command: Floats) -> Robots:
        """Give commands (R, 3) and drive until the next observations."""
        m = self.motors
        acts = np.maximum(some.age + self.between(m.delay, 2), some.acts[:, 0])
        commands = np.concatenate([command[:, None], some.commands], axis=1)
        acts = np.concatenate([acts[:, None], some.acts], axis=1)
        passes = some.age + self.between(m.interval, 1)
        age = np.minimum(self.between((0.0, m.sensing), 0), passes)  # none is observed before the one before
        until = passes - age
        grid = np.linspace(0.0, 1.0, STEPS + 1) * until[:, None]
        edges = np.sort(np.concatenate([grid, np.clip(acts, 0.0, until[:, None])], axis=1), axis=1)
        v, poses, passed = some.velocity, some.poses, [some.poses]
        for start, end in zip(edges.T[:-1], edges.T[1:], strict=True):
            seconds, middle = end - start, 0.5 * (start + end)
            acting = (acts <= middle[:, None]).argmax(axis=1)
            told = commands[np.arange(self.runs), acting]
            half = self.motion(v, told, 0.5 * seconds)
            aside = (2.0 * self.share(3) - 1.0) * m.slip * np.hypot(half[:, 0], half[:, 1])
            poses = moved(poses, half + aside[:, None] * [0.0, 1.0, 0.0], seconds)
            v = self.motion(half, told, 0.5 * seconds)
            passed.append(poses)
        keep = some.commands.shape[1]
        return Robots(poses, v, commands[:, :keep], acts[:, :keep] - until[:, None], age, passed)

    def motion(self, v: Floats, told: Floats, seconds: Floats) -> Floats:
        """Follow ``v' = sign(w - v) min(a, |w - v| / tau)``."""
        m, after = self.motors, np.zeros_like(v)
        for part in range(3):
            u = told[:, part]
            w = u + (2.0 * self.share(4 + part) - 1.0) * (m.relative[part] * np.abs(u) + m.absolute[part])
            tau = self.between(m.lag[part], 8 + part)
            speeding, slowing = (
                self.between(m.speeding[part], 12 + part),
                self.between(m.slowing[part], 16 + part),
            )
            begins, left = v[:, part], seconds
            crosses = begins * w < 0.0  # through rest: by the one limit until then, by the other afterwards
            until = np.where(crosses, time_to(begins, 0.0 * begins, w, slowing, tau), 0.0)
            rests = crosses & (until < seconds)
            begins, left = np.where(rests, 0.0, begins), np.where(rests, seconds - until, seconds)
            grows = begins * (w - begins) >= 0.0
            after[:, part] = approach(begins, w, np.where(grows, speeding, slowing), tau, left)
        return after


def approach(v: Floats, w: Floats, rate: Floats, tau: Floats, seconds: Floats) -> Floats:
    """Return velocities after some seconds of one limit and one lag."""
    gap = np.abs(w - v)
    ramp = np.clip((gap - rate * tau) / rate, 0.0, seconds)
    gap, rest = np.maximum(gap - rate * ramp, 0.0), seconds - ramp
    with np.errstate(divide="ignore", invalid="ignore"):
        decay = np.where(tau > 0.0, np.exp(-rest / tau), 1.0)
    return w - np.sign(w - v) * gap * decay


def time_to(v: Floats, at: Floats, w: Floats, rate: Floats, tau: Floats) -> Floats:
    """Return after how many seconds a velocity on its way from v to w is at another one between."""
    gap, left = np.abs(w - v), np.abs(w - at)
    soft = rate * tau
    linear = np.maximum(gap - np.maximum(left, soft), 0.0) / rate
    with np.errstate(divide="ignore", invalid="ignore"):
        slow = np.where(left < soft, tau * np.log(np.minimum(gap, soft) / np.maximum(left, 1e-300)), 0.0)
    return linear + np.maximum(slow, 0.0)


def moved(poses: Floats, velocity: Floats, seconds: Floats) -> Floats:
    """Drive with velocities (R, 3) in the robots' frames, by the middle of the step; headings are not wrapped."""
    x, y, theta = poses.T
    middle = theta + 0.5 * velocity[:, 2] * seconds
    ahead, left = velocity[:, 0] * seconds, velocity[:, 1] * seconds
    dx = ahead * np.cos(middle) - left * np.sin(middle)
    dy = ahead * np.sin(middle) + left * np.cos(middle)
    return np.stack([x + dx, y + dy, theta + velocity[:, 2] * seconds], axis=1)


def drive(
    oracle: Oracle,
    begun: Robots,
    decide: Callable[[Floats, Floats, int], Floats],
    intervals: int,
) -> tuple[Floats, Floats, Floats]:
    """Drive R runs: poses (R, K, 3) at observations, all poses between (R, K, N, 3), commands (R, K, 3).

    `decide` gives commands (R, 3) at poses (R, 3), after commands (R, 3), in an interval.
    """
    places, between, told, now = [], [], [], begun
    for k in range(intervals):
        command = decide(now.poses, now.commands[:, 0], k)
        now = oracle.follow(now, command)
        places.append(now.poses)
        between.append(np.stack(now.passed, axis=1))
        told.append(command)
    return np.stack(places, axis=1), np.stack(between, axis=1), np.stack(told, axis=1)
