"""Proof or refutation for every command of a box and every instant, cutting what stays undecided."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from viatool.arrays import Booleans, Floats
from viatool.motion.manoeuvre import Manoeuvre
from viatool.motion.profile import VaryingMotion
from viatool.safety.compiled import decide, question_of
from viatool.safety.enclosure import MotionBoxes, enclose
from viatool.safety.scene_poses import ScenePoses
from viatool.safety.varying import enclose_varying, keep_at_best
from viatool.sets.bounds import require_ordered
from viatool.world import Footprint

_FEW = 2000
"""Cells of which a step costs more than the cells do, among things that move."""
_TRIED = 2
"""Levels after which it is asked again whether cutting is in vain."""


@dataclass(frozen=True)
class ProofEffort:
    """How far to cut.

    Parameters
    ----------
    levels : int
        How often a box is halved at most; 0 for the first test alone.
    cells : int
        Undecided pieces of one state above which the state is given up.
    tolerance : float
        Pieces whose enclosure is widened by less than this many metres are not cut again.
    """

    levels: int = 48
    cells: int = 256
    tolerance: float = 1e-6


@dataclass(frozen=True, eq=False)
class Proof:
    """What is known of B states; a state that is neither is undecided.

    Parameters
    ----------
    proved : ndarray
        (B,) every command of the box keeps more than the threshold for the whole path.
    refuted : ndarray
        (B,) some command of the box comes nearer than the threshold, from some pose.
    """

    proved: Booleans
    refuted: Booleans


def prove_clearance(
    placed: ScenePoses,
    lower: Floats,
    upper: Floats,
    threshold: float,
    manoeuvre: Manoeuvre | VaryingMotion,
    footprint: Footprint,
    effort: ProofEffort | None = None,
) -> Proof:
    """Decide whether the footprint keeps its clearance for every command of a box over the whole path.

    Parameters
    ----------
    placed : ScenePoses
        B states, each a pose or a box of poses.
    lower, upper : ndarray
        (B, A) action boxes as the robot carries them out, of a differential drive in m/s and rad/s; behind them the
        state of the motion, if it has one.
    threshold : float
        The clearance to be exceeded, in metres.
    manoeuvre : Manoeuvre or VaryingMotion
        How a command becomes a path, or what the B robots may do that are given one.
    footprint : Footprint
        Outline in the robot's frame; its whole area counts.
    effort : ProofEffort, optional
        Where to stop.

    Returns
    -------
    Proof
        Of B states.

    Raises
    ------
    BoundsError
        If an action box or a box of poses is empty or NaN.

    Notes
    -----
    Sound: yes, `proved` by the enclosure of every piece; `refuted` likewise, by a command that fails for
    certain. The pieces of one state cover its box at every level: a piece leaves only when it is proved,
    and what is NaN is neither proved nor refuted.
    Cost: one distance query per state that the first test decides, and a few per level for one that lies on
    the edge.
    """
    effort = effort or ProofEffort()
    require_ordered("commands", lower, upper)
    if placed.radii is not None:
        require_ordered("half-widths of poses", np.zeros_like(placed.radii), placed.radii)
    question = question_of(placed, manoeuvre, footprint, threshold, effort)
    if question is not None:
        return Proof(*decide(question, placed, lower, upper))
    proved, refuted = np.ones(len(lower), dtype=bool), np.zeros(len(lower), dtype=bool)
    cells = MotionBoxes.whole(lower, upper, placed.radii)
    for level in range(effort.levels + 1):
        if isinstance(manoeuvre, VaryingMotion):
            found = enclose_varying(cells, placed, manoeuvre, footprint)
        else:
            found = enclose(cells, placed, manoeuvre, footprint)
        refuted[cells.state[found.attained < threshold]] = True
        open_ = ~(found.least > threshold) & ~refuted[cells.state]
        cells, shares = cells.select(open_), found.shares[open_]
        crowded = np.bincount(cells.state, minlength=len(lower)) > effort.cells
        hopeless = cells.state[~(shares.sum(axis=1) >= effort.tolerance)]
        crowded[hopeless] = True
        if isinstance(manoeuvre, VaryingMotion) and len(cells) and level % _TRIED == 0:
            tried = cells.corners() if level == 0 else cells
            best = keep_at_best(tried, placed, manoeuvre, footprint)
            crowded[tried.state[best < threshold]] = True
        if level == effort.levels:
            crowded[cells.state] = True
        proved[crowded] = False
        kept = ~crowded[cells.state]
        cells, shares = cells.select(kept), shares[kept]
        if not len(cells):
            break
        axis = shares.argmax(axis=1)
        cells = cells.halved(axis)
        if isinstance(manoeuvre, VaryingMotion) or (
            placed.movers and len(cells) < _FEW
        ):  # whose steps cost more than their cells
            shares[np.arange(len(shares)), axis] *= 0.5
            cells = cells.halved(np.tile(shares.argmax(axis=1), 2))
    return Proof(proved & ~refuted, refuted)
