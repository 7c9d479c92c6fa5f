"""Cars whose motion has a state: the speed that an acceleration changes, or front wheels that take time to turn.

As for every car ``omega = v tan(angle) / wheelbase``, for the middle of the rear axle. With ``|v - v_c| <= r`` and
angles within the box,

    |omega - omega_c| <= |v - v_c| K + V_c |k - k_c|,   k = tan(angle) / wheelbase,

K the largest curvature of the box and V_c the largest speed of its centre.

*Wheels that turn.* The heading is ``v / wheelbase int tan(angle)``, in closed form. As a function of complex time it
has poles where the angle is a quarter turn. Pieces are so short that the angle, in the ellipse of
`viatool.motion.changing`, stays at least half as far from there as the largest angle is; there ``|tan|`` is at most
that of the angle half-way to the quarter turn, or 1.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from viatool.arrays import Floats
from viatool.errors import ConfigurationError
from viatool.motion.law import Axis, Limited
from viatool.motion.second_order import ACCELERATION, SPEED, SpeedLimits
from viatool.motion.signals import ApproachingSignal, HeldSignal, MotionSignal

STEERING = Axis("steering", "rad", "steering")
STEEPEST = 1.5
"""Radians of steering within which a car turns: its front wheels stay clear of a quarter turn."""
_ELLIPSE = 4.07
"""Half-axes of the ellipse of the Gauss points' error, rounded up."""


def check_steering(robot: Limited) -> None:
    """Refuse a car of which no turning speed follows."""
    if not (robot.wheelbase > 0.0 and robot.max_steering <= STEEPEST):
        raise ConfigurationError(
            f"a car has a wheelbase of {robot.wheelbase:g} m and steers up to {robot.max_steering:g} rad, expected "
            f"a positive length and at most {STEEPEST:g} rad",
            "give the map's robot its `wheelbase` and `max_steering`, or name a known car such as f1tenth",
        )


@dataclass(frozen=True)
class _Car(SpeedLimits):
    """A car with a state.

    Parameters
    ----------
    wheelbase : float
        Metres between the axles.
    max_steering, max_steering_rate : float
        Of the front wheels, in rad and rad/s.
    """

    wheelbase: float = 1.0
    max_steering: float = STEEPEST
    max_steering_rate: float = 0.0
    max_angular: float = field(default=np.inf, init=False)

    def limits(self, robot: Limited) -> tuple[Floats, Floats]:
        """See `Kinematics.limits`; ConfigurationError if the robot has no wheelbase, or steers too far."""
        check_steering(robot)
        return super().limits(robot)

    @property
    def parameters(self) -> dict[str, float]:
        """See `Kinematics.parameters`."""
        return {name: value for name, value in super().parameters.items() if name != "max_angular"}

    @property
    def _ahead(self) -> MotionSignal:
        return self._integrated(0, 0) if SPEED in self.state else HeldSignal(0)

    @property
    def _angle(self) -> MotionSignal:
        if STEERING in self.state:
            return ApproachingSignal(1, self.first_of_state, self.max_steering_rate)
        return HeldSignal(1)

    def _curvature(self, angle: Floats) -> Floats:
        return np.asarray(np.tan(angle) / self.wheelbase)

    @property
    def signals(self) -> tuple[MotionSignal, ...]:
        """See `ChangingTwist.signals`."""
        return (self._ahead if SPEED in self.state else self._angle,)

    def speed(self, held: Floats, time: Floats | float) -> Floats:
        """See `ChangingTwist.speed`."""
        return self._ahead.at(held, time)

    def turn(self, held: Floats, time: Floats | float) -> Floats:
        """See `ChangingTwist.turn`."""
        return self._ahead.at(held, time) * self._curvature(self._angle.at(held, time))

    def speeds(self, lower: Floats, upper: Floats, seconds: float) -> tuple[Floats, Floats]:
        """See `ChangingTwist.speeds`."""
        return self._ahead.ends(lower, upper, seconds)

    def turns(self, lower: Floats, upper: Floats, seconds: float) -> tuple[Floats, Floats]:
        """See `ChangingTwist.turns`."""
        bent = [self._curvature(end) for end in self._angle.ends(lower, upper, seconds)]
        products = np.stack([speed * end for speed in self.speeds(lower, upper, seconds) for end in bent])
        return products.min(axis=0), products.max(axis=0)

    def last_rates(self, lower: Floats, upper: Floats, seconds: float) -> tuple[Floats, Floats]:
        """See `Kinematics.last_rates`."""
        speed = self._ahead.last(lower, upper, seconds)
        return speed, speed * self._curvature(self._angle.last(lower, upper, seconds))

    def spread(self, lower: Floats, upper: Floats, seconds: float) -> tuple[Floats, Floats, Floats, Floats]:
        """See `ChangingTwist.spread`, and the module for why."""
        half, centre = 0.5 * (upper - lower), 0.5 * (lower + upper)
        speed, faster = self._ahead.radii(half)
        largest = self._angle.largest(lower, upper, seconds)
        most, steepest = self._curvature(largest), 1.0 / (self.wheelbase * np.square(np.cos(largest)))
        angle, growing = self._angle.radii(half)
        bent = self._ahead.largest(centre, centre, seconds) * steepest
        return speed, faster, most * speed + bent * angle, most * faster + bent * growing

    def _faster(self, lower: Floats, upper: Floats) -> Floats:
        return self._ahead.slope(lower, upper)


