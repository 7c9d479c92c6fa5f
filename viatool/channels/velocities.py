"""The velocity that the robot has, as its odometry measures it."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from viatool.arrays import Floats, Indices, Reals
from viatool.channels.quantity import Quantity, observes
from viatool.channels.views import BoxView, Extent, RecordedInstants, View
from viatool.motion.kinematics import kinematics_of
from viatool.motion.twists import PARTS, HeldTwist, Part
from viatool.sets.forms import Forms


class MeasuredVelocity(Quantity):
    """One part of the velocity in the robot's frame."""

    believes = False
    part: ClassVar[Part]
    sign: ClassVar[float] = 1.0

    def measure(self, view: View) -> Reals:
        """Return the velocity at the end of the interval; without one, that of the command before."""
        if view.velocity is not None:
            return view.velocity[:, PARTS.index(self.part)]
        return self._twist.parts(view.previous)[PARTS.index(self.part)]

    def record(self, recorded: RecordedInstants) -> Floats:
        """Return the velocity that the odometry measured."""
        return recorded.velocities[:, PARTS.index(self.part)]

    def enclose(self, view: BoxView) -> Forms:
        """Return the command before: a robot without actuator dynamics has the velocity that it was told to have."""
        axis = self._axis
        return view.constant(0.0, 1) if axis is None else view.command(axis)

    def bounds(self, extent: Extent) -> tuple[float, float]:
        """Return the robot's limits."""
        axis = self._axis
        if axis is None:
            return 0.0, 0.0
        lower, upper = self._twist.limits(self.robot)
        return float(lower[axis]), float(upper[axis])

    def mirror(self) -> tuple[Indices, Floats]:
        """Return the speed ahead as it is, the others turned round."""
        return np.arange(1), np.full(1, self.sign)

    @property
    def _twist(self) -> HeldTwist:
        """Return the robot's kinematics, by which a command is a velocity."""
        kinematics = kinematics_of(self.robot.kinematics)
        if not isinstance(kinematics, HeldTwist):
            raise self.lacks("measure")
        return kinematics

    @property
    def _axis(self) -> int | None:
        """Return which number of a command this part is; None for a robot that never moves so."""
        velocity = self._twist.velocity
        return velocity.index(self.part) if self.part in velocity else None


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
