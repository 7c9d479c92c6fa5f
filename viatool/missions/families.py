"""Which directions a mission's sets are bounded along: families that follow one run from its start to its goal.

Of the run that nothing disturbs, from the middle of the box of starts, the loop's linear part is estimated in each
interval: poses around it are driven for one interval, and a plane is fitted to where they come. See `directions` for
what families do, and why none of this decides what is true.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from viatool.arrays import Floats
from viatool.loop.horizon import Horizon
from viatool.loop.runs import drive
from viatool.loop.tube import TubeFollower
from viatool.missions.directions import PoseDirections

if TYPE_CHECKING:
    from viatool.missions.follow import MissionFollower

_AROUND = np.array([0.02, 0.02, 0.02])
_DRIVEN = 60
"""Metres, metres and radians around the run, and the poses there from which it is driven."""


def directions_of(follower: MissionFollower, lower: Floats, upper: Floats) -> tuple[PoseDirections, ...]:
    """Return directions at the beginning and after each interval, until the run has arrived.

    Parameters
    ----------
    follower : MissionFollower
        The closed loop, and for how long.
    lower, upper : ndarray
        (3 + K,) ends of the states at the start.

    Returns
    -------
    tuple of PoseDirections
        None at all where sets hold more than poses and commands (motors and timing of an error model).
    """
    loop, steps = follower.loop, follower.limits.steps
    if loop.rules.over_time is not None:
        return (PoseDirections.none(),)
    tubes = TubeFollower(loop, follower.goal_radius, Horizon(1), follower.destination)
    middle = 0.5 * (lower + upper)[None]
    still = np.zeros((1, steps, len(loop.setting.radii)))
    run = drive(tubes, middle[:, :3], middle[:, 3:], still, told=follower.told(1))
    ends = np.concatenate([run.ends[0], run.behind[0]], axis=1)
    arrived = follower.destination.holds(ends)
    steps = int(arrived.argmax()) + 1 if arrived.any() else steps
    poses = np.concatenate([middle[:, :3], run.ends[0, :steps]])
    before = np.concatenate([middle[:, 3:], run.behind[0, : steps - 1]])
    return families(poses, _linear(follower, tubes, poses[:-1], before))


def _linear(follower: MissionFollower, tubes: TubeFollower, poses: Floats, before: Floats) -> Floats:
    """Fit where poses around those of a run (K, 3) are after an interval, (K, 3, 3) derivatives by the poses."""
    steps = len(poses)
    share = np.random.default_rng(0).uniform(-1.0, 1.0, (_DRIVEN, 3))
    begun = (poses[:, None] + share * _AROUND).reshape(-1, 3)
    behind = np.repeat(before, _DRIVEN, axis=0)
    still = np.zeros((len(begun), 1, len(follower.loop.setting.radii)))
    found = drive(tubes, begun, behind, still, told=follower.told(len(begun)))
    ends = found.ends[:, 0].reshape(steps, _DRIVEN, 3)
    plane = np.linalg.pinv(np.concatenate([np.ones((_DRIVEN, 1)), share], axis=1))
    slopes = np.einsum("sd,kde->kse", plane[1:], ends)
    return np.asarray(np.swapaxes(slopes, 1, 2) / _AROUND)


_ANCHORS, _BACK, _FORWARD = 8, 40, 36
"""Intervals from one end of families to the next, how far backward they reach, and how far forward."""
_WORST = 1e4
"""Condition of A at which those end that are carried forward."""


def families(poses: Floats, linear: Floats) -> tuple[PoseDirections, ...]:
    """Return directions at the beginning and after each of K intervals.

    Parameters
    ----------
    poses : ndarray
        (K + 1, 3) of one run.
    linear : ndarray
        (K, 3, 3) A of each interval.
    """
    steps = len(linear)
    found: list[dict[int, Floats]] = [{} for _ in range(steps + 1)]
    for axis, row in enumerate(np.eye(3)):
        for k in range(min(_FORWARD, steps) + 1):
            found[k][axis] = row
            if k == steps or not np.linalg.cond(linear[k]) < _WORST:
                break
            row = _scaled(np.linalg.solve(linear[k].T, row))
    ends = sorted({*range(_ANCHORS, steps + 1, _ANCHORS), steps})
    for number, end in enumerate(ends, start=1):
        for axis, row in enumerate(np.eye(3)):
            for k in range(end, max(end - _BACK, -1), -1):
                if not np.abs(row).max() > 0.0:
                    break
                found[k][3 * number + axis] = row
                row = _scaled(row @ linear[k - 1]) if k else row
    return tuple(
        PoseDirections(pose, np.array(list(rows.values())).reshape(-1, 3), tuple(rows))
        for pose, rows in zip(poses, found, strict=True)
    )


def _scaled(row: Floats) -> Floats:
    """Return a direction with 1 as its largest entry, or zeros if there is none."""
    size = np.abs(row).max()
    return row / size if 0.0 < size < np.inf else np.zeros(3)
