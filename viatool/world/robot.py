"""What drives: the robot's limits, footprint and LiDAR, and the robots that are known by name."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, get_args

import numpy as np

from viatool.arrays import Floats
from viatool.errors import ConfigurationError
from viatool.world.lidar import Lidar
from viatool.world.measurement import as_plane, point_edge_squared, winding_number
from viatool.world.rings import fit, simple_polygon

FootprintKind = Literal["point", "circle", "polygon"]

_NOT_NEGATIVE = (
    "max_angular", "deceleration", "control_interval", "max_lateral", "track", "wheelbase", "max_steering",
    "max_steering_rate", "max_angular_acceleration",
)  # fmt: skip
_SPEEDS = ("min_linear", "max_linear", "max_angular")
_SIGNED = ("min_linear", "max_linear", "min_acceleration", "max_acceleration")

_TOUCHING = 1e-9
"""Metres from an outline within which a point counts as neither inside nor outside."""


@dataclass(frozen=True, eq=False)
class Footprint:
    """The outline of the robot on the floor, in the robot's frame.

    Parameters
    ----------
    kind : str
        "point", "circle" or "polygon".
    radius : float
        Of the circle, in metres.
    polygon : ndarray
        (n, 2) corners of a simple polygon, in metres; kept counter-clockwise, without repeated corners. (0, 2) for
        the other kinds.

    Raises
    ------
    MapError
        If the polygon is not simple, or a number is not finite.
    ConfigurationError
        If the kind is not known or the radius is not a length.
    """

    kind: FootprintKind = "point"
    radius: float = 0.0
    polygon: Floats = field(default_factory=lambda: np.zeros((0, 2)))

    def __post_init__(self) -> None:
        if self.kind not in get_args(FootprintKind):
            raise ConfigurationError(
                f"footprint has the kind '{self.kind}', expected one of {', '.join(get_args(FootprintKind))}",
                "name one of them",
            )
        if self.kind == "polygon":
            object.__setattr__(self, "polygon", simple_polygon(self.polygon, "footprint"))
        if not (self.radius >= 0.0 and fit(self.radius)):
            raise ConfigurationError(
                f"footprint has a radius of {self.radius} m, expected a finite length of 0 or more",
                "correct the radius",
            )

    @property
    def reach(self) -> float:
        """Return the largest distance from the robot's origin to its outline, in metres."""
        if self.kind == "polygon":
            return float(np.hypot(*self.polygon.T).max())
        return self.radius

    @property
    def words(self) -> str:
        """Return the outline in words, for reports."""
        return {
            "point": "point (the LiDAR origin)",
            "circle": f"disc of radius {self.radius:g} m",
            "polygon": f"polygon of {len(self.polygon)} corners",
        }[self.kind]

    def holds_origin(self, distance: float = 0.0) -> bool:
        """Tell whether the robot's origin, where its LiDAR is, lies within the outline or so near to it, in metres."""
        if self.kind != "polygon":
            return True
        first = as_plane(self.polygon)[:, None]
        edges, origin = (first, np.roll(first, -1, axis=0)), np.zeros(1, np.complex128)
        away = float(np.sqrt(point_edge_squared(origin, *edges).min()))
        within = bool(winding_number(origin, *edges)[0] > 0)
        return (within and away > _TOUCHING) or away + _TOUCHING < distance

    @staticmethod
    def rectangle(length: float, width: float) -> Footprint:
        """Return a rectangle centred on the robot's origin; metres along x and y."""
        x, y = 0.5 * length, 0.5 * width
        return Footprint("polygon", polygon=np.array([[-x, -y], [x, -y], [x, y], [-x, y]]))


