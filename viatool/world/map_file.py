"""The native map file as typed models: what the YAML may hold, with units, defaults and limits.

Lengths are metres, angles are radians counter-clockwise, speeds m/s and rad/s, poses x, y, theta.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, Tag, model_validator

from viatool.world.fields import (
    NotNegative,
    Number,
    Point,
    Pose,
    Positive,
    Size,
    Strict,
    Unlimited,
    UnlimitedPositive,
    misplaced,
)
from viatool.world.obstacle_shapes import Arena, Obstacle
from viatool.world.robot import ROBOTS

Unknown = Literal["free", "obstacle"]  # what cells are of which a map does not know


class LidarFile(Strict):
    """The range finder; what is left out is the known robot's."""

    field_of_view: Annotated[Positive, Field(le=2.0 * math.pi + 1e-9)] | None = None
    rays: Annotated[int, Field(ge=1)] | None = None
    bins: Annotated[int, Field(ge=1)] | None = None
    minimum_range: NotNegative | None = None
    maximum_range: Positive | None = None
    noise: NotNegative | None = Field(default=None, description="standard deviation of each ray, in metres")


class FootprintCircle(Strict):
    """A round robot; radius 0 is a point."""

    shape: Literal["circle"]
    radius: NotNegative


class FootprintPolygon(Strict):
    """The robot's outline in its own frame, x forward and y left."""

    shape: Literal["polygon"]
    points: list[Point] = Field(min_length=3)


class FootprintPoint(Strict):
    """The origin of the robot's frame alone, as in the paper."""

    shape: Literal["point"]


FootprintFile = Annotated[FootprintPoint | FootprintCircle | FootprintPolygon, Field(discriminator="shape")]


class RobotFile(Strict):
    """A known robot with some values changed."""

    name: str = Field(
        default="turtlebot3", description=f"one of {', '.join(ROBOTS)}, which gives the defaults"
    )
    min_linear: Unlimited | None = None
    max_linear: Unlimited | None = None
    max_angular: UnlimitedPositive | None = None
    deceleration: Positive | None = None
    control_interval: Positive | None = None
    footprint: FootprintFile | None = None
    lidar: LidarFile | None = None
    kinematics: str | None = Field(
        default=None, min_length=1, description="how it moves; that of the known robot if left out"
    )
    max_lateral: NotNegative | None = Field(
        default=None, description="largest speed to either side of a holonomic robot, in m/s"
    )
    track: Positive | None = Field(
        default=None, description="distance between the left and the right wheels, in metres"
    )
    wheelbase: Positive | None = Field(
        default=None, description="distance between the axles of a car, in metres; its origin is the rear one"
    )
    max_steering: NotNegative | None = Field(
        default=None, description="largest angle of the front wheels of a car to either side, in rad"
    )
    max_steering_rate: NotNegative | None = Field(
        default=None, description="how fast they turn, in rad/s; 0 for wheels that are steered at once"
    )
    min_acceleration: Number | None = Field(
        default=None,
        description="smallest acceleration, in m/s^2, of a robot whose acceleration is commanded",
    )
    max_acceleration: NotNegative | None = Field(default=None, description="largest acceleration, in m/s^2")
    max_angular_acceleration: NotNegative | None = Field(
        default=None, description="largest acceleration of its turn to either side, in rad/s^2"
    )


def _kind_of_robot(value: Any) -> str:
    """Tell which variant of `KnownOrChangedRobot` is meant, so that only its errors are told."""
    return "str" if isinstance(value, str) else "RobotFile"


KnownOrChangedRobot = Annotated[
    Annotated[str, Tag("str")] | Annotated[RobotFile, Tag("RobotFile")], Discriminator(_kind_of_robot)
]


class ClearanceFile(Strict):
    """Distances from the footprint that count as collision and as danger; danger is at least collision."""

    collision: NotNegative = 0.4
    danger: NotNegative = 0.5


class StatesFile(Strict):
    """A box of states: x, y, theta, v, omega, as many as are to be limited; null where nothing is asked."""

    lower: list[Number | None] = Field(min_length=2, max_length=5)
    upper: list[Number | None] = Field(min_length=2, max_length=5)

    @model_validator(mode="after")
    def _ordered(self) -> StatesFile:
        if len(self.lower) != len(self.upper):
            raise misplaced(
                f"expected as many numbers as `lower` has, {len(self.lower)}, got {len(self.upper)}", "upper"
            )
        for number, (low, high) in enumerate(zip(self.lower, self.upper, strict=True)):
            if low is not None and high is not None and low > high:
                raise misplaced(f"expected at least {low:g}, as `lower` has, got {high:g}", "upper", number)
        return self


