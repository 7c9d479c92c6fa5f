"""The goal in polar form: its distance, and cosine and sine of its bearing in the robot's frame."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np

from viatool.arrays import Floats, Indices, Reals
from viatool.channels.quantity import Quantity, observes
from viatool.channels.views import BoxView, Extent, RecordedInstants, View
from viatool.sets.forms import Forms


class GoalQuantity(Quantity):
    """One of the numbers that say where the goal is."""

    needs = frozenset({"goal"})
    part: ClassVar[Literal["distance", "cosine", "sine"]]

    def measure(self, view: View) -> Reals:
        """Return the number as seen from where the robots think they are."""
        return np.asarray(getattr(view.goal, self.part))

    def record(self, recorded: RecordedInstants) -> Floats:
        """Return the number as seen from the recorded poses."""
        return np.asarray(getattr(recorded.goals, self.part))

    def enclose(self, view: BoxView) -> Forms:
        """Enclose the number over all poses."""
        seen: Forms = getattr(view.goal_forms, self.part)
        return view.over_states(seen)

    def bounds(self, extent: Extent) -> tuple[float, float]:
        """Return the range of a cosine or sine."""
        return -1.0, 1.0

    def mirror(self) -> tuple[Indices, Floats]:
        """Return the number as it is: left and right are the same to it."""
        return np.arange(1), np.ones(1)


@observes("goal_distance")
class GoalDistance(GoalQuantity):
    """How far the goal is, in metres."""

    part = "distance"

    def bounds(self, extent: Extent) -> tuple[float, float]:
        """Return 0 and twice the map's diagonal: with drift a goal may seem farther away than the map is wide."""
        return 0.0, 2.0 * extent.diagonal


@observes("goal_cosine")
class GoalCosine(GoalQuantity):
    """The cosine of the goal's bearing: 1 ahead, -1 behind; 0 on the goal itself."""

    part = "cosine"


@observes("goal_sine")
class GoalSine(GoalQuantity):
    """The sine of the goal's bearing: 1 to the left, -1 to the right; 0 on the goal itself."""

    part = "sine"

    def mirror(self) -> tuple[Indices, Floats]:
        """Return the opposite."""
        return np.arange(1), -np.ones(1)
