"""Where the footprint can be of a robot whose velocity varies within bounds: one segment or outline, and one radius.

As `viatool.safety.enclosure`, for a `VaryingMotion`: a cell is a box of commands and a part of the time until all
motion is over. Its profile is that of its own box, so that cutting the box narrows the profile. With the words of
`viatool.motion.profile`, the places of all paths within the part of the time lie

1. *round footprints:* within ``aside`` and the sagitta of the chord of the centre path, moved to and fro by
   ``along``; 2. *polygons:* the outline is placed where the centre path is in the middle of the time. Until both ends
   the place moves by at most the length in between and the outermost point by ``rim`` times the turn; other paths are
   at most ``along + aside`` away, and their outermost point ``rim apart`` more. 3. *Other poses.* From a pose that is
   D away and turned by delta every path is turned as a whole: the centre path is at most ``|D| + way |delta|`` away,
   and the segment of half-length ``along`` turns by delta as well.

4. *What moves* has moved for as long as the part of the time lasts (`VaryingMotion.counted`), whether or not the robot
stands by then.

No path is said to be attained: the centre path is one of those that the profile allows, but a robot may know better.
A cell that fails even for its middle command at its middle instant is given up, as no part of it could be proved.
"""

from __future__ import annotations

import numpy as np

from viatool.arrays import Floats, Plane
from viatool.motion.profile import PathSpread, VaryingMotion, VelocityProfile
from viatool.rounding import DISTANCE_ROUNDING
from viatool.safety.enclosure import ClearanceEnclosure, MotionBoxes
from viatool.safety.scene_poses import ScenePoses
from viatool.world import Footprint


def enclose_varying(
    cells: MotionBoxes, placed: ScenePoses, motion: VaryingMotion, footprint: Footprint
) -> ClearanceEnclosure:
    """Bound the clearance of the footprint over cells, see `viatool.safety.enclosure.enclose`.

    Notes
    -----
    Sound: yes, by the derivation at the top of this module. Nothing is said to be attained.
    """
    here, end = placed.select(cells.state), motion.end[cells.state]
    radii = np.zeros((len(cells), 3))
    if cells.offsets is not None:
        here = here.moved(here.poses + 0.5 * (cells.offsets[0] + cells.offsets[1]))
        radii = 0.5 * (cells.offsets[1] - cells.offsets[0])
    rim = footprint.reach if footprint.kind == "polygon" else 0.0
    (lower, upper), (first, last) = cells.commands, cells.fractions
    start, end = first * end, last * end
    profile = motion.profile(cells.state, lower, upper)
    spread, before = profile.spread(start, end), profile.spread(start, start)
    counted = motion.counted(cells.state, end)
    clearance, between = _centre_keeps(profile, spread, (start, end), counted, here, footprint)
    around = _around(spread, footprint)
    turned = spread.along + rim + profile.extent(0.0 * end, end)[0]
    elsewhere = np.hypot(radii[:, 0], radii[:, 1]) + turned * radii[:, 2]
    in_time = between + around - _around(before, footprint)
    shares = np.column_stack([motion.shares(lower, upper, end, rim), in_time])
    if cells.offsets is not None:
        shares = np.column_stack([shares, radii[:, :2], turned * radii[:, 2]])
    held = (cells.lower <= cells.upper).all(axis=1)  # ends that are crossed, or NaN, bound nothing
    least = np.where(held, clearance - between - elsewhere - around, -np.inf)
    return ClearanceEnclosure(least, np.full(len(cells), np.inf), shares)


def keep_at_best(
    cells: MotionBoxes, placed: ScenePoses, motion: VaryingMotion, footprint: Footprint
) -> Floats:
    """Return what the bounds leave to the middle commands of cells, in the middle and at the end, (C,) metres.

    Notes
    -----
    Sound: no. Cutting a cell is in vain where one of its parts cannot be proved.
    """
    here, end = placed.select(cells.state), motion.end[cells.state]
    if cells.offsets is not None:
        here = here.moved(here.poses + 0.5 * (cells.offsets[0] + cells.offsets[1]))
    middle = 0.5 * (cells.commands[0] + cells.commands[1])
    first, last = (fraction * end for fraction in cells.fractions)
    profile = motion.profile(cells.state, middle, middle)
    least = np.full(len(cells), np.inf)
    for at in (0.5 * (first + last), last):
        spread = profile.spread(at, at)
        counted = motion.counted(cells.state, at)
        clearance, between = _centre_keeps(profile, spread, (at, at), counted, here, footprint)
        least = np.minimum(least, clearance - between - _around(spread, footprint))
    return least


def _around(spread: PathSpread, footprint: Footprint) -> Floats:
    """Return how far from the footprint on the centre path that of other paths reaches, beside its `swath`, (C,)."""
    if footprint.kind == "polygon":
        return spread.along + spread.aside + footprint.reach * spread.apart
    return spread.aside


def _centre_keeps(
    profile: VelocityProfile,
    spread: PathSpread,
    instants: tuple[Floats, Floats],
    counted: Floats,
    here: ScenePoses,
    footprint: Footprint,
) -> tuple[Floats, Floats]:
    """Return what is left around the centre path between two instants, and how much of that the bounds take, (C,).

    What moves has moved for `counted` seconds.
    """
    start, end = instants
    slack = DISTANCE_ROUNDING * (
        here.scale
        + np.abs(here.poses).sum(axis=1)
        + profile.longest
        + profile.most_turned
        + footprint.reach
        + here.fastest * counted
    )
    x, y, theta = here.poses.T
    origin, ahead = x + 1j * y, np.exp(1j * theta)
    if footprint.kind == "polygon":
        at = 0.5 * (start + end)
        place, heading = profile.place(at)
        where = origin + ahead * place
        pose = np.column_stack([_points(where), theta + heading])
        halves = (profile.extent(*ends) for ends in ((start, at), (at, end)))
        moved = np.maximum(*(way + footprint.reach * turned for way, turned in halves))
        return here.moved(pose).footprint_clearance(footprint, counted)[0] - slack, moved
    tail, head, beside = spread.swath(*(profile.place(at)[0] for at in (start, end)))
    starts, ends = (_points(origin + ahead * place) for place in (tail, head))
    clearance = here.segment_clearance(starts, ends, counted)[0]
    return clearance - footprint.radius - slack, beside


def _points(places: Plane) -> Floats:
    """Return complex numbers as points, (C, 2)."""
    return np.column_stack([places.real, places.imag])
