"""The holonomic drive: legs or wheels that let a robot drive ahead, to its side, and turn, all at once."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from viatool.arrays import Floats
from viatool.motion.law import Axis, Limited
from viatool.motion.twists import HeldTwist, Part


class HolonomicDrive(HeldTwist):
    """A command is a speed ahead, a turning speed, and a speed to the left, which the robot has at once.

    The first two axes are those of a differential drive, so that a robot which does not slide is one of its kind.
    """

    name: ClassVar[str] = "holonomic"
    description: ClassVar[str] = "holonomic drive without slip"
    axes: ClassVar[tuple[Axis, ...]] = (
        Axis("v", "m/s", "linear"),
        Axis("omega", "rad/s", "angular"),
        Axis("side", "m/s", "lateral"),
    )
    velocity: ClassVar[tuple[Part, ...]] = ("ahead", "turn", "left")

    def limits(self, robot: Limited) -> tuple[Floats, Floats]:
        """See `Kinematics.limits`."""
        return (
            np.array([robot.min_linear, -robot.max_angular, -robot.max_lateral]),
            np.array([robot.max_linear, robot.max_angular, robot.max_lateral]),
        )
