"""Runs of the deployed program under given sensor errors, and the search for one that comes too near."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from viatool.arrays import Booleans, Floats, Indices
from viatool.loop.closed_loop import ClosedLoop
from viatool.loop.horizon import Crashes
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


@dataclass(frozen=True, eq=False)
class Runs:
    """R runs over K intervals.

    Parameters
    ----------
    poses : ndarray
        (R, K, 3) at the beginning of each interval.
    observations, actions : ndarray
        (R, K, n) as the program receives them there, and (R, K, 2) the command that is held.
    ends : ndarray
        (R, K, 3) at its end.
    clearance : ndarray
        (R, K) least clearance of the manoeuvre, at some instants; infinite after the run has arrived.
    """

    poses: Floats
    observations: Floats
    actions: Floats
    ends: Floats
    clearance: Floats


def drive(follower: TubeFollower, poses: Floats, previous: Floats, errors: Floats) -> Runs:
    """Drive the deployed program.

    Parameters
    ----------
    follower : TubeFollower
        Policy, sensors and goal.
    poses, previous : ndarray
        (R, 3) and (R, 2): where the runs begin.
    errors : ndarray
        (R, K, n) what is added to what perfect sensors read.

    Returns
    -------
    Runs
        R of them; they go on behind the goal, where their clearance counts no more.
    """
    loop, rules = follower.loop, follower.loop.rules
    places, received, commands, ends, clearances = [], [], [], [], []
    driving = ~_near_goal(follower, poses)
    for k in range(errors.shape[1]):
        readings = loop.sensors.read(poses, previous) + errors[:, k]
        seen = loop.sensors.encode(readings).astype(loop.setting.number).astype(np.float64)
        previous = rules.clip(np.asarray(loop.driven.run(seen)))
        judged = _judged(loop, poses)
        left = judged.clearance(previous[:, None], _FRACTIONS).min(axis=(1, 2))
        places.append(poses)
        received.append(seen)
        commands.append(previous)
        poses = replace(rules.manoeuvre, deceleration=None).path(poses, previous, np.ones(len(poses)))
        ends.append(poses)
        clearances.append(np.where(driving, left, np.inf))
        driving = driving & ~_near_goal(follower, poses)
    return Runs(*(np.stack(part, axis=1) for part in (places, received, commands, ends, clearances)))


def search_crashes(
    follower: TubeFollower, states: Indices, poses: Floats, previous: Floats, *, seed: int | tuple[int, ...]
) -> Crashes:
    """Look for runs that come nearer than the collision distance within the horizon.

    Parameters
    ----------
    follower : TubeFollower
        Policy, sensors and horizon.
    states : ndarray
        (B,) what the states are called, ascending.
    poses, previous : ndarray
        (B, 3) and (B, 2): recorded poses, and commands of the step before.
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
    radii, generator = follower.loop.setting.radii, np.random.default_rng(seed)
    steps = follower.horizon.steps
    found = [Crashes.none(steps, len(radii), previous.shape[1])]
    each = max(1, _AT_ONCE // _RUNS)
    for first in range(0, len(states), each):
        some = slice(first, first + each)
        found.append(_search(follower, states[some], poses[some], previous[some], generator))
    return Crashes.join(found)


def _search(
    follower: TubeFollower, states: Indices, poses: Floats, previous: Floats, generator: np.random.Generator
) -> Crashes:
    steps, size, count = follower.horizon.steps, len(follower.loop.setting.radii), len(states)
    shape = (count, _RUNS, 3 + steps * size)
    signs = generator.choice([-1.0, 1.0], shape)
    signs[:, 0] = 0.0
    best, least = np.zeros((count, shape[2])), np.full(count, np.inf)
    for round_ in range(_ROUNDS):
        starts, errors = _spread(follower, poses, previous, signs)
        runs = drive(follower, starts, np.repeat(previous, _RUNS, axis=0), errors)
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
    return _confirmed(follower, states, poses, previous, best, least)


def _spread(follower: TubeFollower, poses: Floats, previous: Floats, signs: Floats) -> tuple[Floats, Floats]:
    """Return starts (B M, 3) and errors (B M, K, n) of signs (B, M, 3 + K n)."""
    loop, (count, each, _) = follower.loop, signs.shape
    seen = loop.sensors.read(poses, previous)
    radii = np.maximum(loop.setting.radii - AS_RECEIVED * (1.0 + np.abs(seen).max(initial=0.0)), 0.0)
    starts = poses[:, None] + signs[:, :, :3] * follower.horizon.pose_error
    errors = signs[:, :, 3:].reshape(count * each, follower.horizon.steps, len(radii)) * radii
    return starts.reshape(-1, 3), errors


def _confirmed(
    follower: TubeFollower, states: Indices, poses: Floats, previous: Floats, best: Floats, least: Floats
) -> Crashes:
    """Return the best runs that fail."""
    limit = follower.loop.rules.clearance.collision
    rows = np.flatnonzero((least < limit - MARGIN) | (least <= 0.0))
    if not len(rows):
        return Crashes.none(follower.horizon.steps, len(follower.loop.setting.radii), previous.shape[1])
    starts, errors = _spread(follower, poses[rows], previous[rows], best[rows, None])
    runs, each = drive(follower, starts, previous[rows], errors), np.arange(len(rows))
    at = (runs.clearance < limit).argmax(axis=1)
    judged = _judged(follower.loop, runs.poses[each, at])
    left, seconds, places = (part[:, 0] for part in judged.closest_approach(runs.actions[each, at][:, None]))
    return Crashes(states[rows], runs.poses, runs.observations, runs.actions, at, seconds, places, left)


def _judged(loop: ClosedLoop, poses: Floats) -> JudgedStates:
    placed = replace(loop.geometry, poses=poses, scene=np.zeros(len(poses), np.int64), radii=None)
    return JudgedStates(loop.rules, placed)


def _near_goal(follower: TubeFollower, poses: Floats) -> Booleans:
    goal = follower.loop.sensors.goal
    return np.asarray(np.hypot(*(poses[:, :2] - goal).T) < follower.goal_radius)
