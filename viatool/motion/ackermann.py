"""Cars: wheels in front that steer, wheels behind that roll where the body points."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np

from viatool.arrays import Floats
from viatool.motion.law import Axis, Kinematics, Limited
from viatool.motion.steered import check_steering, slowly_steered
from viatool.motion.twists import HeldTwist, Part


class AckermannDrive(HeldTwist):
    """A command is a speed v of the middle of the rear axle, and the turning speed that it has at a steering angle.

    The robot's origin is the middle of the rear axle, which never slips sideways, so ``omega = v tan(steering) /
    wheelbase``. The steering angle is taken to be reached at once, unless the robot has a `max_steering_rate`: then it
    moves as a `SlowlySteeredCar`. While a car brakes the angle is held, so that v and omega fall together.

    Notes
    -----
    Policies command the speed and the steering angle, of which the turning speed is computed with what the two have in
    common. What the robot *may* do is a box of v and omega, larger than what it can: a car at rest does not turn.
    """

    name: ClassVar[str] = "ackermann"
    description: ClassVar[str] = "car with front steering, without slip, from the middle of its rear axle"
    axes: ClassVar[tuple[Axis, ...]] = (Axis("v", "m/s", "linear"), Axis("omega", "rad/s", "angular"))
    velocity: ClassVar[tuple[Part, ...]] = ("ahead", "turn")

    @property
    def takes(self) -> tuple[tuple[str, ...], ...]:
        """Return the speed and the steering angle."""
        return (("linear", "steering"),)

    def fitted(self, robot: Limited) -> Kinematics:
        """See `Kinematics.fitted`."""
        return slowly_steered(robot) if robot.max_steering_rate else self

    def limits(self, robot: Limited) -> tuple[Floats, Floats]:
        """See `Kinematics.limits`; ConfigurationError if the robot has no wheelbase, or steers too far."""
        check_steering(robot)
        fastest = max(abs(robot.min_linear), abs(robot.max_linear))
        turn = fastest * math.tan(robot.max_steering) / robot.wheelbase
        return np.array([robot.min_linear, -turn]), np.array([robot.max_linear, turn])

    def carried_out(self, robot: Limited, commands: Floats) -> Floats:
        """See `Kinematics.carried_out`: a car turns no harder than it steers, and not at rest."""
        speed, turn = commands[..., 0], commands[..., 1]
        most = np.abs(speed) * math.tan(robot.max_steering) / robot.wheelbase
        return np.stack([speed, np.clip(turn, -most, most)], axis=-1)
