"""The bodies of robots: what a physics engine, wheel odometry and acceleration limits need to know.

Figures are those of the data sheets and of the manufacturers' robot descriptions, rounded; torques and friction
are round figures of the right size. A chassis is centred on the axis of the driven wheels, as the footprints of
`viatool.world.ROBOTS` are.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from viatool.errors import ConfigurationError
from viatool.motion.kinematics import DIFFERENTIAL
from viatool.world import Robot


@dataclass(frozen=True)
class RobotModel:
    """A robot on two driven wheels and two casters without friction.

    Parameters
    ----------
    name : str
        Of the robot that it describes.
    length, width, height : float
        Of the chassis, in metres; its underside is `ground_clearance` above the floor.
    ground_clearance : float
        In metres.
    mass : float
        Of everything, in kg.
    wheel_radius, track : float
        Of the driven wheels, and the distance between them, in metres.
    wheel_mass : float
        Of one driven wheel, in kg.
    wheel_torque : float
        Largest torque of one motor, in N m.
    acceleration : float
        Largest change of a wheel's rim speed, in m/s^2.
    lidar_height : float
        Of the plane of the rays above the floor, in metres.
    wheelbase : float
        Distance between the axles of a robot with four wheels, in metres; 0 for two wheels. Only drawn.
    friction : float
        Coefficient between wheel and floor.
    """

    name: str
    length: float
    width: float
    height: float
    ground_clearance: float
    mass: float
    wheel_radius: float
    track: float
    wheel_mass: float
    wheel_torque: float
    acceleration: float
    lidar_height: float
    wheelbase: float = 0.0
    friction: float = 1.0

    @property
    def caster_radius(self) -> float:
        """Radius of the casters, which bear the chassis in front and behind, in metres."""
        return 0.5 * self.ground_clearance

    @property
    def reach(self) -> float:
        """Largest distance of the body from its origin, seen from above, in metres."""
        half_width = max(0.5 * self.width, 0.5 * self.track + 0.5 * self.wheel_width)
        return math.hypot(0.5 * self.length, half_width)

    @property
    def wheel_width(self) -> float:
        """Width of a wheel as it is drawn, in metres."""
        return 0.6 * self.wheel_radius


_BURGER = RobotModel(
    name="turtlebot3_burger",
    length=0.138,
    width=0.140,
    height=0.135,
    ground_clearance=0.016,
    mass=1.0,
    wheel_radius=0.033,
    track=0.160,
    wheel_mass=0.0285,
    wheel_torque=1.5,
    acceleration=1.0,
    lidar_height=0.182,
)
_WAFFLE = RobotModel(
    name="turtlebot3_waffle",
    length=0.281,
    width=0.266,
    height=0.090,
    ground_clearance=0.016,
    mass=1.8,
    wheel_radius=0.033,
    track=0.287,
    wheel_mass=0.0285,
    wheel_torque=3.0,
    acceleration=1.0,
    lidar_height=0.132,
)
# The Jackal has four wheels and turns by skidding. Here two wheels drive it, in the middle of each side, and the
# friction of the skid is left out: speeds and turns are those that its own controller would settle at.
_JACKAL = RobotModel(
    name="jackal",
    length=0.508,
    width=0.310,
    height=0.184,
    ground_clearance=0.063,
    mass=17.0,
    wheel_radius=0.098,
    track=0.376,
    wheel_mass=0.477,
    wheel_torque=10.0,
    acceleration=3.0,
    lidar_height=0.333,
    wheelbase=0.262,
)

MODELS: dict[str, RobotModel] = {
    "turtlebot3": _WAFFLE,  # the task's robot has its own limits and the body of a Waffle
    **{model.name: model for model in (_BURGER, _WAFFLE, _JACKAL)},
}
"""The body of every robot that is known by name."""


def track_of(robot: Robot) -> float:
    """Return the distance between the wheels of a robot, in metres.

    Raises
    ------
    ConfigurationError
        If it is not known, or the robot does not drive on two wheels.
    """
    _require_wheels(robot)
    return robot.known("track")


def model_of(robot: Robot) -> RobotModel:
    """Return the body of a robot.

    Raises
    ------
    ConfigurationError
        If no body is known for it, or it does not drive on two wheels.
    """
    _require_wheels(robot)
    model = MODELS.get(robot.name)
    if model is None:
        raise ConfigurationError(
            f"the body of robot '{robot.name}' is not known: neither its wheels nor its mass",
            f"choose one with --robot: {', '.join(MODELS)}",
        )
    return model


def _require_wheels(robot: Robot) -> None:
    if robot.kinematics != DIFFERENTIAL.name:
        raise ConfigurationError(
            f"robot '{robot.name}' moves as '{robot.kinematics}', and only bodies on two driven wheels are known",
            "simulate with the kinematic engine, without drift and acceleration",
        )
