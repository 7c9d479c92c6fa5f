"""The differential drive: two wheels, which drive ahead and turn, and never slip sideways."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from viatool.arrays import Floats
from viatool.motion.law import Axis, Limited
from viatool.motion.twists import HeldTwist, Part


class DifferentialDrive(HeldTwist):
    """A command is a speed v ahead and a turning speed omega, which the robot has at once."""

    name: ClassVar[str] = "differential"
    description: ClassVar[str] = "differential drive without slip"
    axes: ClassVar[tuple[Axis, ...]] = (Axis("v", "m/s", "linear"), Axis("omega", "rad/s", "angular"))
    velocity: ClassVar[tuple[Part, ...]] = ("ahead", "turn")

    @property
    def takes(self) -> tuple[tuple[str, ...], ...]:
        """Return a twist, or the speeds of the rims of both wheels."""
        return (*super().takes, ("left_wheel", "right_wheel"))

    def limits(self, robot: Limited) -> tuple[Floats, Floats]:
        """See `Kinematics.limits`."""
        return (
            np.array([robot.min_linear, -robot.max_angular]),
            np.array([robot.max_linear, robot.max_angular]),
        )
