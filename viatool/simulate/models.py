"""The bodies of robots: what a physics engine, wheel odometry and acceleration limits need to know.

Figures are those of the data sheets and of the manufacturers' robot descriptions, rounded; torques and friction
are round figures of the right size. A chassis is centred on the axis of the driven wheels, as the footprints of
`viatool.world.ROBOTS` are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from viatool.arrays import Floats
from viatool.errors import ConfigurationError
from viatool.motion.kinematics import DIFFERENTIAL
from viatool.world import Robot


@dataclass(frozen=True)
class RobotModel:
    """A robot on two driven wheels and two casters without friction, or a base that is pushed as its command says.

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
    pushed : bool
        Whether no wheel drives it: the engine gives the base the velocity of the command, and it stands on four casters
        without friction. So are legs, wheels that slide, and wheels that steer.
    ahead : float
        How far the middle of the chassis lies before the robot's origin, in metres.
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
    pushed: bool = False
    ahead: float = 0.0

    @property
    def caster_radius(self) -> float:
        """Radius of the casters, which bear the chassis in front and behind, in metres."""
        return 0.5 * self.ground_clearance

    @property
    def reach(self) -> float:
        """Largest distance of the body from its origin, seen from above, in metres."""
        return float(np.hypot(*self.outline.T).max())

    @property
    def outline(self) -> Floats:
        """Corners of the body, seen from above in the robot's frame, (4, 2) metres."""
        x, y = 0.5 * self.length, max(0.5 * self.width, 0.5 * self.track + 0.5 * self.wheel_width)
        return np.array(
            [[self.ahead - x, -y], [self.ahead + x, -y], [self.ahead + x, y], [self.ahead - x, y]]
        )

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

# Spot walks, and its body floats: here it is a box that is pushed over the floor. Mass, heights and acceleration are
# assumptions, to be replaced by those of one's own robot.
_SPOT = RobotModel(
    name="spot",
    length=1.100,
    width=0.500,
    height=0.200,
    ground_clearance=0.410,
    mass=32.7,
    wheel_radius=0.0,
    track=0.0,
    wheel_mass=0.0,
    wheel_torque=0.0,
    acceleration=2.0,
    lidar_height=0.660,
    pushed=True,
)
# Pushed too, from the middle of the rear axle. Mass, heights and acceleration are assumptions near the defaults of
# f1tenth_gym. How its tyres slip is left out, as in the kinematic engine.
_F1TENTH = RobotModel(
    name="f1tenth",
    length=0.580,
    width=0.310,
    height=0.070,
    ground_clearance=0.040,
    mass=3.74,
    wheel_radius=0.0,
    track=0.0,
    wheel_mass=0.0,
    wheel_torque=0.0,
    acceleration=9.51,
    lidar_height=0.150,
    pushed=True,
    ahead=0.1651,
)

MODELS: dict[str, RobotModel] = {
    "turtlebot3": _WAFFLE,  # the task's robot has its own limits and the body of a Waffle
    **{model.name: model for model in (_BURGER, _WAFFLE, _JACKAL, _SPOT, _F1TENTH)},
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
        If no body is known for it, or that of another kind of robot.
    """
    model = MODELS.get(robot.name)
    if model is None or model.pushed != (robot.kinematics != DIFFERENTIAL.name):
        raise ConfigurationError(
            f"the body of robot '{robot.name}', which moves as '{robot.kinematics}', is not known: neither how it "
            "drives nor its mass",
            f"choose one with --robot: {', '.join(MODELS)}",
        )
    return model


def _require_wheels(robot: Robot) -> None:
    if robot.kinematics != DIFFERENTIAL.name:
        raise ConfigurationError(
            f"robot '{robot.name}' moves as '{robot.kinematics}', and only bodies on two driven wheels are known",
            "simulate with the kinematic engine, without drift and acceleration",
        )