class PolygonGoalFile(Strict):
    """States whose place is in a polygon; `lower` and `upper` limit what else is asked, as in a box of states."""

    shape: Literal["polygon"] = "polygon"
    points: list[Point] = Field(min_length=3)
    lower: list[Number | None] = Field(default=[None, None], min_length=2, max_length=5)
    upper: list[Number | None] = Field(default=[None, None], min_length=2, max_length=5)

    @model_validator(mode="after")
    def _ordered(self) -> PolygonGoalFile:
        StatesFile(lower=self.lower, upper=self.upper)
        return self


def _kind_of_place(value: Any) -> str:
    """Tell whether a place, a box of states or a polygon is meant, so that only its errors are told."""
    if isinstance(value, dict):
        return "outline" if {"points", "shape"} & value.keys() else "states"
    if isinstance(value, StatesFile | PolygonGoalFile):
        return "states" if isinstance(value, StatesFile) else "outline"
    return "corners" if isinstance(value, list) and any(isinstance(one, list) for one in value) else "place"


StartFile = Annotated[
    Annotated[Pose, Tag("place")] | Annotated[StatesFile, Tag("states")], Discriminator(_kind_of_place)
]
GoalFile = Annotated[
    Annotated[Point, Tag("place")]
    | Annotated[StatesFile, Tag("states")]
    | Annotated[PolygonGoalFile, Tag("outline")]
    | Annotated[list[Point], Field(min_length=3), Tag("corners")],
    Discriminator(_kind_of_place),
]


class ScenarioFile(Strict):
    """A fixed scenario with the obstacles that only it has."""

    name: str = ""
    start: StartFile = Field(description="a pose, or a box of states (`viatool mission` alone)")
    goal: GoalFile = Field(
        description="a point; or, for `viatool mission` alone, a box of states, the corners of a polygon, or a polygon "
        "with limits of heading and speeds"
    )
    deadline: Positive | None = Field(
        default=None, description="seconds within which, or at which, every run of a mission has arrived"
    )
    arrive: Literal["within", "at"] = Field(
        default="within", description="by the deadline, or at it, wherever runs are before"
    )
    obstacles: list[Obstacle] = Field(default=[])

    @model_validator(mode="after")
    def _whole(self) -> ScenarioFile:
        if isinstance(self.start, StatesFile) and (
            len(self.start.lower) < 3 or None in (*self.start.lower, *self.start.upper)
        ):
            raise misplaced("expected x, y and theta of a start, and no null", "start")
        if self.arrive == "at" and self.deadline is None:
            raise misplaced("expected a `deadline` at which runs arrive", "arrive")
        return self


class RandomCircle(Strict):
    """A disc that is placed at random."""

    shape: Literal["circle"]
    radius: Positive


class RandomBox(Strict):
    """A rectangle that is placed and turned at random."""

    shape: Literal["box"]
    size: Size


RandomObstacle = Annotated[RandomCircle | RandomBox, Field(discriminator="shape")]


class GeneratorFile(Strict):
    """How random scenarios are drawn; separations are between centres, clearances from the shapes."""

    area: tuple[Number, Number, Number, Number] | None = Field(
        None,
        description="smallest x, y and largest x, y of all random centres; the arena's bounds if left out",
    )
    obstacles: list[RandomObstacle] = Field(default=[])
    obstacle_separation: NotNegative = 0.0
    start_separation: NotNegative = 0.0
    goal_separation: NotNegative = 0.0
    start_clearance: NotNegative | None = Field(default=None, description="the danger clearance if left out")
    goal_clearance: NotNegative = 0.0
    goal_distance: tuple[NotNegative, Positive] | None = Field(
        default=None, description="least and largest distance between start and goal"
    )


class MapFile(Strict):
    """A native viatool map."""

    schema_version: Literal[1] = 1
    name: str = Field(default="", description="the file's name if left out")
    description: str = ""
    arena: Arena | None = Field(default=None, description="may be left out if there is an occupancy map")
    occupancy: str | None = Field(
        default=None,
        min_length=1,
        description="YAML file of a map_server map, relative to this file, whose cells are obstacles as well",
    )
    unknown: Unknown = Field(default="obstacle", description="what unknown cells of the occupancy map are")
    obstacles: list[Obstacle] = Field(default=[])
    robot: KnownOrChangedRobot = RobotFile()
    clearance: ClearanceFile = ClearanceFile()
    scenarios: list[ScenarioFile] = Field(default=[])
    generator: GeneratorFile | None = None
