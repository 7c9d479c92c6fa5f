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

No path is said to be attained: the centre path is one of those that the profile allows, but a robot may know better.
A cell that fails even for its middle command at its middle instant is given up, as no part of it could be proved.
"""

from __future__ import annotations

import numpy as np

from viatool.arrays import Floats, Plane
from viatool.motion.profile import PathSpread, VaryingMotion, VelocityProfile, sagitta_of, swath
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
    Sound: yes, by the derivation at the top of this module. `attained` is not attained: it is what the middle command
    keeps at the middle instant at most, by these bounds, so that below the threshold no cut helps.
    """
    here, end = placed.select(cells.state), motion.end[cells.state]
    radii = np.zeros((len(cells), 3))
    if cells.offsets is not None:
        here = here.moved(here.poses + 0.5 * (cells.offsets[0] + cells.offsets[1]))
        radii = 0.5 * (cells.offsets[1] - cells.offsets[0])
    rim = footprint.reach if footprint.kind == "polygon" else 0.0
    (lower, upper), (first, last) = cells.commands, cells.fractions
    profile = motion.profile(cells.state, lower, upper)
    spread = profile.spread(last * end)
    clearance, between = _centre_keeps(profile, spread, first * end, last * end, here, footprint)
    turned = spread.along + rim + profile.extent(0.0 * end, last * end)[0]
    elsewhere = np.hypot(radii[:, 0], radii[:, 1]) + turned * radii[:, 2]
    shares = np.column_stack([motion.shares(lower, upper, last * end, rim), between])
    if cells.offsets is not None:
        shares = np.column_stack([shares, radii[:, :2], turned * radii[:, 2]])
    held = (cells.lower <= cells.upper).all(axis=1)  # ends that are crossed, or NaN, bound nothing
    least = np.where(held, clearance - between - elsewhere - _around(spread, footprint), -np.inf)
    cut = held & ((first > 0.0) | (last < 1.0))  # few: most cells are decided whole
    at_best = np.full(len(cells), np.inf)
    if cut.any():
        at_best[cut] = _at_best(cells.select(cut), here.select(cut), motion, footprint)
    return ClearanceEnclosure(least, at_best, shares)


def _at_best(cells: MotionBoxes, here: ScenePoses, motion: VaryingMotion, footprint: Footprint) -> Floats:
    """Return what the bounds say of the middle command at the middle instant, (C,): no part of a cell has more."""
    middle = 0.5 * (cells.commands[0] + cells.commands[1])
    at = 0.5 * (cells.fractions[0] + cells.fractions[1]) * motion.end[cells.state]
    profile = motion.profile(cells.state, middle, middle)
    spread = profile.spread(at)
    return _centre_keeps(profile, spread, at, at, here, footprint)[0] - _around(spread, footprint)


def _around(spread: PathSpread, footprint: Footprint) -> Floats:
    """Return how far from the footprint on the centre path that of other paths reaches, beside its `swath`, (C,)."""
    if footprint.kind == "polygon":
        return spread.along + spread.aside + footprint.reach * spread.apart
    return spread.aside


def _centre_keeps(
    profile: VelocityProfile,
    spread: PathSpread,
    start: Floats,
    end: Floats,
    here: ScenePoses,
    footprint: Footprint,
) -> tuple[Floats, Floats]:
    """Return what is left around the centre path between two instants, and how much of that the bounds take, (C,)."""
    slack = DISTANCE_ROUNDING * (
        here.scale + np.abs(here.poses).sum(axis=1) + profile.longest + profile.most_turned + footprint.reach
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
        return here.scenes.footprint_clearance(pose, footprint, here.scene) - slack, moved
    first, last = (profile.place(at)[0] for at in (start, end))
    beside = sagitta_of(profile.extent(start, end)[0], np.abs(last - first))
    first, last, away = swath(first, last, spread)
    starts, ends = (_points(origin + ahead * place) for place in (first, last))
    clearance = here.scenes.segment_clearance(starts, ends, here.scene)
    return clearance - footprint.radius - slack, beside + away


def _points(places: Plane) -> Floats:
    """Return complex numbers as points, (C, 2)."""
    return np.column_stack([places.real, places.imag])
