"""Where the robot's footprint can be: one shape and one radius for a whole box of commands and instants.

A *cell* is a box of commands and fractions s of the path (see `motion`). It is enclosed by the motion of its centre
command, widened by a radius that bounds how far any point of the footprint can be from where the centre command brings
it at the same fraction. The kinematics says how far paths are apart; a path of length l turns by phi.

1. *Other commands.* The robot's origin is away from that of the centre command, and its heading is turned; the
   footprint's point q turns with the heading, which adds at most ``|q|`` times that (`Kinematics.deviation`).
2. *Other fractions, round footprints.* Between s_0 and s_1 the position follows the chord up to the sagitta, so the
   chord, widened by it and the footprint's radius, holds the disc at every instant (`Kinematics.sagitta`).
3. *Other fractions, polygons.* The outline is placed at the middle fraction, and moves from there until s_0 or s_1 by
   no more than `Kinematics.outline_motion`.
4. *Other poses.* A state may be a box of poses. From a pose that is D away and turned by delta, a command brings
   the robot at most ``|D| + s |l| |delta|`` away from where it brings it from the centre pose, as the way to
   there is at most ``s |l|`` long and turns with the heading; the point q adds ``|q| |delta|``.
5. *What moves* may be ``speed t`` from where it was observed. Where it was is as far from the cell as 1 to 4 say, and
   t is at most that of the fastest command of the cell at s_1 (`Manoeuvre.counted_between`). What goes straight at the
   robot attains that distance at the same instant, at which t is at least that of the centre command at s_0.
6. *Rounding.* A distance is the result of fewer than 2^10 float64 operations on numbers below the scale
   ``1 + |x| + |y| + |theta| + path + turn`` plus the largest coordinate and radius of the map; `DISTANCE_ROUNDING` of
   it is 2^14 units in the last place.

**Whole area.** The polygon test refuses a footprint that contains an obstacle. If the outline of every
placement in the cell stays clear of an obstacle, that obstacle is inside all placements or none, as they
change continuously.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from viatool.arrays import Booleans, Floats, Indices
from viatool.motion.manoeuvre import Manoeuvre
from viatool.rounding import DISTANCE_ROUNDING
from viatool.safety.scene_poses import ScenePoses
from viatool.world import Footprint


@dataclass(frozen=True, eq=False)
class MotionBoxes:
    """C boxes of commands and fractions, each belonging to one state.

    Parameters
    ----------
    state : ndarray
        (C,) index of the state.
    lower, upper : ndarray
        (C, A + 1) ends of the command, for a differential drive v in m/s and omega in rad/s, and of the fraction of the
        path in [0, 1]; or (C, A + 4), with the ends of what is added to x, y and theta of the state.
    axes : int
        A, of a command, and of the state of the motion behind it.
    """

    state: Indices
    lower: Floats
    upper: Floats
    axes: int = 2

    def __len__(self) -> int:
        """Return the number of cells."""
        return len(self.state)

    @classmethod
    def whole(cls, lower: Floats, upper: Floats, radii: Floats | None = None) -> MotionBoxes:
        """Return one cell for each state: action box (B, A), whole path, and poses within radii (B, 3)."""
        ones = np.ones((len(lower), 1))
        offsets = [] if radii is None else [radii]
        return cls(
            np.arange(len(lower)),
            np.hstack([lower, 0.0 * ones, *(-offset for offset in offsets)]),
            np.hstack([upper, ones, *offsets]),
            lower.shape[1],
        )

    @property
    def commands(self) -> tuple[Floats, Floats]:
        """Return the ends of the commands, (C, A)."""
        return self.lower[:, : self.axes], self.upper[:, : self.axes]

    @property
    def fractions(self) -> tuple[Floats, Floats]:
        """Return the ends of the fractions, (C,)."""
        return self.lower[:, self.axes], self.upper[:, self.axes]

    @property
    def offsets(self) -> tuple[Floats, Floats] | None:
        """Return the ends of what is added to poses, (C, 3); None where that is nothing."""
        first = self.axes + 1
        return (self.lower[:, first:], self.upper[:, first:]) if self.lower.shape[1] > first else None

    def select(self, which: Booleans) -> MotionBoxes:
        """Return some of the cells."""
        return replace(self, state=self.state[which], lower=self.lower[which], upper=self.upper[which])

    def corners(self) -> MotionBoxes:
        """Return every corner of the commands of every cell as a cell, and their middle."""
        count, (lower, upper) = 2**self.axes, self.commands
        bits = (np.arange(count)[:, None] >> np.arange(self.axes)) & 1
        commands = [*(np.where(corner, upper, lower) for corner in bits), 0.5 * (lower + upper)]
        ends = [
            [np.hstack([command, end[:, self.axes :]]) for command in commands]
            for end in (self.lower, self.upper)
        ]
        return replace(
            self,
            state=np.tile(self.state, len(commands)),
            lower=np.concatenate(ends[0]),
            upper=np.concatenate(ends[1]),
        )

    def halved(self, axis: Indices) -> MotionBoxes:
        """Return both halves of every cell, cut across its given axis (C,)."""
        middle = 0.5 * (self.lower + self.upper)
        cut = axis[:, None] == np.arange(middle.shape[1])
        upper, lower = np.where(cut, middle, self.upper), np.where(cut, middle, self.lower)
        return replace(
            self,
            state=np.concatenate([self.state, self.state]),
            lower=np.concatenate([self.lower, lower]),
            upper=np.concatenate([upper, self.upper]),
        )


@dataclass(frozen=True, eq=False)
class ClearanceEnclosure:
    """What the geometry says of C cells, in metres.

    Parameters
    ----------
    least : ndarray
        (C,) a lower bound of the clearance of the footprint over the whole cell.
    attained : ndarray
        (C,) an upper bound of the clearance that the centre command attains at some fraction of the cell.
    shares : ndarray
        (C, A + 1) or (C, A + 4) how much the extent along the command, the fraction and the pose widens the enclosure.
    """

    least: Floats
    attained: Floats
    shares: Floats


def enclose(
    cells: MotionBoxes, placed: ScenePoses, manoeuvre: Manoeuvre, footprint: Footprint
) -> ClearanceEnclosure:
    """Bound the clearance of the footprint over cells.

    Parameters
    ----------
    cells : MotionBoxes
        C cells.
    placed : ScenePoses
        The B states that the cells belong to.
    manoeuvre : Manoeuvre
        How a command becomes a path.
    footprint : Footprint
        Outline in the robot's frame.

    Returns
    -------
    ClearanceEnclosure
        C bounds.

    Notes
    -----
    Sound: yes, by the derivation at the top of this module.
    """
    here, (start, end) = placed.select(cells.state), cells.fractions
    if cells.offsets is not None:
        here = here.moved(here.poses + 0.5 * (cells.offsets[0] + cells.offsets[1]))
    lower, upper = cells.commands
    actions, move = 0.5 * (lower + upper), manoeuvre.kinematics
    earliest, latest = _times(cells, here, manoeuvre, actions)
    length, turn = manoeuvre.extent(actions)
    rim = footprint.reach if footprint.kind == "polygon" else 0.0
    way = manoeuvre.longest(lower, upper)
    rounding = DISTANCE_ROUNDING * (
        here.scale + np.abs(here.poses).sum(axis=1) + way + turn + footprint.reach + here.fastest * latest
    )
    if footprint.kind == "polygon":
        middle = manoeuvre.path(here.poses, actions, 0.5 * (start + end))
        clearance, attained = here.moved(middle).footprint_clearance(footprint, latest, earliest)
        between = move.outline_motion(length, turn, end - start, rim)
        attained = attained + rounding
    else:
        first, last = (manoeuvre.path(here.poses, actions, at)[:, :2] for at in (start, end))
        clearance, attained = (
            away - footprint.radius for away in here.segment_clearance(first, last, latest, earliest)
        )
        between = manoeuvre.sagitta(actions, end - start)
        attained = attained + between + rounding
    if here.movers:
        attained = np.minimum(attained, _at_the_end(here, manoeuvre, actions, end, footprint) + rounding)
    others = manoeuvre.deviation(lower, upper, end, rim)
    deviation = others.away + rim * others.turned
    waited = _waited(cells, manoeuvre, actions, here.fastest)
    shares = np.column_stack([others.shares + waited[:, :-1], between + waited[:, -1]])
    if cells.offsets is not None:
        radii = 0.5 * (cells.offsets[1] - cells.offsets[0])
        away, turned = move.from_elsewhere(radii, end * length, rim)
        deviation = deviation + away + turned
        shares = np.column_stack([shares, radii[:, :2], turned])
    least = clearance - deviation - between - rounding
    held = (cells.lower <= cells.upper).all(axis=1)  # ends that are crossed, or NaN, bound nothing
    return ClearanceEnclosure(np.where(held, least, -np.inf), np.where(held, attained, np.inf), shares)


def _at_the_end(
    here: ScenePoses, manoeuvre: Manoeuvre, actions: Floats, end: Floats, footprint: Footprint
) -> Floats:
    """Return what commands leave at the fractions at which cells end, (C,): mostly the least, as things come nearer."""
    last = here.moved(manoeuvre.path(here.poses, actions, end))
    at_least = manoeuvre.counted_between(actions, actions, actions, end, end)[0]
    return last.footprint_clearance(footprint, at_least)[0]


def _times(
    cells: MotionBoxes, here: ScenePoses, manoeuvre: Manoeuvre, actions: Floats
) -> tuple[Floats, Floats]:
    """Return for how long things have moved at least when the centre is in a cell, and at most in any state of it."""
    if not here.movers:
        return np.zeros(len(cells)), np.zeros(len(cells))
    return manoeuvre.counted_between(actions, *cells.commands, *cells.fractions)


def _waited(cells: MotionBoxes, manoeuvre: Manoeuvre, actions: Floats, fastest: Floats) -> Floats:
    """Return how far things get in the time that the extent along each command and the fraction adds, (C, A + 1)."""
    found = np.zeros((len(cells), cells.axes + 1))
    rows = np.flatnonzero(fastest > 0.0)
    if not len(rows):
        return found
    lower, upper = (end[rows] for end in cells.commands)
    start, end = (at[rows] for at in cells.fractions)
    centre = actions[rows]
    begin, least = manoeuvre.counted_between(centre, centre, centre, start, end)
    found[rows, -1] = least - begin
    for axis in range(cells.axes):
        wide = np.arange(cells.axes) == axis
        low, high = (np.where(wide, bound, centre) for bound in (lower, upper))
        found[rows, axis] = manoeuvre.counted_between(centre, low, high, start, end)[1] - least
    return found * fastest[:, None]
