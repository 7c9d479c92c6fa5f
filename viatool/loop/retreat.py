"""Two arguments about whole cells that need no cutting: nothing is in reach, or nothing in reach is approached.

A robot that keeps the collision distance and then moves away from an obstacle keeps it. That settles the cells at
the rim of the free space, of which a part is not free: what is claimed of a cell holds for its free poses.

*Retreat.* Let K be convex, a circle or an edge, and n the unit vector from its nearest point to p. The distance
from K is convex, so ``dist(p + D) >= dist(p) + n . D``. The kinematics bounds the direction of every displacement D
relative to the heading. So if all these directions
are within a right angle of n, for all poses of the box, the distance from K never falls below what it is at the
pose. The way to the nearest point of a convex set is 1-Lipschitz, so for the places within rho of p_0, n turns by
at most ``arcsin(rho / |p_0 - nearest point|)``; for a circle take its centre as the nearest point.

A robot whose outline looks the same in every heading and that does not drive stays where it is clear.
"""

from __future__ import annotations

import numpy as np

from viatool.arrays import Booleans, Floats, Plane
from viatool.loop.outline_retreat import keep_outline_away
from viatool.motion.manoeuvre import Manoeuvre
from viatool.rounding import SIGHT_ROUNDING
from viatool.sets.forms import PoseBoxes
from viatool.setting.rules import Rules
from viatool.sight.shapes import Shapes


def keep_away(
    boxes: PoseBoxes, shapes: Shapes, rules: Rules, manoeuvre: Manoeuvre, lower: Floats, upper: Floats
) -> Booleans:
    """Tell in which boxes no free pose comes too near to anything, whatever command of a box it is given.

    Parameters
    ----------
    boxes : PoseBoxes
        C boxes of poses.
    shapes : Shapes
        What is around.
    rules : Rules
        Distance and footprint.
    manoeuvre : Manoeuvre
        How a command becomes a path.
    lower, upper : ndarray
        (C, A) commands as the robot carries them out.

    Returns
    -------
    ndarray
        (C,) bool: from every pose that keeps the collision distance, every command keeps it at every instant.

    Notes
    -----
    Sound: yes. Footprints with corners turn, and drive backwards: `outline_retreat` has their argument.
    """
    away, radii = vectors_from_shapes(boxes, shapes)
    slack = SIGHT_ROUNDING * (shapes.scale + np.abs(boxes.centre).sum(axis=1))[:, None]
    distance, reach = np.abs(away), boxes.extent[:, None]
    way = manoeuvre.longest(lower, upper)[:, None] + rules.footprint.reach
    far = distance - radii - reach - way > rules.clearance.collision + slack
    held = (lower <= upper).all(axis=1)  # ends that are crossed, or NaN, bound no command
    if rules.footprint.kind == "polygon":
        outline, least = rules.footprint.polygon, rules.clearance.collision
        return held & keep_outline_away(boxes, shapes, ~far, manoeuvre, outline, least, lower, upper)
    towards = manoeuvre.directions(lower, upper)
    right, left = towards.right, towards.left
    middle = boxes.centre[:, 2] + 0.5 * (left + right)
    off = np.angle(np.exp(1j * middle)[:, None] * np.conj(away))
    opening = (0.5 * (left - right) + boxes.turn)[:, None] + cone(reach, distance)
    retreats = np.abs(off) + opening + slack < 0.5 * np.pi
    # Neither reads all of these, so what is NaN would be proved by what is not.
    known = held & np.isfinite(distance).all(axis=1)
    return np.asarray(known & (towards.still | (far | retreats).all(axis=1)))


def cone(reach: Floats, distance: Floats) -> Floats:
    """Bound by how much the direction away from a convex shape varies over a box; pi where it is too near."""
    apart = distance > reach
    return np.where(apart, np.arcsin(np.minimum(reach / np.where(apart, distance, 1.0), 1.0)), np.pi)


def vectors_from_shapes(boxes: PoseBoxes, shapes: Shapes) -> tuple[Plane, Floats]:
    """Return the ways (C, N) from circles' centres and edges' nearest points to the middles, and radii (N,)."""
    places = boxes.places[:, None]
    edge = shapes.second - shapes.first
    along = np.conj(edge) * (places - shapes.first)
    share = np.clip(along.real / np.square(np.abs(edge)), 0.0, 1.0)
    nearest = shapes.first + share * edge
    away = np.concatenate([places - shapes.centres, places - nearest], axis=1)
    return away, np.concatenate([shapes.radii, np.zeros(len(edge))])
