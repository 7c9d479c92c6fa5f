"""Runs of a mission under errors that are chosen against it: one that collides or does not arrive refutes it.

The program is run by onnxruntime from corners of the box of starts; what its sensors read is off by corners of their
errors: held for the whole run or drawn anew in each interval. Where none of these runs collides, but some come near and
something errs, errors that make one collide are searched for. A mission that is not proved at once is attacked by runs
that `branching` finds. Motors and timing of an error model are drawn at corners
as well; what they do is not kept, so such runs show where and when robots arrive, and refute nothing.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from itertools import product

import numpy as np

from viatool.arrays import Floats, Indices
from viatool.loop.closed_loop import ClosedLoop
from viatool.loop.flawed_runs import drive_flawed
from viatool.loop.horizon import Crashes, Horizon
from viatool.loop.runs import Runs, drive, nearest_crash, search_crashes
from viatool.loop.tube import TubeFollower
from viatool.missions.branching import branch
from viatool.missions.follow import MissionFollower
from viatool.rounding import AS_RECEIVED

_HELD = 24
_DRAWN = 24
_SEARCHED = 4
"""Starts from which runs that collide are searched for."""


@dataclass(frozen=True, eq=False)
class MissionRuns:
    """R adversarial runs of a mission, over K intervals or until the last one has arrived.

    Parameters
    ----------
    runs : Runs
        Poses, observations and commands.
    arrived : ndarray
        (R,) intervals after which each run arrives; K + 1 if it does not.
    crashes : Crashes
        At most one run that collides.
    seconds : ndarray
        (R, K) since the start, at the ends of intervals.
    refutes : bool
        Whether a run refutes that does not arrive; one of motors and timing that are drawn could not be driven again.
    """

    runs: Runs
    arrived: Indices
    crashes: Crashes
    seconds: Floats
    refutes: bool = True

    @property
    def driven_arrival(self) -> tuple[float, float] | None:
        """Return the seconds after which the first and the last run arrives of those that do; None if none does."""
        rows = np.flatnonzero(self.arrived <= self.seconds.shape[1])
        after = self.seconds[rows, self.arrived[rows] - 1]
        return (float(after.min()), float(after.max())) if len(rows) else None

    def disproves(self, limit: float) -> bool:
        """Tell whether some run does not arrive, or comes nearer than a limit, even if it cannot be driven again."""
        late = self.arrived > self.runs.poses.shape[1]
        return bool(late.any() or not self.runs.clearance.min(initial=np.inf) > limit)

    @property
    def attained(self) -> Floats:
        """Return how far all runs together reach in x, y and theta after each interval until the first arrives."""
        return np.asarray(np.ptp(self.runs.ends[:, : max(int(self.arrived.min()) - 1, 0)], axis=0))

    @property
    def refuting(self) -> bool:
        """Tell whether a run refutes the mission."""
        return bool(len(self.crashes) or len(self.late))

    @property
    def flawless(self) -> tuple[float, float] | None:
        """Return when the first run arrives, which has no error, in seconds, and its least clearance.

        Infinite if it does not arrive; None where motors and timing are drawn in it as well.
        """
        if not self.refutes:
            return None
        after, steps = int(self.arrived[0]), self.seconds.shape[1]
        arrives = float(self.seconds[0, after - 1]) if after <= steps else np.inf
        return arrives, float(self.runs.clearance[0].min(initial=np.inf))

    @property
    def late(self) -> Indices:
        """Return the runs that are still on their way after all K intervals, if they refute."""
        late = self.arrived > self.runs.poses.shape[1]
        return np.flatnonzero(late & self.refutes)


def attack(follower: MissionFollower, lower: Floats, upper: Floats, *, seed: int) -> MissionRuns:
    """Drive a mission's policy against it.

    Parameters
    ----------
    follower : MissionFollower
        Policy, sensors, goal, and within how many intervals every run has to arrive.
    lower, upper : ndarray
        (3 + A,) ends of the states at the start.
    seed : int
        Of what is drawn.

    Returns
    -------
    MissionRuns
        What was found.

    Notes
    -----
    Sound: yes. Every start lies in its box, every observation within eps of what perfect sensors read, and the
    commands are those of onnxruntime.
    """
    loop, steps = follower.loop, follower.limits.steps
    generator = np.random.default_rng(seed)
    count = _HELD + _DRAWN
    starts = _starts(lower, upper, count, generator)
    shape = (count, steps, len(loop.setting.radii))
    signs = np.where(generator.random(shape) < 0.5, -1.0, 1.0)
    signs[:_HELD] = signs[:_HELD, :1]
    signs[0] = 0.0
    errors = signs * _sizes(follower, starts)
    centre = 0.5 * (lower + upper)
    tubes = TubeFollower(loop, follower.goal_radius, Horizon(min(steps, _MOST)), follower.destination)
    ideal = loop.rules.over_time is None
    if ideal:
        runs = drive(tubes, starts[:, :3], starts[:, 3:], errors, told=follower.told(count))
        seconds = np.broadcast_to(loop.rules.interval * np.arange(1, shape[1] + 1), shape[:2])
    else:
        runs, seconds = drive_flawed(
            tubes, starts[:, :3], starts[:, 3:], errors, follower.told(count), seed=seed
        )
    arrived = _arrivals(follower, runs)
    kept = _is_kept(loop)
    crashes = nearest_crash(loop, runs) if kept else _no_crash(runs)
    if len(crashes) or not (kept and errors.any()) or _far(runs, loop.rules.clearance.collision):
        return MissionRuns(runs, arrived, crashes, seconds, ideal)
    extents = 0.5 * (upper - lower)[:3]
    last = int(arrived.max())
    wider = Horizon(min(last + last // _BEYOND, steps, _MOST), float(extents[:2].min()), float(extents[2]))
    searching = TubeFollower(loop, follower.goal_radius, wider, follower.destination)
    crashes = search_crashes(
        searching,
        np.zeros(1, np.int64),
        centre[None, :3],
        centre[None, 3:],
        told=follower.told(1),
        seed=(seed, 1),
    )
    return MissionRuns(runs, arrived, crashes, seconds)


def attack_again(
    follower: MissionFollower, lower: Floats, upper: Floats, driven: MissionRuns, *, seed: int
) -> MissionRuns:
    """Return what was driven, and two of the runs that branch: the one that comes nearest, and one that arrives last.

    Notes
    -----
    Sound: yes, as `attack`. Runs that could not be driven again, or do not err, are not looked for.
    """
    loop, steps = follower.loop, driven.seconds.shape[1]
    if not _is_kept(loop) or not loop.setting.radii.any():
        return driven
    sizes = _sizes(follower, np.stack([lower, upper]))
    starts, errors = branch(follower, lower, upper, sizes, seed=(seed, 2))
    tubes = TubeFollower(loop, follower.goal_radius, Horizon(min(steps, _MOST)), follower.destination)
    runs = drive(tubes, starts[:, :3], starts[:, 3:], errors, told=follower.told(len(starts)))
    arrived = np.concatenate([driven.arrived, _arrivals(follower, runs)])
    crashes = driven.crashes if len(driven.crashes) else nearest_crash(loop, runs)
    both = [(getattr(driven.runs, one.name), getattr(runs, one.name)) for one in fields(Runs)]
    every = Runs(*(np.concatenate(pair) for pair in both))
    seconds = np.concatenate([driven.seconds, driven.seconds[: len(starts)]])
    return replace(driven, runs=every, arrived=arrived, crashes=crashes, seconds=seconds)


def _is_kept(loop: ClosedLoop) -> bool:
    """Tell whether a run can be driven again: else what came near in it, or what motors did, is not kept."""
    return loop.rules.over_time is None and loop.around.moving is None


def _sizes(follower: MissionFollower, starts: Floats) -> Floats:
    """Return by how much readings (n,) may be off so that they are within eps as they are received in any interval."""
    loop = follower.loop
    size = np.abs(loop.sensors.read(starts[:, :3], starts[:, 3:])).max(initial=0.0)
    size = max(size, loop.sensors.recollection.largest)
    size = max(size, *(lidar.fan.lidar.maximum_range for lidar, _ in loop.sensors.quantities.lidars), 0.0)
    size += 2.0 * loop.sensors.shapes.scale  # no reading of a later interval is larger
    return np.asarray(np.maximum(loop.setting.radii - AS_RECEIVED * (1.0 + size), 0.0))


def _no_crash(runs: Runs) -> Crashes:
    _, steps, size = runs.observations.shape
    return Crashes.none(steps, size, runs.actions.shape[2], runs.motions.shape[2])


_MOST = 1000
_BEYOND = 4
"""A run that collides is searched for until the last one has arrived, and a quarter of that longer."""
_SPREADS = 4.0
"""By how many times as much as they differ runs keep their distance where none that collides is searched for."""


def _far(runs: Runs, limit: float) -> bool:
    """Tell whether runs stay so far from everything that to search for one that collides would be in vain."""
    left = runs.clearance.min(axis=1)
    return bool(left.min() - limit > _SPREADS * (left.max() - left.min() + limit))


def _starts(lower: Floats, upper: Floats, count: int, generator: np.random.Generator) -> Floats:
    """Return states (count, 3 + A): the middle, all corners of the pose, then random ones."""
    corners = np.array(list(product((0.0, 1.0), repeat=3)))
    share = generator.random((count, len(lower)))
    share[0] = 0.5
    share[1 : 1 + len(corners), :3] = corners
    return lower + share * (upper - lower)


def _arrivals(follower: MissionFollower, runs: Runs) -> Indices:
    """Return after how many intervals each run has arrived, (R,); K + 1 if it has not, by the deadline or at it."""
    steps = runs.ends.shape[1]
    there = follower.destination.holds(np.concatenate([runs.ends, runs.behind], axis=2))
    if follower.destination.deadline_only:
        there[:, :-1] = False
    return np.asarray(np.where(there.any(axis=1), there.argmax(axis=1) + 1, steps + 1))
