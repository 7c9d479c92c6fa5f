"""Where the robot's footprint can be: one shape and one radius for a whole box of commands and instants.

A *cell* is a box of speeds v, turning speeds omega and fractions s of the path (see `motion`). It is
enclosed by the motion of its centre command (v_c, omega_c), widened by a radius that bounds how far any
point of the footprint can be from where the centre command brings it at the same fraction. With the arc
length ``l = v T`` and the turn ``phi = omega T`` of the whole path, where T is the interval (and grows with
|v| and |omega| for braking):

1. *Other commands.* ``p(s; l, phi) - p(s; l_c, phi_c)`` is at most

       s |l - l_c| + s |l_c| int_0^1 |e(s phi u) - e(s phi_c u)| du
       <=  s |l - l_c| + s^2 |l_c| |phi - phi_c| / 2,

   because ``|e(a) - e(b)| <= |a - b|``. The footprint's point q turns with the heading, which adds at most
   ``s |phi - phi_c| |q|``. For the plain interval this is ``r_v t + |v_c| r_omega t^2 / 2 + |q| r_omega
   t``. The extremes of l and phi over a box are attained at |v| and |omega| at their ends, as both are
   monotone in v, in omega, in |v| and in |omega|.
2. *Other fractions, round footprints.* Between s_0 and s_1 the position follows the chord linearly up to
   ``|l_c phi_c| (s_1 - s_0)^2 / 8`` (the error of linear interpolation for second derivative
   ``|l_c phi_c|``), so the chord, widened by that sagitta and the footprint's radius, holds the disc at every
   instant.
3. *Other fractions, polygons.* The outline is placed at the middle fraction; until s_0 or s_1 no point of
   it moves farther than ``(|l_c| + |q| |phi_c|) (s_1 - s_0) / 2``.
4. *Other poses.* A state may be a box of poses. From a pose that is D away and turned by delta, a command brings
   the robot at most ``|D| + s |l| |delta|`` away from where it brings it from the centre pose, as the way to
   there is at most ``s |l|`` long and turns with the heading; the point q adds ``|q| |delta|``.
5. *Rounding.* A distance is the result of fewer than 2^10 float64 operations on numbers below the scale
   ``1 + |x| + |y| + |theta| + path`` plus the largest coordinate and radius of the map; `DISTANCE_ROUNDING` of it is
   2^14 units in the last place.

**Whole area.** The polygon test refuses a footprint that contains an obstacle. If the outline of every
placement in the cell stays clear of an obstacle, that obstacle is inside all placements or none, as they
change continuously.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from viatool.arrays import Booleans, Floats, Indices
from viatool.motion.arcs import advance
from viatool.motion.manoeuvre import Manoeuvre
from viatool.rounding import DISTANCE_ROUNDING
from viatool.safety.situations import Situations
from viatool.world import Footprint

LINEAR, ANGULAR, FRACTION = 0, 1, 2
POSE = 3  # the first of three columns


@dataclass(frozen=True, eq=False)
class MotionBoxes:
    """C boxes of commands and fractions, each belonging to one state.

    Parameters
    ----------
    state : ndarray
        (C,) index of the state.
    lower, upper : ndarray
        (C, 3) ends of v in m/s, omega in rad/s, and the fraction of the path in [0, 1]; or (C, 6), with the ends
        of what is added to x, y and theta of the state.
    """

    state: Indices
    lower: Floats
    upper: Floats

    def __len__(self) -> int:
        """Return the number of cells."""
        return len(self.state)

    @classmethod
    def whole(cls, lower: Floats, upper: Floats, radii: Floats | None = None) -> MotionBoxes:
        """Return one cell for each state: action box (B, 2), whole path, and poses within radii (B, 3)."""
        ones = np.ones((len(lower), 1))
        offsets = [] if radii is None else [radii]
        return cls(
            np.arange(len(lower)),
            np.hstack([lower, 0.0 * ones, *(-offset for offset in offsets)]),
            np.hstack([upper, ones, *offsets]),
        )

    def select(self, which: Booleans) -> MotionBoxes:
        """Return some of the cells."""
        return MotionBoxes(self.state[which], self.lower[which], self.upper[which])

    def halved(self, axis: Indices) -> MotionBoxes:
        """Return both halves of every cell, cut across its given axis (C,)."""
        middle = 0.5 * (self.lower + self.upper)
        cut = axis[:, None] == np.arange(middle.shape[1])
        upper, lower = np.where(cut, middle, self.upper), np.where(cut, middle, self.lower)
        return MotionBoxes(
            np.concatenate([self.state, self.state]),
            np.concatenate([self.lower, lower]),
            np.concatenate([upper, self.upper]),
        )


@dataclass(frozen=True, eq=False)
class Enclosure:
    """What the geometry says of C cells, in metres.

    Parameters
    ----------
    least : ndarray
        (C,) a lower bound of the clearance of the footprint over the whole cell.
    attained : ndarray
        (C,) an upper bound of the clearance that the centre command attains at some fraction of the cell.
    shares : ndarray
        (C, 3) or (C, 6) how much the extent along v, omega, the fraction and the pose widens the enclosure.
    """

    least: Floats
    attained: Floats
    shares: Floats


def enclose(
    cells: MotionBoxes, situations: Situations, manoeuvre: Manoeuvre, footprint: Footprint
) -> Enclosure:
    """Bound the clearance of the footprint over cells.

    Parameters
    ----------
    cells : MotionBoxes
        C cells.
    situations : Situations
        The B states that the cells belong to.
    manoeuvre : Manoeuvre
        How a command becomes a path.
    footprint : Footprint
        Outline in the robot's frame.

    Returns
    -------
    Enclosure
        C bounds.

    Notes
    -----
    Sound: yes, by the derivation at the top of this module.
    """
    here, centre = situations.select(cells.state), 0.5 * (cells.lower + cells.upper)
    if cells.lower.shape[1] > POSE:
        here = here.moved(here.poses + centre[:, POSE:])
    actions, start, end = centre[:, :2], cells.lower[:, FRACTION], cells.upper[:, FRACTION]
    seconds = manoeuvre.seconds(np.abs(actions[:, 0]), np.abs(actions[:, 1]))
    length, turn = np.abs(actions[:, 0]) * seconds, np.abs(actions[:, 1]) * seconds
    rim = footprint.reach if footprint.kind == "polygon" else 0.0
    path = manoeuvre.longest(cells.lower[:, :2], cells.upper[:, :2])
    rounding = DISTANCE_ROUNDING * (here.scale + np.abs(here.poses).sum(axis=1) + path + footprint.reach)
    if footprint.kind == "polygon":
        middle = advance(here.poses, actions, seconds * centre[:, FRACTION])
        clearance = here.scenes.footprint_clearance(middle, footprint, here.scene)
        between = outline_motion(length, turn, end - start, rim)
        attained = clearance + rounding
    else:
        first, last = (advance(here.poses, actions, seconds * at)[:, :2] for at in (start, end))
        clearance = here.scenes.segment_clearance(first, last, here.scene) - footprint.radius
        between = sagitta(length, turn, end - start)
        attained = clearance + between + rounding
    deviation = command_deviation(cells, manoeuvre, rim)
    radius = 0.5 * (cells.upper - cells.lower) * seconds[:, None]
    shares = np.column_stack([end * radius[:, 0], end * (0.5 * end * length + rim) * radius[:, 1], between])
    if cells.lower.shape[1] > POSE:
        away, turned = pose_deviation(cells, end * length, rim)
        deviation = deviation + away + turned
        aside = 0.5 * (cells.upper - cells.lower)[:, POSE : POSE + 2]
        shares = np.column_stack([shares, aside, turned])
    return Enclosure(clearance - deviation - between - rounding, attained, shares)


def pose_deviation(cells: MotionBoxes, way: Floats, rim: float) -> tuple[Floats, Floats]:
    """Bound how far poses of cells bring a footprint point from where the centre pose brings it.

    Parameters
    ----------
    cells : MotionBoxes
        C cells with poses.
    way : ndarray
        (C,) metres that the centre command drives at most.
    rim : float
        As in `command_deviation`.

    Returns
    -------
    tuple of ndarray
        (C,) metres for other places, and for other headings (term 4).
    """
    radius = 0.5 * (cells.upper - cells.lower)[:, POSE:]
    return np.hypot(radius[:, 0], radius[:, 1]), np.asarray((way + rim) * radius[:, 2])


def command_deviation(cells: MotionBoxes, manoeuvre: Manoeuvre, rim: float) -> Floats:
    """Bound how far any command of a cell brings a footprint point from where the centre command brings it.

    Parameters
    ----------
    cells : MotionBoxes
        C cells.
    manoeuvre : Manoeuvre
        How a command becomes a path.
    rim : float
        Largest distance of a footprint point from the robot's origin, metres; 0 if its heading is irrelevant.

    Returns
    -------
    ndarray
        (C,) metres, at equal fractions of the path.

    Notes
    -----
    Sound: yes, up to the rounding that `enclose` adds (term 1 of the module's derivation).
    """
    centre = 0.5 * (cells.lower + cells.upper)
    length = _path(centre[:, 0], centre[:, 1], manoeuvre)[0]
    length_radius, turn_radius = path_radii(cells, manoeuvre)
    until = cells.upper[:, FRACTION]
    forward, heading = until * length_radius, until * turn_radius
    return np.asarray(forward + sideways(until * np.abs(length), heading) + rim * heading)


def path_radii(cells: MotionBoxes, manoeuvre: Manoeuvre) -> tuple[Floats, Floats]:
    """Bound ``|l - l_c|`` in metres and ``|phi - phi_c|`` in radians over cells, each (C,)."""
    centre = 0.5 * (cells.lower + cells.upper)
    length, turn = _path(centre[:, 0], centre[:, 1], manoeuvre)
    low, high = np.abs(cells.lower), np.abs(cells.upper)
    largest = np.maximum(low, high)
    smallest = np.where(cells.lower * cells.upper > 0.0, np.minimum(low, high), 0.0)
    length_radius, turn_radius = np.zeros(len(cells)), np.zeros(len(cells))
    for end in (cells.lower, cells.upper):
        for other in (smallest, largest):
            at_end = _path(end[:, 0], other[:, 1], manoeuvre)[0]
            length_radius = np.maximum(length_radius, np.abs(at_end - length))
            at_end = _path(other[:, 0], end[:, 1], manoeuvre)[1]
            turn_radius = np.maximum(turn_radius, np.abs(at_end - turn))
    return length_radius, turn_radius


def sideways(length: Floats, heading: Floats) -> Floats:
    """Bound how far apart two arcs of one length end whose turns differ by `heading` (term 1)."""
    return np.asarray(0.5 * length * heading)


def sagitta(length: Floats, turn: Floats, span: Floats) -> Floats:
    """Bound how far an arc leaves its chord between two fractions that are `span` apart (term 2)."""
    return np.asarray(0.125 * length * turn * np.square(span))


def outline_motion(length: Floats, turn: Floats, span: Floats, rim: float) -> Floats:
    """Bound how far an outline moves from the middle of a `span` of fractions to its ends (term 3)."""
    return np.asarray(0.5 * (length + rim * turn) * span)


def _path(linear: Floats, angular: Floats, manoeuvre: Manoeuvre) -> tuple[Floats, Floats]:
    """Return arc length and turn of the whole path, signed."""
    seconds = manoeuvre.seconds(np.abs(linear), np.abs(angular))
    return linear * seconds, angular * seconds
