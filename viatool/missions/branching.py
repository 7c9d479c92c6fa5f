"""Runs of a mission that branch: thousands at once, spread over all that they reach.

Runs under errors that are drawn stay together, as a policy takes back what each of them does. So the runs are driven
interval by interval, and after each one it is drawn which of them go on, and how often: sooner those that are alone in
their cell of poses, and those that are near to something; none that has arrived. Readings are off at
corners of their errors: as in the interval before, drawn anew, or, where what a policy does can be told from few
readings, such that each adds to how fast it turns or drives, or takes from it.

Of each interval the errors are kept, and which run each one went on from. So the run that came nearest, and one of
those that arrive last, can be driven again from their starts, alone: only that counts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from viatool.arrays import Floats, Indices
from viatool.loop.closed_loop import ClosedLoop
from viatool.loop.runs import Instant
from viatool.missions.follow import MissionFollower
from viatool.schedule import check_time

RUNS = 4000
_TOLD_FROM = 40_000
"""Commands of an interval, by which it is told which errors add to them."""
_CELL = np.array([0.04, 0.04, 0.1])
"""Sides of cells in metres, metres and radians."""
_NEAR, _SOONER = 0.15, 3.0
"""Metres above the collision distance within which runs go on sooner, and how much sooner at that distance."""
_NEAREST = 50
"""Of so many runs the nearest goes on in any case."""


@dataclass(frozen=True, eq=False)
class Branches:
    """What R branching runs of K intervals did.

    Parameters
    ----------
    starts : ndarray
        (R, 3 + B) states in which they begin.
    sources : list of ndarray
        K of (R,): the run that each one goes on from after an interval.
    signs : list of ndarray
        K of (R, n / 8) of bool, packed: at which end of its error each reading is in the interval.
    sizes : ndarray
        (n,) by how much readings are off.
    """

    starts: Floats
    sources: list[Indices]
    signs: list[NDArray[np.uint8]]
    sizes: Floats

    def errors(self, run: int, last: int) -> tuple[Floats, Floats]:
        """Return the start (3 + B,) and the errors (K, n) of a run of the last interval that is given."""
        found = np.zeros((len(self.signs), len(self.sizes)))
        for k in range(last, -1, -1):
            positive = np.unpackbits(self.signs[k][run], count=len(self.sizes))
            found[k] = np.where(positive, self.sizes, -self.sizes)
            run = int(self.sources[k - 1][run]) if k else run
        return self.starts[run], found


def branch(
    follower: MissionFollower, lower: Floats, upper: Floats, sizes: Floats, *, seed: int | tuple[int, ...]
) -> tuple[Floats, Floats]:
    """Drive runs that branch against a mission.

    Parameters
    ----------
    follower : MissionFollower
        Policy, sensors, goal, and within how many intervals every run has to arrive.
    lower, upper : ndarray
        (3 + B,) ends of the states at the start.
    sizes : ndarray
        (n,) by how much readings are off.
    seed : int
        Of what is drawn.

    Returns
    -------
    tuple of ndarray
        (2, 3 + B) states at the start and (2, K, n) errors of the run that came nearest, and of one that arrived last.

    Notes
    -----
    Proves nothing: what the two runs do is seen when they are driven again.
    """
    loop, steps, generator = follower.loop, follower.limits.steps, np.random.default_rng(seed)
    share = generator.random((RUNS, len(lower)))
    share[::2] = np.round(share[::2])
    starts = lower + share * (upper - lower)
    now, told = Instant(starts[:, :3], starts[:, 3:]), follower.told(RUNS)
    signs = generator.random((RUNS, len(sizes))) < 0.5
    branches = Branches(starts, [], [], sizes)
    nearest, last = (np.inf, 0, 0), (0, 0)
    for k in range(steps):
        check_time()
        readings = now.readings(loop, told.after(k))
        signs = _drawn(loop, readings, signs, sizes, generator)
        now = now.held(loop, readings + np.where(signs, sizes, -sizes))[3]
        branches.signs.append(np.packbits(signs, axis=1))
        left = _room(loop, now.poses)
        if left.min() < nearest[0]:
            nearest = float(left.min()), int(left.argmin()), k
        if follower.destination.deadline_only and k < steps - 1:
            going = np.arange(RUNS)
        else:
            going = np.flatnonzero(~follower.destination.holds(now.states))
        if not len(going):
            break
        last = int(going[0]), k
        source = _drawn_on(loop, now, left, going, generator)
        branches.sources.append(source)
        now, signs = now.rows(source), signs[source]
    found = [branches.errors(*nearest[1:]), branches.errors(*last)]
    errors = np.zeros((2, steps, len(sizes)))
    errors[:, : len(branches.signs)] = [one for _, one in found]
    return np.stack([start for start, _ in found]), errors


def _drawn(
    loop: ClosedLoop, readings: Floats, held: NDArray[np.bool_], sizes: Floats, generator: np.random.Generator
) -> NDArray[np.bool_]:
    """Return at which ends of their errors readings (R, n) are."""
    signs = held.copy()
    anew = generator.random(len(signs)) < 0.25
    signs[anew] = generator.random((int(anew.sum()), len(sizes))) < 0.5
    places = np.flatnonzero(sizes)
    led = np.flatnonzero(
        generator.random(len(signs)) < min(0.5, _TOLD_FROM / (max(len(places), 1) * len(signs)))
    )
    axes = len(loop.rules.lower)
    weights = generator.choice([-1.0, 0.0, 1.0], (len(led), axes)) / (loop.rules.upper - loop.rules.lower)
    shifted = np.repeat(readings[led][:, None], len(places) + 1, axis=1)
    shifted[:, np.arange(len(places)), places] += sizes[places]
    seen = loop.sensors.encode(shifted.reshape(-1, readings.shape[1]))
    commands = np.asarray(loop.driven.run(seen.astype(loop.setting.number).astype(np.float64)))
    commands = commands.reshape(len(led), len(places) + 1, axes)
    adds = np.einsum("rna,ra->rn", commands[:, :-1] - commands[:, -1:], weights)
    towards = signs[led]
    towards[:, places] = np.where(adds == 0.0, towards[:, places], adds > 0.0)
    signs[led] = towards
    return signs


def _drawn_on(
    loop: ClosedLoop, now: Instant, left: Floats, going: Indices, generator: np.random.Generator
) -> Indices:
    """Return from which of the runs that go on each of R next ones goes on, (R,)."""
    cells = np.floor(now.poses[going] / _CELL).astype(np.int64)
    _, cell, count = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    room = np.clip((left[going] - loop.rules.clearance.collision) / _NEAR, 0.0, 1.0)
    weight = (1.0 + _SOONER * (1.0 - room)) / count[cell.ravel()]
    source = generator.choice(going, len(left), p=weight / weight.sum())
    nearest = going[np.argsort(left[going], kind="stable")[: len(left) // _NEAREST]]
    source[: len(nearest)] = nearest
    return source


def _room(loop: ClosedLoop, poses: Floats) -> Floats:
    """Return the clearance at poses (R, 3)."""
    scene = np.zeros(len(poses), np.int64)
    return loop.around.everything.still.footprint_clearance(poses, loop.rules.footprint, scene)