@dataclass(frozen=True)
class SecondOrderCar(_Car):
    """A command is an acceleration ahead and a steering angle, which the wheels have at once."""

    name: ClassVar[str] = "second_order_ackermann"
    description: ClassVar[str] = "car with front steering, without slip, whose acceleration is commanded"
    axes: ClassVar[tuple[Axis, ...]] = (ACCELERATION, STEERING)
    state: ClassVar[tuple[Axis, ...]] = (SPEED,)

    def fitted(self, robot: Limited) -> SecondOrderCar:
        """See `Kinematics.fitted`; ConfigurationError if its wheels take time to turn as well."""
        if robot.max_steering_rate:
            raise ConfigurationError(
                f"a car of kinematics '{self.name}' turns its wheels by at most {robot.max_steering_rate:g} rad/s, "
                "and is followed only where they turn at once",
                "leave `max_steering_rate` out, or command the speed (kinematics: ackermann)",
            )
        return super().fitted(robot)

    def turned(self, held: Floats, time: Floats | float) -> Floats:
        """See `ChangingTwist.turned`: as much as the way that it drove is bent."""
        return np.asarray(self._curvature(self._angle.at(held, 0.0)) * self._ahead.integral(held, time))


@dataclass(frozen=True)
class SlowlySteeredCar(_Car):
    """A command is a speed, which the car has at once, and an angle to which its front wheels turn by and by."""

    name: ClassVar[str] = "ackermann"
    description: ClassVar[str] = "car without slip, whose front wheels take time to turn"
    axes: ClassVar[tuple[Axis, ...]] = (SPEED, STEERING)
    state: ClassVar[tuple[Axis, ...]] = (STEERING,)

    @property
    def state_range(self) -> tuple[Floats, Floats]:
        """See `Kinematics.state_range`."""
        return np.array([-self.max_steering]), np.array([self.max_steering])

    def turned(self, held: Floats, time: Floats | float) -> Floats:
        """See `ChangingTwist.turned`: ``int tan(b + r t) = -log(cos(b + d) / cos b) / r``, d = r t; then a circle."""
        begin, angle = held[..., self.first_of_state], self._angle
        moving = np.minimum(time, angle.kink(held))
        way = angle.at(held, moving) - begin
        ratio = -2.0 * np.square(np.sin(0.5 * way)) - np.tan(begin) * np.sin(way)  # cos(b + d) / cos b - 1
        rate = self.max_steering_rate * np.where(way < 0.0, -1.0, 1.0)
        rest = np.tan(angle.at(held, time)) * (np.asarray(time) - moving)
        return np.asarray(self.speed(held, time) / self.wheelbase * (rest - np.log1p(ratio) / rate))

    def _pieces(self, held: Floats, time: Floats) -> Floats:
        """See the module."""
        longest = float(np.fmax.reduce(time, initial=0.0))
        largest = self._angle.largest(held, held, longest)
        left = 0.5 * np.pi - largest
        steepest = np.maximum(np.tan(largest + 0.5 * left), 1.0)
        turn = np.abs(self.speed(held, 0.0)) * steepest / self.wheelbase * time
        moving = np.minimum(time, self._angle.kink(held)) * self.max_steering_rate
        return np.maximum(turn, _ELLIPSE * moving / left)


def slowly_steered(robot: Limited) -> SlowlySteeredCar:
    """Return the car whose front wheels turn at the rate of a robot."""
    return SlowlySteeredCar().fitted(robot)
