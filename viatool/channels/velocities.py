"""The velocity that the robot has, as its odometry measures it."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np

from viatool.arrays import Floats, Indices, Reals
from viatool.channels.quantity import Quantity, observes
from viatool.channels.views import BoxView, Extent, RecordedInstants, View
from viatool.motion.kinematics import kinematics_of
from viatool.motion.twists import HeldTwist
from viatool.sets.forms import Forms


class MeasuredVelocity(Quantity):
    """One part of the velocity in the robot's frame."""

    part: ClassVar[Literal["ahead", "left", "turn"]]
    sign: ClassVar[float] = 1.0

    def measure(self, view: View) -> Reals:
        """Return the velocity at the end of the interval; without one, that of the command before."""
        number = ("ahead", "left", "turn").index(self.part)
        if view.velocity is not None:
            return view.velocity[:, number]
        kinematics = kinematics_of(self.robot.kinematics)
        return (
            kinematics.parts(view.previous)[number] if isinstance(kinematics, HeldTwist) else self._unknown()
        )

    def record(self, recorded: RecordedInstants) -> Floats:
        """Return the velocity that the odometry measured."""
        return recorded.velocities[:, ("ahead", "left", "turn").index(self.part)]

    def enclose(self, view: BoxView) -> Forms:
        """Return the command before: a robot without actuator dynamics has the velocity that it was told to have."""
        kinematics = kinematics_of(self.robot.kinematics)
        if not isinstance(kinematics, HeldTwist):
            self._unknown()
        elif self.part in kinematics.velocity:
            return view.command(kinematics.velocity.index(self.part))
        return view.constant(0.0, 1)

    def bounds(self, extent: Extent) -> tuple[float, float]:
        """Return the robot's limits."""
        kinematics = kinematics_of(self.robot.kinematics)
        if not isinstance(kinematics, HeldTwist):
            self._unknown()
        elif self.part in kinematics.velocity:
            lower, upper = kinematics.limits(self.robot)
            axis = kinematics.velocity.index(self.part)
            return float(lower[axis]), float(upper[axis])
        return 0.0, 0.0

    def mirror(self) -> tuple[Indices, Floats]:
        """Return the speed ahead as it is, the others turned round."""
        return np.arange(1), np.full(1, self.sign)

    def _unknown(self) -> Floats:
        raise self.lacks("measure")


@observes("linear_velocity")
class LinearVelocity(MeasuredVelocity):
    """The speed ahead, in m/s."""

    part = "ahead"


@observes("lateral_velocity")
class LateralVelocity(MeasuredVelocity):
    """The speed to the left, in m/s."""

    part, sign = "left", -1.0


@observes("angular_velocity")
class AngularVelocity(MeasuredVelocity):
    """The turning speed, in rad/s, counter-clockwise."""

    part, sign = "turn", -1.0
