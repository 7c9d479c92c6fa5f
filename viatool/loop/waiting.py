"""Where the command before has brought the robot when the next one begins to act."""

from __future__ import annotations

import numpy as np

from viatool.arrays import Floats
from viatool.motion.manoeuvre import Manoeuvre
from viatool.rounding import SIGHT_ROUNDING
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
        (C, A) the commands before.

    Returns
    -------
    PoseBoxes
        C boxes around where the middles of both lead.

    Notes
    -----
    Sound: yes. A pose that is D away and turned by delta is still D away, up to ``|way| |delta|``; other commands add
    what they add to any path (`Kinematics.from_elsewhere` and `Kinematics.deviation`).
    """
    held, once = 0.5 * (lower + upper), np.ones(len(boxes))
    centre = waiting.path(boxes.centre, held, once)
    turned = waiting.kinematics.from_elsewhere(boxes.radius, waiting.extent(held)[0], 0.0)[1]
    others = waiting.deviation(lower, upper, once)
    aside = others.away + turned
    slack = SIGHT_ROUNDING * (1.0 + np.abs(centre).sum(axis=1))
    wider = np.stack([aside, aside, others.turned], axis=1)
    return PoseBoxes(centre, boxes.radius + wider + slack[:, None])
