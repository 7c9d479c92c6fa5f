"""What is observed: one class for each kind of channel, registered by its name.

A new kind is a class in a module of this room that `observes("its_name")`, and an import below.
"""

from __future__ import annotations

from viatool.channels.channel import Channel, Frames, LidarSpecification
from viatool.channels.fan import Fan
from viatool.channels.goals import (
    GoalBearing,
    GoalCosine,
    GoalDistance,
    GoalSine,
    GoalX,
    GoalXMap,
    GoalY,
    GoalYMap,
)
from viatool.channels.inputs import Inputs
from viatool.channels.lidar import LidarReadings
from viatool.channels.memory import Memory
from viatool.channels.poses import Heading, HeadingCosine, HeadingSine, PoseX, PoseY
from viatool.channels.previous import (
    PreviousAngular,
    PreviousCommand,
    PreviousLateral,
    PreviousLinear,
    PreviousRaw,
)
from viatool.channels.quantities import Quantities, Sightings
from viatool.channels.quantity import Fixed, Quantity, kind_named, kinds, observes, quantity_of
from viatool.channels.unmeasured import Budget, ConstantNumbers, Other, StepsLeft
from viatool.channels.velocities import AngularVelocity, LateralVelocity, LinearVelocity
from viatool.channels.views import BoxView, Extent, RecordedInstants, View, see, see_precisely

__all__ = [
    "AngularVelocity",
    "BoxView",
    "Budget",
    "Channel",
    "ConstantNumbers",
    "Extent",
    "Fan",
    "Fixed",
    "Frames",
    "GoalBearing",
    "GoalCosine",
    "GoalDistance",
    "GoalSine",
    "GoalX",
    "GoalXMap",
    "GoalY",
    "GoalYMap",
    "Heading",
    "HeadingCosine",
    "HeadingSine",
    "Inputs",
    "LateralVelocity",
    "LidarReadings",
    "LidarSpecification",
    "LinearVelocity",
    "Memory",
    "Other",
    "PoseX",
    "PoseY",
    "PreviousAngular",
    "PreviousCommand",
    "PreviousLateral",
    "PreviousLinear",
    "PreviousRaw",
    "Quantities",
    "Quantity",
    "RecordedInstants",
    "Sightings",
    "StepsLeft",
    "View",
    "kind_named",
    "kinds",
    "observes",
    "quantity_of",
    "see",
    "see_precisely",
]
