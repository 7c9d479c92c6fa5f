"""Runs of the deployed program under given sensor errors, and the search for one that comes too near."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from viatool.arrays import Booleans, Floats, Indices
from viatool.loop.closed_loop import ClosedLoop
from viatool.loop.horizon import Crashes
from viatool.loop.told import NOTHING, Told
from viatool.loop.tube import TubeFollower
from viatool.rounding import AS_RECEIVED
from viatool.safety import JudgedStates
from viatool.safety.witness import MARGIN

_FRACTIONS = np.linspace(0.0, 1.0, 11)
_RUNS = 48
_ROUNDS = 4
_FLIPPED = (0.5, 0.3, 0.1)
"""Shares of the signs of the best run so far that a round of the search changes."""
_AT_ONCE = 4096
_TOUCH = 5e-324
"""The least distance: of a limit of 0, touching fails."""


@dataclass(frozen=True, eq=False)
class Begun:
    """What runs begin with beside their poses: see `drive`."""

    before: Floats
    command: Floats | None
    told: Told

    def rows(self, which: Indices) -> Begun:
        """Return what some of the runs begin with, repeated at will."""
        command = None if self.command is None else self.command[which]
        return Begun(self.before[which], command, self.told.select(which))


@dataclass(frozen=True, eq=False)
class Instant:
    """R robots where a control interval begins.

    Parameters
    ----------
    poses, before : ndarray
        (R, 3) and (R, K): where they are, and what stands behind the poses (`Kinematics.before`).
    command : ndarray, optional
        (R, A) commands before, where these are not what stands behind the poses.
    raw : ndarray, optional
        (R, ...) what the network gave before, where that is observed.
    """

    poses: Floats
    before: Floats
    command: Floats | None = None
    raw: Floats | None = None

    @property
    def states(self) -> Floats:
        """Return poses and what stands behind them, (R, 3 + K)."""
        return np.concatenate([self.poses, self.before], axis=1)

    def rows(self, which: Indices) -> Instant:
        """Return some of the robots, repeated at will."""
        command, raw = (None if part is None else part[which] for part in (self.command, self.raw))
        return Instant(self.poses[which], self.before[which], command, raw)

    def readings(self, loop: ClosedLoop, told: Told) -> Floats:
        """Return what perfect sensors read, (R, n)."""
        return loop.sensors.read(self.poses, self.before, self.command, told.given(self.raw))

    def held(self, loop: ClosedLoop, readings: Floats) -> tuple[Floats, Floats, Floats, Instant]:
        """Hold for an interval what the deployed program commands of readings (R, n).

        Returns
        -------
        tuple
            What the program receives (R, n), the commands (R, A), the state of the motion in which they are given
            (R, S), and where the next interval begins.
        """
        rules, move = loop.rules, loop.rules.kinematics
        seen = loop.sensors.encode(readings).astype(loop.setting.number).astype(np.float64)
        command = rules.clip(np.asarray(loop.driven.run(seen)))
        raw = loop.policy.outputs(seen) if loop.sensors.recollection.outputs is not None else None
        motion = self.before if move.state else self.before[:, :0]
        held = np.concatenate([command, motion], axis=1)
        ends = replace(rules.manoeuvre, deceleration=None).path(self.poses, held, np.ones(len(self.poses)))
        before = move.after(held, rules.interval) if move.state else command
        return seen, command, motion, Instant(ends, before, command, raw)


@dataclass(frozen=True, eq=False)
class Runs:
    """R runs over K intervals.

    Parameters
    ----------
    poses : ndarray
        (R, K, 3) at the beginning of each interval.
    observations, actions : ndarray
        (R, K, n) as the program receives them there, and (R, K, A) the command that is held.
    motions : ndarray
        (R, K, S) the state of the motion in which it is given.
    ends : ndarray
        (R, K, 3) at its end.
    behind : ndarray
        (R, K, ...) what stands behind the poses there (`Kinematics.before`).
    clearance : ndarray
        (R, K) least clearance of the manoeuvre, at some instants; infinite after the run has arrived.
    """

    poses: Floats
    observations: Floats
    actions: Floats
    motions: Floats
    ends: Floats
    behind: Floats
    clearance: Floats


def drive(
    follower: TubeFollower,
    poses: Floats,
    before: Floats,
    errors: Floats,
    command: Floats | None = None,
    told: Told = NOTHING,
) -> Runs:
    """Drive the deployed program.

    Parameters
    ----------
    follower : TubeFollower
        Policy, sensors and goal.
    poses, before : ndarray
        (R, 3) and (R, K): where the runs begin, and what stands behind the poses (`Kinematics.before`).
    errors : ndarray
        (R, K, n) what is added to what perfect sensors read.
    command : ndarray, optional
        (R, A) commands before, where these are not what stands behind the poses; by default such that a robot stands.
    told : Told
        What else was recorded where the runs begin.

    Returns
    -------
    Runs
        R of them; they go on behind the goal, where their clearance counts no more.
    """
    loop = follower.loop
    now = Instant(poses, before, command)
    found: list[tuple[Floats, ...]] = []
    driving = ~follower.ended(now.states)
    counts: list[Booleans] = []
    for k in range(errors.shape[1]):
        seen, command, motion, after = now.held(loop, now.readings(loop, told.after(k)) + errors[:, k])
        found.append((now.poses, seen, command, motion, after.poses, after.before))
        counts.append(driving)
        now = after
        driving = driving & ~follower.ended(now.states)
    begun, seen, actions, motions, ends, behind = (
        np.stack(part, axis=1) for part in zip(*found, strict=True)
    )
    left = np.where(np.stack(counts, axis=1), _clearance(loop, begun, motions, actions), np.inf)
    return Runs(begun, seen, actions, motions, ends, behind, left)


def _clearance(loop: ClosedLoop, poses: Floats, motions: Floats, commands: Floats) -> Floats:
    """Return the least clearance of the manoeuvres of R runs in K intervals, (R, K), all of them together."""
    shape = poses.shape[:2]
    poses, motions, commands = (part.reshape(shape[0] * shape[1], -1) for part in (poses, motions, commands))
    left = np.empty(len(poses))
    for first in range(0, len(poses), _AT_ONCE):
        some = slice(first, first + _AT_ONCE)
        judged = _judged(loop, poses[some], motions[some])
        left[some] = judged.clearance(commands[some, None], _FRACTIONS).min(axis=(1, 2))
    return left.reshape(shape)


def search_crashes(
    follower: TubeFollower,
    states: Indices,
    poses: Floats,
    before: Floats,
    command: Floats | None = None,
    told: Told = NOTHING,
    *,
    seed: int | tuple[int, ...],
) -> Crashes:
    """Look for runs that come nearer than the collision distance within the horizon.

    Parameters
    ----------
    follower : TubeFollower
        Policy, sensors and horizon.
    states : ndarray
        (B,) what the states are called, ascending.
    poses, before : ndarray
        (B, 3) and (B, K): recorded poses, and what stands behind them (`Kinematics.before`).
    command : ndarray, optional
        (B, A) commands before, as for `drive`.
    told : Told
        What else was recorded.
    seed : int
        Of the errors.

    Returns
    -------
    Crashes
        At most one for each state.

    Notes
    -----
    Sound: yes. The program is onnxruntime, and what it observes is within eps of what perfect sensors read. The errors
    are corners of their boxes: random ones, then those that the correlation of errors and clearance speaks for.
    """
    generator = np.random.default_rng(seed)
    found = [_no_crash(follower)]
    each = max(1, _AT_ONCE // _RUNS)
    for first in range(0, len(states), each):
        some = slice(first, first + each)
        begun = Begun(before[some], None if command is None else command[some], told.select(some))
        found.append(_search(follower, states[some], poses[some], begun, generator))
    return Crashes.join(found)


def _search(
    follower: TubeFollower, states: Indices, poses: Floats, begun: Begun, generator: np.random.Generator
) -> Crashes:
    steps, size, count = follower.horizon.steps, len(follower.loop.setting.radii), len(states)
    shape = (count, _RUNS, 3 + steps * size)
    signs = generator.choice([-1.0, 1.0], shape)
    signs[:, 0] = 0.0
    best, least = np.zeros((count, shape[2])), np.full(count, np.inf)
    repeated = begun.rows(np.repeat(np.arange(count), _RUNS))
    for round_ in range(_ROUNDS):
        starts, errors = _spread(follower, poses, begun.before, signs)
        runs = drive(follower, starts, repeated.before, errors, repeated.command, repeated.told)
        left = runs.clearance.min(axis=1).reshape(count, _RUNS)
        better = left.min(axis=1) < least
        best = np.where(better[:, None], signs[np.arange(count), left.argmin(axis=1)], best)
        least = np.minimum(least, left.min(axis=1))
        if round_ == _ROUNDS - 1:
            break
        finite = np.where(np.isfinite(left), left, 0.0)
        towards = -np.sign(np.einsum("bm,bmd->bd", finite - finite.mean(axis=1, keepdims=True), signs))
        signs = np.repeat(best[:, None], _RUNS, axis=1)
        signs[:, 1::2] = towards[:, None]
        flipped = generator.random(shape) < _FLIPPED[round_]
        flipped[:, :2] = False
        signs = np.where(flipped, generator.choice([-1.0, 1.0], shape), signs)
    return _confirmed(follower, states, poses, begun, best, least)


def _spread(follower: TubeFollower, poses: Floats, before: Floats, signs: Floats) -> tuple[Floats, Floats]:
    """Return starts (B M, 3) and errors (B M, K, n) of signs (B, M, 3 + K n)."""
    loop, (count, each, _) = follower.loop, signs.shape
    seen = loop.sensors.read(poses, before)
    size = max(np.abs(seen).max(initial=0.0), loop.sensors.recollection.largest)
    radii = np.maximum(loop.setting.radii - AS_RECEIVED * (1.0 + size), 0.0)
    starts = poses[:, None] + signs[:, :, :3] * follower.horizon.pose_error
    errors = signs[:, :, 3:].reshape(count * each, follower.horizon.steps, len(radii)) * radii
    return starts.reshape(-1, 3), errors


def _confirmed(
    follower: TubeFollower, states: Indices, poses: Floats, begun: Begun, best: Floats, least: Floats
) -> Crashes:
    """Return the best runs that fail."""
    rows = np.flatnonzero(_fails(least, follower.loop.rules.clearance.collision))
    if not len(rows):
        return _no_crash(follower)
    begun = begun.rows(rows)
    starts, errors = _spread(follower, poses[rows], begun.before, best[rows, None])
    runs = drive(follower, starts, begun.before, errors, begun.command, begun.told)
    return _as_crashes(follower.loop, states[rows], runs)


def nearest_crash(loop: ClosedLoop, runs: Runs) -> Crashes:
    """Return the run that comes nearest, if it fails, as that of state 0.

    Notes
    -----
    Sound: yes, if what the runs begin with, and what their sensors err, is within the model.
    """
    row = int(runs.clearance.min(axis=1).argmin())
    alone = Runs(*(getattr(runs, each.name)[row : row + 1] for each in fields(runs)))
    if not _fails(alone.clearance.min(axis=1), loop.rules.clearance.collision).any():
        _, steps, size = runs.observations.shape
        return Crashes.none(steps, size, runs.actions.shape[2], runs.motions.shape[2])
    return _as_crashes(loop, np.zeros(1, np.int64), alone)


def _fails(least: Floats, limit: float) -> Booleans:
    """Tell of which runs the least clearance (R,) is too little beyond doubt."""
    return np.asarray((least < limit - MARGIN) | (least <= 0.0))


def _as_crashes(loop: ClosedLoop, states: Indices, runs: Runs) -> Crashes:
    """Return runs that fail with the place where they come nearest in the interval in which they first fail."""
    each = np.arange(len(states))
    at = (runs.clearance < max(loop.rules.clearance.collision, _TOUCH)).argmax(axis=1)
    judged = _judged(loop, runs.poses[each, at], runs.motions[each, at])
    left, seconds, places = (part[:, 0] for part in judged.closest_approach(runs.actions[each, at][:, None]))
    driven = runs.poses, runs.observations, runs.actions, runs.motions
    return Crashes(states, *driven, at, seconds, places, left)


def _no_crash(follower: TubeFollower) -> Crashes:
    rules, size = follower.loop.rules, len(follower.loop.setting.radii)
    return Crashes.none(follower.horizon.steps, size, len(rules.lower), len(rules.kinematics.state))


def _judged(loop: ClosedLoop, poses: Floats, motion: Floats) -> JudgedStates:
    """Return states (B,) with poses and the state of their motion (B, S)."""
    placed = loop.around.everything.throughout(poses)
    begun = np.stack([motion, motion], axis=1) if motion.shape[1] else None
    return JudgedStates(loop.rules, placed, begun=begun)
