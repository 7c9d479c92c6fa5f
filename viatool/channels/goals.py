"""The goal: its distance, bearing and place in the robot's frame, and its place on the map."""

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
    part: ClassVar[Literal["distance", "bearing", "cosine", "sine", "x", "y"]]

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


@observes("goal_bearing")
class GoalBearing(GoalQuantity):
    """The direction of the goal, in radians counter-clockwise from straight ahead, within a half turn."""

    part = "bearing"
    wraps = True

    def enclose(self, view: BoxView) -> Forms:
        """Enclose the angle over all poses, on one side of the half turn where both are possible."""
        return view.within_half_turn(super().enclose(view), self.channel.kind)

    def bounds(self, extent: Extent) -> tuple[float, float]:
        """Return a half turn to either side."""
        return -np.pi, np.pi

    def mirror(self) -> tuple[Indices, Floats]:
        """Return the opposite."""
        return np.arange(1), -np.ones(1)


class GoalOffset(GoalQuantity):
    """How far the goal is ahead or to the left."""

    def bounds(self, extent: Extent) -> tuple[float, float]:
        """Return twice the map's diagonal either way, as for the distance."""
        return -2.0 * extent.diagonal, 2.0 * extent.diagonal


@observes("goal_x")
class GoalX(GoalOffset):
    """How far the goal is ahead, in metres."""

    part = "x"


@observes("goal_y")
class GoalY(GoalOffset):
    """How far the goal is to the left, in metres."""

    part = "y"

    def mirror(self) -> tuple[Indices, Floats]:
        """Return the opposite."""
        return np.arange(1), -np.ones(1)


class GoalOnMap(Quantity):
    """One coordinate of the goal on the map, whose frame the robot shares."""

    needs = frozenset({"goal"})
    axis: ClassVar[Literal[0, 1]]

    def measure(self, view: View) -> Reals:
        """Return the coordinate."""
        return view.goals[:, self.axis]

    def record(self, recorded: RecordedInstants) -> Floats:
        """Return the coordinate of the goal that was given."""
        assert recorded.goal is not None  # refused before, by what its quantities need
        return np.full(len(recorded.poses), recorded.goal[self.axis])

    def enclose(self, view: BoxView) -> Forms:
        """Return the coordinate."""
        return view.constant(float(view.goal[self.axis]), 1)

    def bounds(self, extent: Extent) -> tuple[float, float]:
        """Return the bounds of the map."""
        return extent.along(self.axis)


@observes("goal_x_map")
class GoalXMap(GoalOnMap):
    """The x coordinate of the goal in the map's frame, in metres."""

    axis = 0


@observes("goal_y_map")
class GoalYMap(GoalOnMap):
    """The y coordinate of the goal in the map's frame, in metres."""

    axis = 1


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
