"""What is observed: one class for each kind of channel, registered by its name.

A new kind is a class in a module of this room that `observes("its_name")`, and an import below.
"""

from __future__ import annotations

from viatool.channels.channel import Channel, Frames, LidarSpecification
from viatool.channels.fan import Fan
from viatool.channels.goals import GoalCosine, GoalDistance, GoalSine
from viatool.channels.inputs import Inputs
from viatool.channels.lidar import LidarReadings
from viatool.channels.previous import PreviousAngular, PreviousCommand, PreviousLinear
from viatool.channels.quantities import Quantities
from viatool.channels.quantity import Fixed, Quantity, kind_named, kinds, observes, quantity_of
from viatool.channels.unmeasured import Budget, Other
from viatool.channels.views import BoxView, Extent, RecordedInstants, View, see, see_precisely

__all__ = [
    "BoxView",
    "Budget",
    "Channel",
    "Extent",
    "Fan",
    "Fixed",
    "Frames",
    "GoalCosine",
    "GoalDistance",
    "GoalSine",
    "Inputs",
    "LidarReadings",
    "LidarSpecification",
    "Other",
    "PreviousAngular",
    "PreviousCommand",
    "PreviousLinear",
    "Quantities",
    "Quantity",
    "RecordedInstants",
    "View",
    "kind_named",
    "kinds",
    "observes",
    "quantity_of",
    "see",
    "see_precisely",
]
