"""Robots that are told how to accelerate: ahead, in their turn, or both; each axis by itself."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import ClassVar, TypeVar

import numpy as np

from viatool.arrays import Floats, Hull
from viatool.errors import ConfigurationError
from viatool.motion.changing import ChangingTwist
from viatool.motion.command_errors import CommandErrors, Strayed
from viatool.motion.law import Axis, Limited
from viatool.motion.signals import HeldSignal, IntegratedSignal, MotionSignal
from viatool.motion.straight import accelerated
from viatool.rounding import SLIGHTLY_MORE
from viatool.sets.forms import Forms

SPEED, TURN = Axis("v", "m/s", "linear"), Axis("omega", "rad/s", "angular")
ACCELERATION = Axis("a", "m/s^2", "linear_acceleration")
ANGULAR_ACCELERATION = Axis("alpha", "rad/s^2", "angular_acceleration")

_Fitted = TypeVar("_Fitted", bound="SpeedLimits")


@dataclass(frozen=True)
class SpeedLimits(ChangingTwist):
    """A robot whose speeds stop changing at its limits.

    Parameters
    ----------
    min_linear, max_linear : float
        Of the speed ahead, in m/s.
    max_angular : float
        Of the turning speed to either side, in rad/s.
    """

    min_linear: float = -np.inf
    max_linear: float = np.inf
    max_angular: float = np.inf

    def fitted(self: _Fitted, robot: Limited) -> _Fitted:
        """See `Kinematics.fitted`."""
        return replace(self, **{name: float(getattr(robot, name)) for name in self.parameters})

    @property
    def parameters(self) -> dict[str, float]:
        """See `Kinematics.parameters`."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @property
    def state_range(self) -> tuple[Floats, Floats]:
        """See `Kinematics.state_range`."""
        ends = {"v": (self.min_linear, self.max_linear), "omega": (-self.max_angular, self.max_angular)}
        lower, upper = np.array([ends[axis.name] for axis in self.state]).T
        return lower, upper

    def limits(self, robot: Limited) -> tuple[Floats, Floats]:
        """See `Kinematics.limits`; ConfigurationError if nobody said how it accelerates."""
        ends = {
            "linear": (robot.min_linear, robot.max_linear),
            "angular": (-robot.max_angular, robot.max_angular),
            "linear_acceleration": (robot.min_acceleration, robot.max_acceleration),
            "angular_acceleration": (-robot.max_angular_acceleration, robot.max_angular_acceleration),
            "steering": (-robot.max_steering, robot.max_steering),
        }
        for axis in self.axes:
            low, high = ends[axis.kind]
            if axis.kind.endswith("_acceleration") and low == high:
                names = "max_angular_acceleration" if axis is ANGULAR_ACCELERATION else "max_acceleration"
                raise ConfigurationError(
                    f"how a robot of kinematics '{self.name}' accelerates ({axis.kind}) is not known",
                    f"give the map's robot its `{names}`, or the policy's action its `lower` and `upper`",
                )
        lower, upper = np.array([ends[axis.kind] for axis in self.axes]).T
        return lower, upper

    def neutral(self) -> Floats:
        """See `ChangingTwist.neutral`: no acceleration, and speeds as near to 0 as it may have."""
        least = {"linear": self.min_linear, "angular": -self.max_angular}
        most = {"linear": self.max_linear, "angular": self.max_angular}
        ends = [(least.get(axis.kind, 0.0), most.get(axis.kind, 0.0)) for axis in self.axes]
        return np.array([min(max(0.0, low), high) for low, high in ends])

    def _integrated(self, column: int, state: int) -> IntegratedSignal:
        """Return a number of the state that the command of a column changes."""
        lower, upper = self.state_range
        return IntegratedSignal(column, self.first_of_state + state, float(lower[state]), float(upper[state]))


