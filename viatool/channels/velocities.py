"""The velocity that the robot has, as its odometry measures it."""

from __future__ import annotations

from typing import ClassVar

from viatool.arrays import Floats, Reals
from viatool.channels.part_of_motion import PartOfMotion
from viatool.channels.quantity import observes
from viatool.channels.views import BoxView, RecordedInstants, View
from viatool.motion.changing import ChangingTwist
from viatool.motion.kinematics import motion_of
from viatool.motion.law import Axis
from viatool.motion.twists import PARTS, HeldTwist, Part
from viatool.sets.forms import Forms

_KINDS: dict[Part, str] = {"ahead": "linear", "left": "lateral", "turn": "angular"}
"""The kinds of axes that are parts of a velocity."""


class MeasuredVelocity(PartOfMotion):
    """One part of the velocity in the robot's frame."""

    part: ClassVar[Part]

    def measure(self, view: View) -> Reals:
        """Return the velocity at the end of the interval; without one, that of the command before."""
        number = PARTS.index(self.part)
        if view.velocity is not None:
            return view.velocity[:, number]
        if isinstance(self._move, HeldTwist):
            return self._move.parts(view.previous)[number]
        raise self.lacks("measure")

    def record(self, recorded: RecordedInstants) -> Floats:
        """Return the velocity that the odometry measured."""
        return recorded.velocities[:, PARTS.index(self.part)]

    def enclose(self, view: BoxView) -> Forms:
        """Return the velocity that sets of states hold, or the command before, which is had at once.

        Of a robot whose motion has a state no command before is held: what it may have of it is the limits, and a turn
        that follows from the state as well is that of the states which the sets hold.
        """
        move = self._move
        held = self._held(move.before)
        if held is not None:
            return view.command(held)
        if self._follows:
            assert isinstance(move, ChangingTwist)
            start = view.start
            return view.between(*move.turning(self.robot, start.previous_lower, start.previous_upper))
        return view.between(*self.limits)

    @property
    def _move(self) -> HeldTwist | ChangingTwist:
        """Return the robot's kinematics, of which a velocity is known."""
        kinematics = motion_of(self.robot)
        if not isinstance(kinematics, HeldTwist | ChangingTwist):
            raise self.lacks("measure")
        return kinematics

    def _held(self, axes: tuple[Axis, ...]) -> int | None:
        """Return which number of a command or a state this part is; None if it is none of them."""
        if isinstance(self._move, HeldTwist):
            velocity = self._move.velocity
            return velocity.index(self.part) if self.part in velocity else None
        kinds = [axis.kind for axis in axes]
        return kinds.index(_KINDS[self.part]) if _KINDS[self.part] in kinds else None

    @property
    def held(self) -> bool:
        """Tell whether sets of states hold it."""
        return self._held(self._move.before) is not None

    @property
    def limits(self) -> tuple[float, float]:
        """Return the least and the largest of it that the robot has; of one that never moves so, 0."""
        move = self._move
        ends = [(move.axes, move.limits(self.robot)), (move.state, move.state_range)]
        for axes, (lower, upper) in ends:
            number = self._held(axes) if axes else None
            if number is not None:
                return float(lower[number]), float(upper[number])
        if isinstance(move, ChangingTwist) and self._follows:
            lower, upper = move.turning(self.robot, *move.state_range)
            return float(lower), float(upper)
        return 0.0, 0.0

    @property
    def _follows(self) -> bool:
        """Tell whether this part is a turn that follows from command and state, as of a car."""
        axes = (*self._move.axes, *self._move.state)
        return isinstance(self._move, ChangingTwist) and self.part == "turn" and self._held(axes) is None


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
