"""What runs keep during an interval, from boxes of states, under boxes of commands: for what follows them over time."""

from __future__ import annotations

import numpy as np

from viatool.arrays import Booleans, Floats
from viatool.loop.closed_loop import ClosedLoop
from viatool.motion.carried import motion_of_sets
from viatool.safety.enclosure import MotionBoxes, enclose
from viatool.safety.proof import prove_clearance
from viatool.safety.varying import enclose_varying
from viatool.sets.forms import PoseBoxes
from viatool.sets.states import StateBoxes


def clearance_kept(
    loop: ClosedLoop, cells: StateBoxes, start: StateBoxes, lower: Floats, upper: Floats
) -> tuple[Floats, Booleans]:
    """Return what runs keep until they would receive another command, and stop if that is asked.

    Parameters
    ----------
    loop : ClosedLoop
        What is asked.
    cells : StateBoxes
        P boxes of states in which an interval begins.
    start : StateBoxes
        P boxes around the sets from which it begins, which hold them as well.
    lower, upper : ndarray
        (P, A) what may be commanded there.

    Returns
    -------
    tuple of ndarray
        (P,) metres, and whether more than the collision distance is kept from every pose that keeps it.

    Notes
    -----
    Sound: yes, at every instant.
    """
    rules, held = loop.rules, loop.given_in(start, lower, upper)
    boxes = MotionBoxes.whole(*held, cells.poses.radius)
    if rules.over_time is not None:
        motion = motion_of_sets(rules.over_time, cells)
        least = enclose_varying(boxes, loop.among_all(cells.poses), motion, rules.footprint).least
        proved = least > rules.clearance.collision
        rest = np.flatnonzero(~proved)
        some = cells.poses.select(rest)
        proved[rest] = loop.keeps(motion.select(rest), some, lower[rest], upper[rest])
        return least, proved
    least = enclose(boxes, loop.among_all(cells.poses), rules.manoeuvre, rules.footprint).least
    strayed = rules.strayed(*held)
    if strayed is not None:
        least = least - strayed.nearer(rules.footprint.reach)
    proved = least > rules.clearance.collision
    rest = np.flatnonzero(~proved)
    proved[rest] = loop.holds(cells.select(rest), lower[rest], upper[rest])
    return least, proved


def begins_clear(loop: ClosedLoop, boxes: PoseBoxes) -> Booleans:
    """Tell in which boxes every pose keeps the collision distance, (C,). **Sound:** yes."""
    rules = loop.rules
    still = rules.standing(len(boxes))
    return prove_clearance(
        loop.among_all(boxes), still, still, rules.clearance.collision, rules.manoeuvre, rules.footprint
    ).proved