@dataclass(frozen=True, eq=False)
class Robot:
    """A robot: what it can do in one control interval and how much room it takes.

    Parameters
    ----------
    name : str
        A known robot, or any name of a custom one.
    min_linear, max_linear : float
        Speed along x, in m/s; commands are clipped to them.
    max_angular : float
        Turning speed to either side, in rad/s; commands are clipped to it.
    deceleration : float
        Largest braking of the forward speed, in m/s^2.
    control_interval : float
        Time for which one command is held, in seconds.
    footprint : Footprint
        Outline in the robot's frame, from which clearances are measured.
    lidar : Lidar
        Its range finder.
    kinematics : str
        How it moves: a name that `viatool.motion.kinematics` knows.
    max_lateral : float
        Speed to either side, in m/s, of a robot that can.
    track : float
        Distance between its wheels to the left and to the right, in metres; 0 where it is not known.
    wheelbase : float
        Distance between the axles of a car, in metres; 0 where it is not known. Its origin is the rear one's middle.
    max_steering : float
        Angle of the front wheels of a car to either side, in rad.
    max_steering_rate : float
        How fast they turn, in rad/s; 0 for wheels that are steered at once.
    min_acceleration, max_acceleration : float
        Of the forward speed, in m/s^2, of a robot that is commanded so; both 0 where it is not known.
    max_angular_acceleration : float
        Of the turn to either side, in rad/s^2; 0 where it is not known.

    Notes
    -----
    A speed that is no command, of a robot that is commanded with accelerations, may be unlimited: infinite.

    Raises
    ------
    ConfigurationError
        If a limit is not finite, the largest speed is below the least one or below 0, or another limit is negative.
    """

    name: str = "turtlebot3"
    min_linear: float = 0.0
    max_linear: float = 0.5
    max_angular: float = 1.0
    deceleration: float = 1.0
    control_interval: float = 0.1
    footprint: Footprint = field(default_factory=Footprint)
    lidar: Lidar = field(default_factory=Lidar)
    kinematics: str = "differential"
    max_lateral: float = 0.0
    track: float = 0.0
    wheelbase: float = 0.0
    max_steering: float = 0.0
    max_steering_rate: float = 0.0
    min_acceleration: float = 0.0
    max_acceleration: float = 0.0
    max_angular_acceleration: float = 0.0

    def known(self, name: str) -> float:
        """Return a length of its body.

        Raises
        ------
        ConfigurationError
            If it is not known.
        """
        length = float(getattr(self, name))
        if length <= 0.0:
            raise ConfigurationError(
                f"the {name} of robot '{self.name}' is not known, and its commands depend on it",
                f"give the map's robot its `{name}` in metres, or name a known robot",
            )
        return length

    @property
    def speeds(self) -> str:
        """Return its limits in words, for reports."""
        aside = f", to either side up to {self.max_lateral:g} m/s" if self.max_lateral else ""
        turn = f"|omega| up to {self.max_angular:g} rad/s"
        if self.wheelbase:
            turn = f"steering up to {self.max_steering:g} rad"
        limited = np.isfinite([self.min_linear, self.max_linear]).any()
        ahead = f"v {self.min_linear:g} to {self.max_linear:g} m/s" if limited else "v unlimited"
        return f"{ahead}, {turn}{aside}"

    def __post_init__(self) -> None:
        limits = {name: getattr(self, name) for name in (*_SIGNED, *_NOT_NEGATIVE)}
        finite = [np.isfinite(value) or name in _SPEEDS for name, value in limits.items()]
        if not all(finite) or np.isnan(list(limits.values())).any():
            raise ConfigurationError(
                f"robot '{self.name}' has the limits {tuple(limits.values())} ({', '.join(limits)}), "
                "expected finite numbers",
                "correct the limits",
            )
        if self.max_linear < max(self.min_linear, 0.0):
            raise ConfigurationError(
                f"max_linear {self.max_linear} m/s is below min_linear {self.min_linear} m/s or below 0",
                "correct the speed limits",
            )
        if not self.min_acceleration <= 0.0 <= self.max_acceleration:
            raise ConfigurationError(
                f"robot '{self.name}' accelerates by {self.min_acceleration:g} to {self.max_acceleration:g} m/s^2, "
                "expected a range that holds 0",
                "correct min_acceleration and max_acceleration",
            )
        for name in _NOT_NEGATIVE:
            if getattr(self, name) < 0.0:
                raise ConfigurationError(
                    f"{name} of robot '{self.name}' is {getattr(self, name)}, expected 0 or more",
                    "correct it",
                )


