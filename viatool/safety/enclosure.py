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
5. *Rounding.* A distance is the result of fewer than 2^10 float64 operations on numbers below the scale
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
        A, of a command.
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
    seconds, (length, turn) = manoeuvre.duration(actions), manoeuvre.extent(actions)
    rim = footprint.reach if footprint.kind == "polygon" else 0.0
    way = manoeuvre.longest(lower, upper)
    rounding = DISTANCE_ROUNDING * (
        here.scale + np.abs(here.poses).sum(axis=1) + way + turn + footprint.reach
    )
    if footprint.kind == "polygon":
        middle = move.advance(here.poses, actions, seconds * (0.5 * (start + end)))
        clearance = here.scenes.footprint_clearance(middle, footprint, here.scene)
        between = move.outline_motion(length, turn, end - start, rim)
        attained = clearance + rounding
    else:
        first, last = (move.advance(here.poses, actions, seconds * at)[:, :2] for at in (start, end))
        clearance = here.scenes.segment_clearance(first, last, here.scene) - footprint.radius
        between = move.sagitta(length, turn, end - start)
        attained = clearance + between + rounding
    others = manoeuvre.deviation(lower, upper, end, rim)
    deviation = others.away + rim * others.turned
    shares = np.column_stack([others.shares, between])
    if cells.offsets is not None:
        radii = 0.5 * (cells.offsets[1] - cells.offsets[0])
        away, turned = move.from_elsewhere(radii, end * length, rim)
        deviation = deviation + away + turned
        shares = np.column_stack([shares, radii[:, :2], turned])
    least = clearance - deviation - between - rounding
    held = (cells.lower <= cells.upper).all(axis=1)  # ends that are crossed, or NaN, bound nothing
    return ClearanceEnclosure(np.where(held, least, -np.inf), np.where(held, attained, np.inf), shares)
