"""What makes a body move in the physics engine: motors on two wheels, or a base that is pushed as a command says."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Protocol

import pybullet

from viatool.arrays import Floats
from viatool.simulate.bullet.urdf import LEFT, RIGHT
from viatool.simulate.models import RobotModel


class Propulsion(Protocol):
    """Moves one robot."""

    def halt(self) -> None:
        """Bring everything that turns to rest at once, as when the robot is put down."""

    def toward(self, command: Sequence[float]) -> None:
        """Come nearer to a command of the robot's kinematics, as far as one step of the engine allows."""


def propulsion_of(
    client: int, robot: int, model: RobotModel, acceleration: float, step: float, offset: Floats
) -> Propulsion:
    """Return what moves a robot.

    Parameters
    ----------
    client, robot : int
        As the engine numbers them.
    model : RobotModel
        Of the robot.
    acceleration : float
        Largest change of a rim's speed, or of the base's, in m/s^2.
    step : float
        Seconds of one step of the engine.
    offset : ndarray
        (3,) where the centre of mass lies in the robot's frame.
    """
    if model.pushed:
        return PushedBase(client, robot, model, acceleration * step, step, offset)
    return WheelMotors(client, robot, model, acceleration * step)


class WheelMotors:
    """Two wheels with motors of limited torque, whose speeds grow by so much in a step at most, in m/s at the rim."""

    def __init__(self, client: int, robot: int, model: RobotModel, most: float) -> None:
        self._client, self._robot, self._model, self._most = client, robot, model, most
        joints = {
            pybullet.getJointInfo(robot, joint, physicsClientId=client)[1].decode(): joint
            for joint in range(pybullet.getNumJoints(robot, physicsClientId=client))
        }
        self._wheels = [joints[LEFT], joints[RIGHT]]
        self._speeds = [0.0, 0.0]  # at the rims, that the motors hold, in m/s
        self._set()

    def halt(self) -> None:
        """See `Propulsion.halt`."""
        self._speeds = [0.0, 0.0]
        self._set()
        for joint in self._wheels:
            pybullet.resetJointState(self._robot, joint, 0.0, 0.0, physicsClientId=self._client)

    def toward(self, command: Sequence[float]) -> None:
        """See `Propulsion.toward`; v in m/s and omega in rad/s."""
        linear, angular = command
        half, most = 0.5 * self._model.track, self._most
        targets = (linear - angular * half, linear + angular * half)
        speeds = [_nearer(speed, target, most) for speed, target in zip(self._speeds, targets, strict=True)]
        if speeds != self._speeds:
            self._speeds = speeds
            self._set()

    def _set(self) -> None:
        radius, torque = self._model.wheel_radius, self._model.wheel_torque
        pybullet.setJointMotorControlArray(
            self._robot,
            self._wheels,
            pybullet.VELOCITY_CONTROL,
            targetVelocities=[speed / radius for speed in self._speeds],
            forces=[torque, torque],
            physicsClientId=self._client,
        )


class PushedBase:
    """A base that is given the velocity of its command in each step: legs, sliding wheels and steered ones as one.

    How the feet or tyres hold the floor is left out; mass, contacts and what stands in the way are not. The velocity
    changes by so much in a step at most, in m/s, at the origin, and where the body reaches furthest from turning.
    """

    def __init__(
        self, client: int, robot: int, model: RobotModel, most: float, step: float, offset: Floats
    ) -> None:
        self._client, self._robot, self._step = client, robot, step
        self._most = (most, most / model.reach, most)
        self._away = (float(offset[0]), float(offset[1]))
        self._held = [0.0, 0.0, 0.0]  # ahead in m/s, turning in rad/s, to the left in m/s

    def halt(self) -> None:
        """See `Propulsion.halt`."""
        self._held = [0.0, 0.0, 0.0]

    def toward(self, command: Sequence[float]) -> None:
        """See `Propulsion.toward`; v in m/s, omega in rad/s and, of robots that can, the speed to the left in m/s."""
        targets = (*command, 0.0)[:3]
        self._held = [
            _nearer(held, target, most)
            for held, target, most in zip(self._held, targets, self._most, strict=True)
        ]
        ahead, turning, left = self._held
        # the engine moves along a straight line in a step: that of the heading in its middle
        _, turn = pybullet.getBasePositionAndOrientation(self._robot, physicsClientId=self._client)
        rotation = pybullet.getMatrixFromQuaternion(turn)
        heading = math.atan2(rotation[3], rotation[0]) + 0.5 * turning * self._step
        (_, _, up), (roll, pitch, _) = pybullet.getBaseVelocity(self._robot, physicsClientId=self._client)
        x, y = self._away
        ahead, left = ahead - turning * y, left + turning * x  # of the centre of mass
        cosine, sine = math.cos(heading), math.sin(heading)
        pybullet.resetBaseVelocity(
            self._robot,
            (cosine * ahead - sine * left, sine * ahead + cosine * left, up),
            (roll, pitch, turning),
            physicsClientId=self._client,
        )


def _nearer(value: float, target: float, most: float) -> float:
    """Return a value that is moved to a target, but by no more than so much."""
    return value + min(max(target - value, -most), most)
