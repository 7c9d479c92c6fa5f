"""Cars: wheels in front that steer, wheels behind that roll where the body points."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np

from viatool.arrays import Floats
from viatool.errors import ConfigurationError
from viatool.motion.law import Axis, Limited
from viatool.motion.twists import HeldTwist, Part

STEEPEST = 1.5
"""Radians of steering within which a car turns: its front wheels stay clear of a quarter turn."""


class AckermannDrive(HeldTwist):
    """A command is a speed v of the middle of the rear axle, and the turning speed that it has at a steering angle.

    The robot's origin is the middle of the rear axle, which never slips sideways, so ``omega = v tan(steering) /
    wheelbase``. The steering angle is taken to be reached at once; while a car brakes it is held, so that v and omega
    fall together.

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

    def limits(self, robot: Limited) -> tuple[Floats, Floats]:
        """See `Kinematics.limits`; ConfigurationError if the robot has no wheelbase, or steers too far or slowly."""
        if robot.max_steering_rate:
            raise ConfigurationError(
                f"the car's steering turns by at most {robot.max_steering_rate:g} rad/s, which is not followed: its "
                "wheels would stand between the angle before and the one that is commanded",
                "leave `max_steering_rate` out; verdicts are then of a car whose wheels are steered at once",
            )
        if not (robot.wheelbase > 0.0 and robot.max_steering <= STEEPEST):
            raise ConfigurationError(
                f"a car has a wheelbase of {robot.wheelbase:g} m and steers up to {robot.max_steering:g} rad, expected "
                f"a positive length and at most {STEEPEST:g} rad",
                "give the map's robot its `wheelbase` and `max_steering`, or name a known car such as f1tenth",
            )
        fastest = max(abs(robot.min_linear), abs(robot.max_linear))
        turn = fastest * math.tan(robot.max_steering) / robot.wheelbase
        return np.array([robot.min_linear, -turn]), np.array([robot.max_linear, turn])