# turtlebot3 is the robot of the paper's task: a point with the task's own command limits. The others carry the limits
# and outlines of their data sheets, each with its source; unless it says otherwise an outline is taken as centred on
# the axis of the wheels. Lengths between wheels turn what a policy commands wheels with into speeds and turns.
ROBOTS: dict[str, Robot] = {
    robot.name: robot
    for robot in (
        Robot(track=0.287),
        # ROBOTIS e-Manual, TurtleBot3, specifications; wheels 160 mm apart.
        Robot(
            name="turtlebot3_burger",
            max_linear=0.22,
            max_angular=2.84,
            footprint=Footprint("circle", radius=0.105),
            track=0.160,
        ),
        # The same page; wheels 287 mm apart.
        Robot(
            name="turtlebot3_waffle",
            max_linear=0.26,
            max_angular=1.82,
            footprint=Footprint.rectangle(0.281, 0.306),
            track=0.287,
        ),
        # TurtleBot 4 user manual, features: 341 x 339 mm, 1.9 rad/s, and 0.31 m/s while the safety of its base, a
        # Create 3, is on (0.46 m/s without); the wheels of a Create 3 are 233 mm apart. A disc around the longer side.
        Robot(
            name="turtlebot4",
            min_linear=-0.31,
            max_linear=0.31,
            max_angular=1.9,
            footprint=Footprint("circle", radius=0.1705),
            track=0.233,
        ),
        # Clearpath, Jackal data sheet, 508 x 430 mm; 2 m/s and 4 rad/s in jackal_control/config/control.yaml.
        Robot(
            name="jackal",
            max_linear=2.0,
            max_angular=4.0,
            footprint=Footprint.rectangle(0.508, 0.430),
            track=0.376,
        ),
        # Clearpath, Husky A200 data sheet, 990 x 670 mm and 1 m/s; 2 rad/s in husky_control/config/control.yaml;
        # wheels 570.8 mm apart in husky_description.
        Robot(
            name="husky",
            min_linear=-1.0,
            max_linear=1.0,
            max_angular=2.0,
            footprint=Footprint.rectangle(0.990, 0.670),
            track=0.5708,
        ),
        # AgileX, Scout 2.0 user manual, 930 x 699 mm, 1.5 m/s and 0.7853 rad/s; wheels 583.06 mm apart in its driver's
        # scout_params.hpp.
        Robot(
            name="scout",
            min_linear=-1.5,
            max_linear=1.5,
            max_angular=0.7853,
            footprint=Footprint.rectangle(0.930, 0.699),
            track=0.58306,
        ),
        # MiR100 data sheet, 890 x 580 mm, 1.5 m/s ahead and 0.3 m/s backwards; 1 rad/s and wheels 445.208 mm apart in
        # mir_description, a robot description by others.
        Robot(
            name="mir100",
            min_linear=-0.3,
            max_linear=1.5,
            max_angular=1.0,
            footprint=Footprint.rectangle(0.890, 0.580),
            track=0.445208,
        ),
        # Boston Dynamics, About Spot: 1100 x 500 mm, 1.6 m/s at most; that holds to the side and backwards as well.
        # No turning speed is published: 2 rad/s is an assumption.
        Robot(
            name="spot",
            kinematics="holonomic",
            min_linear=-1.6,
            max_linear=1.6,
            max_lateral=1.6,
            max_angular=2.0,
            footprint=Footprint.rectangle(1.100, 0.500),
        ),
        # f1tenth_gym, default parameters: axles 158.75 + 171.45 mm apart, 0.4189 rad, -5 to 20 m/s, 580 x 310 mm. The
        # origin is the middle of the rear axle, with as much of the body behind it as before the front axle.
        Robot(
            name="f1tenth",
            kinematics="ackermann",
            min_linear=-5.0,
            max_linear=20.0,
            max_steering=0.4189,
            deceleration=9.51,
            wheelbase=0.3302,
            footprint=Footprint(
                "polygon",
                polygon=np.array([[-0.1249, -0.155], [0.4551, -0.155], [0.4551, 0.155], [-0.1249, 0.155]]),
            ),
        ),
    )
}
