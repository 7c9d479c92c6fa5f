"""Robots with real motors and timing, driven in fine steps by everything that their model allows. No code is shared.

Times are whole numbers of fine steps, so that nothing happens between two of them.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from tests.motion.varying import integrate
from viatool.motion.actuated import Machine
from viatool.motion.actuation import Actuation, Response
from viatool.motion.kinematics import KINEMATICS
from viatool.motion.timing import Timing

H = 4e-3
PARTS = {
    "differential": (0, 2),
    "ackermann": (0, 2),
    "holonomic": (0, 2, 1),
}  # of an axis, in ahead, left, turn
LIMITS = {
    "differential": ((-0.3, -1.5), (1.0, 1.5)),
    "ackermann": ((-0.3, -1.5), (1.0, 1.5)),
    "holonomic": ((-0.5, -1.5, -0.6), (1.0, 1.5, 0.6)),
}
TERMS = ("limits", "lag", "gain", "bias", "slip", "jitter", "delay", "age", "measured", "brake")


def limits(kinematics):
    return tuple(np.array(end) for end in LIMITS[kinematics])


def machine(generator, kinematics, terms, rim=0.0):
    """A robot with some of the terms, drawn at random; all others are ideal."""
    has = lambda term: term in terms  # noqa: E731

    def response(slow):
        least, fall = generator.uniform(0.5, 3.0, 2) * slow
        most = least * generator.choice([1.0, 1.5]) if has("limits") and generator.random() < 0.5 else np.inf
        lag = np.sort(generator.uniform(0.02, 0.2, 2) * generator.choice([0.0, 1.0], 2))
        return Response(
            acceleration=(least, most) if has("limits") else (np.inf, np.inf),
            deceleration=(fall, max(fall, most)) if has("limits") else (np.inf, np.inf),
            lag=(float(lag[0]), float(lag[1])) if has("lag") else (0.0, 0.0),
            relative=generator.uniform(0.0, 0.2) if has("gain") else 0.0,
            absolute=generator.uniform(0.0, 0.1) if has("bias") else 0.0,
        )

    slip = generator.uniform(0.0, 0.2) if has("slip") else 0.0
    move = KINEMATICS[kinematics]
    lateral = response(1.0) if move.slides else Response()
    actuation = Actuation(response(1.0), lateral, response(1.5), slip)
    steps = lambda least, most: H * np.sort(generator.integers(least, most, 2))  # noqa: E731
    timing = Timing(
        interval=tuple(steps(13, 38)) if has("jitter") else (0.1, 0.1),
        delay=tuple(steps(0, 60)) if has("delay") else (0.0, 0.0),
        age=float(H * generator.integers(0, 25)) if has("age") else 0.0,
    )
    return Machine(move, limits(kinematics), actuation, timing, 1.0 if has("brake") else None, rim)


@dataclass
class Runs:
    """R runs from the observation on: velocities at the ends of steps, and commands before, the oldest first."""

    poses: np.ndarray  # (R, N + 1, 3), from the origin
    velocity: np.ndarray  # (R, N, 3), in the middle of each step
    had: np.ndarray  # (R, 3) at the observation
    new: np.ndarray  # (R, A)
    before: np.ndarray  # (R, H, A)
    counts: np.ndarray  # (R,) steps that are judged
    time: np.ndarray = field(default_factory=lambda: np.zeros(0))


class Driver:
    """R runs of one machine, each with choices of its own: kept at a corner, switching, or free."""

    def __init__(self, generator, kinematics, asked: Machine, runs: int, history: int) -> None:
        self.generator, self.name, self.machine, self.runs = generator, kinematics, asked, runs
        self.history = history
        self.kind = generator.integers(0, 3, runs)
        self.corner = generator.integers(0, 2, (runs, 40)).astype(float)

    def share(self, number):
        """A choice (R,) in [0, 1] of its own number: the corner, another corner, or anything."""
        other = self.generator.integers(0, 2, self.runs).astype(float)
        free = self.generator.random(self.runs)
        return np.choose(self.kind, [self.corner[:, number], other, free])

    def between(self, bounds, number):
        """Values (R,) between two bounds; instead of an endless one a very large one."""
        low, high = (min(end, 1e9) for end in bounds)
        return low + self.share(number) * (high - low)

    def steps(self, bounds, number):
        low, high = (round(end / H) for end in bounds)
        return np.rint(low + self.share(number) * (high - low)).astype(int)

    def schedule(self):
        """When commands begin to act, (R, older + 2) steps; the last but one is the new one."""
        timing, older = self.machine.timing, self.history + 4
        computed = np.zeros((self.runs, older + 2), int)
        computed[:, older] = self.steps((0.0, timing.age), 30)
        for j in range(older, 0, -1):
            computed[:, j - 1] = computed[:, j] - self.steps(timing.interval, 31)
        computed[:, older + 1] = computed[:, older] + self.steps(timing.interval, 32)
        acts = np.stack([computed[:, j] + self.steps(timing.delay, 33) for j in range(older + 2)], axis=1)
        return np.maximum.accumulate(acts, axis=1)

    def drive(self, lower, upper):
        """Drive with commands between ends (A,), which the new one and all before are drawn from."""
        asked, generator = self.machine, self.generator
        acts = self.schedule()
        count = acts.shape[1] - 1
        commands = generator.uniform(lower, upper, (self.runs, count, len(lower)))
        rail = np.where(generator.random(commands.shape) < 0.5, lower, upper)
        commands = np.where(generator.random((self.runs, 1, 1)) < 0.5, rail, commands)
        begin, next_ = int(acts[:, : count - self.history].max(axis=1).min()), acts[:, -1]
        begin = min(begin, 0)
        stop = 0 if asked.deceleration is None else round(8.0 / H)
        end = int(next_.max()) + stop
        v = self.velocity_at_first(lower, upper)
        speeds, had, left = [], v.copy(), np.zeros_like(v)
        for step in range(begin, end):
            if step == 0:
                had = v.copy()
            acting = np.maximum((acts[:, :-1] <= step).sum(axis=1) - 1, 0)
            command = commands[np.arange(self.runs), acting]
            braking = step >= next_
            if stop:
                left[step == next_] = v[step == next_]
            for half in range(2):
                after = self.follow(v, command)
                v = np.where(braking[:, None], self.brake(v, left), after) if stop else after
                if step >= 0 and half == 0:
                    speeds.append(self.slipping(v))
            if stop and step > int(next_.max()) and np.abs(v).max() < 1e-4:
                break
        velocity = np.stack(speeds, axis=1)
        counts = np.full(self.runs, velocity.shape[1]) if stop else next_
        poses = integrate(np.zeros((self.runs, 3)), velocity, H)
        new, before = commands[:, -1], commands[:, -1 - self.history : -1]
        return Runs(poses, velocity, had, new, before, counts, H * np.arange(velocity.shape[1] + 1))

    def velocity_at_first(self, lower, upper):
        """Any velocity that the robot can have: a target of some command that it carries out."""
        v = np.zeros((self.runs, 3))
        for axis, part in enumerate(PARTS[self.name]):
            u = self.between((lower[axis], upper[axis]), 20 + part)
            v[:, part] = self.target(u, part)
        return v

    def target(self, u, part):
        response = self.machine.actuation.responses[part]
        error = 2.0 * self.share(3 * part) - 1.0
        return u + error * (response.relative * np.abs(u) + response.absolute)

    def follow(self, v, command):
        """One step of the motors."""
        after = np.zeros_like(v)
        for axis, part in enumerate(PARTS[self.name]):
            response = self.machine.actuation.responses[part]
            w = self.target(command[:, axis], part)
            grows = v[:, part] * (w - v[:, part]) >= 0.0
            speeding = self.between(response.acceleration, 3 * part + 1)
            slowing = self.between(response.deceleration, 3 * part + 1)
            rate = np.where(grows, speeding, slowing)
            tau = self.between(response.lag, 3 * part + 2)
            after[:, part] = approach(v[:, part], w, rate, tau)
        return after

    def brake(self, v, left):
        """One step of the brake, which takes as long as it may, or less; `left` is what it began with."""
        asked, motors = self.machine, self.machine.actuation.responses
        brake = min(asked.deceleration, motors[0].deceleration[0], motors[1].deceleration[0])
        seconds = (np.hypot(left[:, 0], left[:, 1]) + asked.rim * np.abs(left[:, 2])) / brake
        seconds = np.maximum(seconds, np.abs(left[:, 2]) / motors[2].deceleration[0])
        after = np.zeros_like(v)
        lag = max(response.lag[1] for response in motors)
        for part in range(3):
            slowest = np.abs(left[:, part]) / np.where(seconds > 0.0, seconds, 1.0)
            hard = self.share(25 + part)
            rate = np.where(hard < 0.5, slowest, 20.0 * slowest)
            after[:, part] = approach(v[:, part], 0.0, rate, np.where(hard < 0.5, lag, 0.0))
        return after

    def slipping(self, v):
        """What the ground adds to the side."""
        aside = (2.0 * self.share(29) - 1.0) * self.machine.actuation.slip * np.hypot(v[:, 0], v[:, 1])
        return v + aside[:, None] * np.array([0.0, 1.0, 0.0])


def approach(v, w, rate, tau):
    """Follow v' = sign(w - v) min(rate, |w - v| / tau) for half a step, exactly while nothing switches sign."""
    gap = np.abs(w - v)
    soft = rate * tau
    ramp = np.clip((gap - soft) / np.maximum(rate, 1e-12), 0.0, 0.5 * H)
    gap = gap - rate * ramp
    with np.errstate(divide="ignore", invalid="ignore"):
        decay = np.where(tau > 0.0, np.exp(-(0.5 * H - ramp) / tau), np.where(ramp < 0.5 * H, 0.0, 1.0))
    return w - np.sign(w - v) * np.maximum(gap, 0.0) * decay
