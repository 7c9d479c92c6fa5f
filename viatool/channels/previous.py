"""The command of the step before, as it was sent to the motors, and what the network gave for it."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from viatool.arrays import Floats, Hull, Indices, Reals
from viatool.channels.channel import Channel
from viatool.channels.part_of_motion import PartOfMotion
from viatool.channels.quantity import Part, Quantity, observes, refuse_lidar
from viatool.channels.views import BoxView, RecordedInstants, View
from viatool.errors import PolicyError
from viatool.motion.kinematics import motion_of
from viatool.sets.forms import Forms


class PreviousCommand(PartOfMotion):
    """One part of the command before."""

    needs = frozenset({"command"})
    command: ClassVar[str]
    """The kind of the axis that was commanded."""

    @property
    def axis(self) -> int:
        """Return which number of a command it is.

        Raises
        ------
        PolicyError
            If the robot has no such axis.
        """
        kinematics = motion_of(self.robot)
        axis = kinematics.axis(self.command)
        if axis is None:
            raise PolicyError(
                f"{self.channel} observes a command that robot '{self.robot.name}' ({kinematics.description}) "
                "does not take",
                "give the channel a fixed `value`, or name the robot's kinematics in the map",
            )
        return axis

    def require(self, part: Part) -> None:
        """Refuse a command that the robot does not take."""
        super().require(part)
        _ = self.axis

    def measure(self, view: View) -> Reals:
        """Return the command before."""
        return view.previous[:, self.axis]

    def record(self, recorded: RecordedInstants) -> Floats:
        """Return the recorded command before."""
        return recorded.previous[:, ("linear", "lateral", "angular").index(self.command)]

    def enclose(self, view: BoxView) -> Forms:
        """Return the part of the state; where sets hold the state of the motion instead, any that was carried out."""
        return view.between(*self.limits) if motion_of(self.robot).state else view.command(self.axis)

    def told_of(self, axis: int, made: Indices) -> Indices:
        """Return its number, of its own axis."""
        return np.arange(int(self.axis == axis))

    @property
    def limits(self) -> tuple[float, float]:
        """Return the robot's limits."""
        lower, upper = motion_of(self.robot).limits(self.robot)
        return float(lower[self.axis]), float(upper[self.axis])


@observes("previous_linear")
class PreviousLinear(PreviousCommand):
    """The speed that was commanded before, in m/s."""

    command = "linear"


@observes("previous_lateral")
class PreviousLateral(PreviousCommand):
    """The speed to the left that was commanded before, in m/s."""

    command, sign = "lateral", -1.0


@observes("previous_angular")
class PreviousAngular(PreviousCommand):
    """The turning speed that was commanded before, in rad/s, counter-clockwise."""

    command, sign = "angular", -1.0


@observes("previous_raw")
class PreviousRaw(Quantity):
    """The network's own outputs of the step before, as it gave them; 0 before the first."""

    believes = False
    placed = False
    needs = frozenset({"outputs"})

    @classmethod
    def check(cls, channel: Channel) -> None:
        """Accept any size: one number for each output."""
        refuse_lidar(channel)

    def measure(self, view: View) -> Reals:
        """Return the outputs before."""
        size = self.channel.size
        if view.raw is None:
            return np.zeros((len(view), size))
        if view.raw.shape[1] != size:
            raise self._gives(view.raw.shape[1])
        return view.raw

    def enclose(self, view: BoxView) -> Forms:
        """Return what the network may have given, where it makes a difference to the channel.

        Raises
        ------
        PolicyError
            If nothing bounds it, or it gives another number of outputs.
        """
        raw = view.raw
        if raw is None:
            raise self.lacks("enclose")
        lower, upper = self.require_limits(raw.lower, raw.upper)
        known = np.isfinite(raw.rest)
        free = Forms.between(np.where(known, 0.0, lower), np.where(known, 0.0, upper))
        return Forms.where(known, raw, Forms(free.centre, 0.0 * raw.slope, free.rest))

    def told_of(self, axis: int, made: Indices) -> Indices:
        """Return the outputs that make an axis."""
        return np.flatnonzero(made == axis)

    def require_limits(self, lower: Floats, upper: Floats) -> Hull:
        """Return ends of outputs (..., K), where they make a difference to the channel.

        Raises
        ------
        PolicyError
            If one of them is infinite, or there is another number of outputs than the channel has.
        """
        if lower.shape[-1] != self.channel.size:
            raise self._gives(lower.shape[-1])
        ends = np.clip(lower, *self.channel.told_apart), np.clip(upper, *self.channel.told_apart)
        if not np.isfinite(ends).all():
            raise PolicyError(
                f"{self.channel} is not known over a set of poses: nothing limits what the network gives",
                "export it with its squash or clip inside, give the channel a `clip`, or verify recorded states alone",
            )
        return ends

    def _gives(self, outputs: int) -> PolicyError:
        return PolicyError(
            f"{self.channel} has {self.channel.size} numbers, but the network gives {outputs}",
            "correct the size of the channel",
        )
