"""The command of the step before, as it was sent to the motors."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np

from viatool.arrays import Floats, Indices, Reals
from viatool.channels.quantity import Quantity, observes
from viatool.channels.views import BoxView, Extent, RecordedInstants, View
from viatool.sets.forms import Forms


class PreviousCommand(Quantity):
    """One part of the command before."""

    needs = frozenset({"command"})
    axis: ClassVar[int]
    """Which number of a command it is."""
    state: ClassVar[Literal["v", "omega"]]
    """Which quantity of the state it is."""

    def measure(self, view: View) -> Reals:
        """Return the command before."""
        return view.previous[:, self.axis]

    def record(self, recorded: RecordedInstants) -> Floats:
        """Return the recorded command before."""
        return recorded.previous[:, self.axis]

    def enclose(self, view: BoxView) -> Forms:
        """Return the part of the state."""
        return view.state(self.state)


@observes("previous_linear")
class PreviousLinear(PreviousCommand):
    """The speed that was commanded before, in m/s."""

    axis, state = 0, "v"

    def bounds(self, extent: Extent) -> tuple[float, float]:
        """Return the robot's limits."""
        return self.robot.min_linear, self.robot.max_linear

    def mirror(self) -> tuple[Indices, Floats]:
        """Return the speed as it is."""
        return np.arange(1), np.ones(1)


@observes("previous_angular")
class PreviousAngular(PreviousCommand):
    """The turning speed that was commanded before, in rad/s, counter-clockwise."""

    axis, state = 1, "omega"

    def bounds(self, extent: Extent) -> tuple[float, float]:
        """Return the robot's limits."""
        return -self.robot.max_angular, self.robot.max_angular

    def mirror(self) -> tuple[Indices, Floats]:
        """Return the opposite."""
        return np.arange(1), -np.ones(1)
