"""Where the command before has brought the robot when the next one begins to act."""

from __future__ import annotations

import numpy as np

from viatool.arrays import Floats
from viatool.motion.arcs import advance
from viatool.motion.manoeuvre import Manoeuvre
from viatool.rounding import SIGHT_ROUNDING
from viatool.safety.enclosure import MotionBoxes, command_deviation, path_radii, pose_deviation
from viatool.sets.forms import PoseBoxes


def after_waiting(boxes: PoseBoxes, waiting: Manoeuvre, lower: Floats, upper: Floats) -> PoseBoxes:
    """Enclose where commands that are held for a dead time bring the robot.

    Parameters
    ----------
    boxes : PoseBoxes
        C boxes of poses.
    waiting : Manoeuvre
        The dead time, without braking.
    lower, upper : ndarray
        (C, 2) the commands before.

    Returns
    -------
    PoseBoxes
        C boxes around where the middles of both lead.

    Notes
    -----
    Sound: yes. A pose that is D away and turned by delta is still D away, up to ``|way| |delta|``; other commands add
    what they add to any path (terms 1 and 4 of `viatool.safety.enclosure`).
    """
    once = np.ones((len(boxes), 1))
    cells = MotionBoxes(
        np.arange(len(boxes)), np.hstack([lower, once, -boxes.radius]), np.hstack([upper, once, boxes.radius])
    )
    held = 0.5 * (lower + upper)
    seconds = waiting.seconds(np.abs(held[:, 0]), np.abs(held[:, 1]))
    centre = advance(boxes.centre, held, seconds)
    turned = pose_deviation(cells, np.abs(held[:, 0]) * seconds, 0.0)[1]
    aside = command_deviation(cells, waiting, 0.0) + turned
    slack = SIGHT_ROUNDING * (1.0 + np.abs(centre).sum(axis=1))
    wider = np.stack([aside, aside, path_radii(cells, waiting)[1]], axis=1)
    return PoseBoxes(centre, boxes.radius + wider + slack[:, None])