@dataclass(frozen=True)
class Unicycle(SpeedLimits):
    """A robot whose speed and turning speed are signals of their own."""

    @property
    def _ahead(self) -> HeldSignal | IntegratedSignal:
        """Return the speed ahead."""
        return self._integrated(0, 0) if SPEED in self.state else HeldSignal(0)

    @property
    def _turning(self) -> HeldSignal | IntegratedSignal:
        """Return the turning speed."""
        return self._integrated(1, self.state.index(TURN)) if TURN in self.state else HeldSignal(1)

    @property
    def signals(self) -> tuple[MotionSignal, ...]:
        """See `ChangingTwist.signals`."""
        own = {SPEED: self._ahead, TURN: self._turning}
        return tuple(own[axis] for axis in self.state)

    def speed(self, held: Floats, time: Floats | float) -> Floats:
        """See `ChangingTwist.speed`."""
        return self._ahead.at(held, time)

    def turn(self, held: Floats, time: Floats | float) -> Floats:
        """See `ChangingTwist.turn`."""
        return self._turning.at(held, time)

    def turned(self, held: Floats, time: Floats | float) -> Floats:
        """See `ChangingTwist.turned`."""
        return self._turning.integral(held, time)

    def speeds(self, lower: Floats, upper: Floats, seconds: float) -> tuple[Floats, Floats]:
        """See `ChangingTwist.speeds`."""
        return self._ahead.ends(lower, upper, seconds)

    def turns(self, lower: Floats, upper: Floats, seconds: float) -> tuple[Floats, Floats]:
        """See `ChangingTwist.turns`."""
        return self._turning.ends(lower, upper, seconds)

    def last_rates(self, lower: Floats, upper: Floats, seconds: float) -> tuple[Floats, Floats]:
        """See `Kinematics.last_rates`."""
        return self._ahead.last(lower, upper, seconds), self._turning.last(lower, upper, seconds)

    def spread(self, lower: Floats, upper: Floats, seconds: float) -> tuple[Floats, Floats, Floats, Floats]:
        """See `ChangingTwist.spread`."""
        half = 0.5 * (upper - lower)
        return *self._ahead.radii(half), *self._turning.radii(half)

    def strayed(self, errors: CommandErrors, lower: Floats, upper: Floats, seconds: float) -> Strayed:
        """Bound how far errors of commands lead, over boxes of what is held (C, A + S), see `CommandErrors`."""
        count, half = self.first_of_state, np.zeros_like(lower)
        half[:, :count] = errors.radii(lower[:, :count], upper[:, :count])
        r0, r1, q0, q1 = self.spread(-half, half, seconds)
        fastest, _ = self.rates(lower, upper, seconds)
        turning = q0 * (0.5 * seconds**2) + q1 * (seconds**3 / 6.0)
        away = r0 * seconds + r1 * (0.5 * seconds**2) + fastest * turning
        turned = q0 * seconds + q1 * (0.5 * seconds**2)
        radii = [signal.radii(half) for signal in self.signals]
        changed = np.stack([begin + grown * seconds for begin, grown in radii], axis=1)
        return Strayed(away * SLIGHTLY_MORE, turned * SLIGHTLY_MORE, changed * SLIGHTLY_MORE)

    def _faster(self, lower: Floats, upper: Floats) -> Floats:
        return self._ahead.slope(lower, upper)

    def _moved(self, states: Forms, ends: Hull, seconds: float, slack: Floats) -> Forms:
        """Move sets of poses under straight speeds, as `viatool.motion.straight` derives."""
        ahead, turning = (signal.straight(*ends, seconds) for signal in (self._ahead, self._turning))
        return accelerated(states, ahead, turning, seconds, slack)


@dataclass(frozen=True)
class SecondOrderLinear(Unicycle):
    """A command is an acceleration ahead and a turning speed; the robot has the turning speed at once."""

    name: ClassVar[str] = "second_order_linear"
    description: ClassVar[str] = "drive without slip whose acceleration ahead is commanded"
    axes: ClassVar[tuple[Axis, ...]] = (ACCELERATION, TURN)
    state: ClassVar[tuple[Axis, ...]] = (SPEED,)


@dataclass(frozen=True)
class SecondOrderAngular(Unicycle):
    """A command is a speed ahead, which the robot has at once, and an acceleration of its turn."""

    name: ClassVar[str] = "second_order_angular"
    description: ClassVar[str] = "drive without slip whose angular acceleration is commanded"
    axes: ClassVar[tuple[Axis, ...]] = (SPEED, ANGULAR_ACCELERATION)
    state: ClassVar[tuple[Axis, ...]] = (TURN,)


@dataclass(frozen=True)
class SecondOrder(Unicycle):
    """A command is an acceleration ahead and an acceleration of the turn."""

    name: ClassVar[str] = "second_order"
    description: ClassVar[str] = "drive without slip whose accelerations are commanded"
    axes: ClassVar[tuple[Axis, ...]] = (ACCELERATION, ANGULAR_ACCELERATION)
    state: ClassVar[tuple[Axis, ...]] = (SPEED, TURN)
