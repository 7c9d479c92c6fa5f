"""The argument of `retreat` for footprints with corners: nothing in reach is approached, though the outline turns.

The clearance of an outline is the least of these distances, each from a point to a convex set:

1. of each of its corners from each edge around;
2. of each end of an edge, and each centre of a circle, from each of its sides.

A distance from a convex set that is not 0 is differentiable, and grows while the point moves away from its nearest
point. The path of a command is cut into pieces. If in each piece, for every placement that a pose of the box, a
command of the box and an instant may bring, a distance is either greater than the collision distance d, or does not
shrink where it is greater than d, then it stays greater than d if it was so at first: it is continuous, and never
shrinks below what is greater than d. So does the clearance, and no shape gets inside of the outline.

Let the middle of the robot be within rho and its heading within eta of what the centre of a piece has. A body point a
(as a complex number in the robot's frame) moves along ``g = u + i omega a``, u the velocity of the origin; braking
scales it. g is linear in u and omega, so what holds for velocities whose convex hull holds those of all commands
(`Kinematics.velocities`) holds for all commands.

*Corners and edges.* A corner q is within ``r = rho + |q| eta`` of where the centre has it. The way w from the nearest
point of an edge is 1-Lipschitz, so w is within r of the centre's; where it is longer than d it turns by at most `cone`,
and by nothing if all of them meet the edge between its ends, from one side. Its distance grows if g, turned into the
map, is within a right angle of w.

*Points and sides.* In the robot's frame a point c is within ``r = rho + |c - p| eta`` of where the centre has it. Both
the nearest point a of a side and the way v from there to c are 1-Lipschitz. The distance grows if -v is within a right
angle of g, which changes by at most ``|omega| r`` as a does; where all meet the side between its ends, v keeps its
direction, and only ``omega r`` is left.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from viatool.arrays import Booleans, Floats, Indices, Plane
from viatool.motion.manoeuvre import Manoeuvre
from viatool.rounding import SIGHT_ROUNDING
from viatool.sets.forms import PoseBoxes
from viatool.sight.shapes import Shapes

_PIECES = 6
_RIGHT = 0.5 * np.pi - 1e-9
_MOST = 500_000  # numbers that are worked on together


@dataclass(frozen=True, eq=False)
class Placements:
    """T pieces of the paths of C boxes.

    Parameters
    ----------
    place, heading : ndarray
        (C, T) of the centre: points x + iy in metres, radians.
    shift, turn : ndarray
        (C, T) how far any placement of the piece is from the centre's.
    linear, angular : ndarray
        (C, K) velocities of the origin in the robot's frame and turning speeds, whose hull holds those of all commands.
    """

    place: Plane
    heading: Floats
    shift: Floats
    turn: Floats
    linear: Plane
    angular: Floats

    @classmethod
    def along(cls, boxes: PoseBoxes, manoeuvre: Manoeuvre, lower: Floats, upper: Floats) -> Placements:
        """Return the pieces of all paths; commands (C, A) each."""
        count, ends, move = len(boxes), np.linspace(0.0, 1.0, _PIECES + 1), manoeuvre.kinematics
        state = np.repeat(np.arange(count), _PIECES)
        begin, end = (np.tile(part, count) for part in (ends[:-1], ends[1:]))
        radius, actions = boxes.radius[state], 0.5 * (lower + upper)[state]
        length, turn = manoeuvre.extent(actions)
        middle = manoeuvre.path(boxes.centre[state], actions, 0.5 * (begin + end))
        others = manoeuvre.deviation(lower[state], upper[state], end)
        away, turned = move.from_elsewhere(radius, end * length, 0.0)
        shift = away + turned + others.away + move.outline_motion(length, turn, end - begin, 0.0)
        turning = radius[:, 2] + others.turned + 0.5 * turn * (end - begin)
        place, shape = middle[:, 0] + 1j * middle[:, 1], (count, _PIECES)
        return cls(
            place.reshape(shape), middle[:, 2].reshape(shape), shift.reshape(shape), turning.reshape(shape),
            *move.velocities(lower, upper, manoeuvre.interval),
        )  # fmt: skip

    def select(self, which: Indices) -> Placements:
        """Return those of some boxes, repeated at will."""
        return Placements(*(part[which] for part in vars(self).values()))


def keep_outline_away(
    boxes: PoseBoxes,
    shapes: Shapes,
    near: Booleans,
    manoeuvre: Manoeuvre,
    outline: Floats,
    distance: float,
    lower: Floats,
    upper: Floats,
) -> Booleans:
    """Tell in which boxes no free pose comes too near to anything, whatever command of a box it is given.

    Parameters
    ----------
    boxes : PoseBoxes
        C boxes of poses.
    shapes : Shapes
        K circles and M edges.
    near : ndarray
        (C, K + M) bool: the shapes that are in reach at all.
    manoeuvre : Manoeuvre
        How a command becomes a path.
    outline : ndarray
        (V, 2) corners of the footprint.
    distance : float
        The collision distance, in metres.
    lower, upper : ndarray
        (C, A) commands as the robot carries them out.

    Returns
    -------
    ndarray
        (C,) bool: from every pose that keeps the collision distance, every command keeps it at every instant.

    Notes
    -----
    Sound: yes, by the derivation of the module; rounding is counted.
    """
    corners = outline[:, 0] + 1j * outline[:, 1]
    slack = SIGHT_ROUNDING * (
        shapes.scale + float(np.abs(boxes.centre).sum(axis=1).max(initial=0.0)) + np.abs(corners).max()
    )
    circles, holds = len(shapes.radii), np.ones(len(boxes), dtype=bool)
    rows = np.flatnonzero(near.any(axis=1))
    step = max(1, _MOST // (4 * _PIECES * len(corners) * max(int(near.sum(axis=1).max(initial=1)), 1)))
    for start in range(0, len(rows), step):
        some = rows[start : start + step]
        pieces = Placements.along(boxes.select(some), manoeuvre, lower[some], upper[some])
        kept = np.ones(len(some), dtype=bool)
        box, shape = np.nonzero(near[some])
        edge = shape >= circles
        ends = shapes.first[shape[edge] - circles], shapes.second[shape[edge] - circles]
        kept[box[edge][~_corners_keep(pieces.select(box[edge]), corners, *ends, distance, slack)]] = False
        points = np.concatenate([shapes.centres[shape[~edge]], *ends])
        reach = distance + np.concatenate([shapes.radii[shape[~edge]], np.zeros(2 * len(ends[0]))])
        box = np.concatenate([box[~edge], box[edge], box[edge]])
        kept[box[~_points_keep(pieces.select(box), corners, points, reach, slack)]] = False
        holds[some] = kept
    return holds


def _corners_keep(
    pieces: Placements, corners: Plane, first: Plane, second: Plane, distance: float, slack: float
) -> Booleans:
    """Tell for P boxes, each with an edge, whether all corners of the outline keep their distance from it."""
    towards = np.exp(1j * pieces.heading)[:, :, None]
    at = pieces.place[:, :, None] + towards * corners  # (P, T, V)
    edge, begin = (second - first)[:, None, None], first[:, None, None]
    length = np.abs(edge)
    along = (np.conj(edge) * (at - begin)).real / length
    way = at - (begin + np.clip(along, 0.0, length) * edge / length)
    apart = np.abs(way)
    reach = pieces.shift[:, :, None] + np.abs(corners) * pieces.turn[:, :, None] + slack
    flat = between_ends(along, length, reach) & (reach - apart <= distance)
    opening = np.where(flat, 0.0, cone(reach, apart, distance)) + pieces.turn[:, :, None]
    moved = pieces.linear[:, None] + 1j * pieces.angular[:, None] * corners[:, None]  # (P, V, K)
    off = np.abs(np.angle(towards[..., None] * moved[:, None] * np.conj(way)[..., None]))
    retreats = ((off + opening[..., None] <= _RIGHT) | (moved == 0.0)[:, None]).all(axis=3)
    return np.asarray((retreats | (apart - reach > distance)).all(axis=(1, 2)))


def _points_keep(
    pieces: Placements, corners: Plane, points: Plane, distance: Floats, slack: float
) -> Booleans:
    """Tell for P boxes, each with a point, whether all sides of the outline keep their distances (P,) from it."""
    away = points[:, None] - pieces.place
    seen = (np.exp(-1j * pieces.heading) * away)[:, :, None]  # (P, T, 1)
    side = np.roll(corners, -1) - corners
    length = np.abs(side)
    along = (np.conj(side) * (seen - corners)).real / length
    nearest = corners + np.clip(along, 0.0, length) * side / length
    way, reach = seen - nearest, (pieces.shift + np.abs(away) * pieces.turn)[:, :, None] + slack
    apart, least = np.abs(way), distance[:, None, None]
    flat = (between_ends(along, length, reach) & (reach - apart <= least))[..., None]
    angular = pieces.angular[:, None, None]  # (P, 1, 1, K)
    moved = pieces.linear[:, None, None] + 1j * angular * nearest[..., None]  # (P, T, V, K)
    speed, change = np.abs(moved), np.abs(angular) * reach[..., None]
    straight = -(np.conj(way)[..., None] * moved).real >= apart[..., None] * (change + 1e-9 * speed)
    off = np.abs(np.angle(-moved * np.conj(way)[..., None])) + cone(reach, apart, least)[..., None]
    bent = off + swing(change, speed) <= _RIGHT
    retreats = (np.where(flat, straight, bent) | ((moved == 0.0) & (angular == 0.0))).all(axis=3)
    return np.asarray((retreats | (apart - reach > least)).all(axis=(1, 2)))


def between_ends(along: Floats, length: Floats, reach: Floats) -> Booleans:
    """Tell whether everything within reach of a point has its nearest point of an edge between both ends."""
    return np.asarray((along - reach > 0.0) & (along + reach < length))


def cone(reach: Floats, apart: Floats, least: float | Floats) -> Floats:
    """Bound by how much a way that is longer than `least` turns when its end moves by `reach`; pi if it may be any."""
    outside = apart > reach
    tangent = np.arcsin(np.minimum(reach / np.where(outside, apart, np.inf), 1.0))
    rest = np.square(apart) - np.square(reach)
    double = 2.0 * least * apart
    at_least = (np.square(least) + rest) / np.where(double > 0.0, double, 1.0)
    met = np.where(double > 0.0, np.arccos(np.clip(at_least, -1.0, 1.0)), np.pi)
    return np.where(outside & (rest >= np.square(least)), tangent, met)


def swing(change: Floats, speed: Floats) -> Floats:
    """Bound by how much the direction of a motion turns when it changes; pi where it may be any."""
    slower = change < speed
    return np.where(slower, np.arcsin(np.minimum(change / np.where(slower, speed, np.inf), 1.0)), np.pi)
