"""One physics world: a floor, the obstacles of a map, and one robot."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pybullet

from viatool.arrays import Floats
from viatool.simulate.bullet.propulsion import propulsion_of
from viatool.simulate.bullet.scenery import HEIGHT, Ring, TriangleMesh, canonical_form, map_meshes, prisms
from viatool.simulate.bullet.urdf import write_urdf
from viatool.simulate.models import RobotModel
from viatool.world import Obstacles, WorldMap

Form = float | Ring  # radius of a cylinder, or corners of a prism
Segments = Sequence[tuple[int, Sequence[float]]]  # steps of the engine, and a command of the kinematics

_GRAVITY = 9.81
_RAY, _ROBOT, _FLOOR, _SOLID = (
    1,
    2,
    4,
    8,
)  # collision groups; a ray belongs to the first, as the engine has it
_AWAY = (0.0, 0.0, -1000.0)  # where solids wait that the scenario does not need
_SETTLING = 12  # steps at rest after the robot was put down
_ITERATIONS = 30  # of the engine's solver for contacts and joints


class BulletWorld:
    """A physics engine of its own, with one robot in it.

    Parameters
    ----------
    world_map : WorldMap
        Arena and obstacles.
    model : RobotModel
        The body of the robot.
    acceleration : float
        Largest change of a wheel's rim speed, or of the speed of a base without driven wheels, in m/s^2.
    step : float
        Seconds of one step of the engine.
    visible : bool
        Whether solids are drawn, for pictures.
    window : bool
        Whether the engine opens a window.
    """

    def __init__(
        self,
        world_map: WorldMap,
        model: RobotModel,
        acceleration: float,
        step: float,
        *,
        visible: bool = False,
        window: bool = False,
    ) -> None:
        self.model = model
        self.visible = visible
        self.client = pybullet.connect(pybullet.GUI if window else pybullet.DIRECT)
        self._solids: dict[Form, list[int]] = {}  # of scenarios, in use or waiting
        pybullet.setGravity(0.0, 0.0, -_GRAVITY, physicsClientId=self.client)
        pybullet.setPhysicsEngineParameter(
            fixedTimeStep=step,
            numSolverIterations=_ITERATIONS,
            deterministicOverlappingPairs=1,
            physicsClientId=self.client,
        )
        self._add_floor(world_map)
        for mesh in map_meshes(world_map):
            self._add_mesh(mesh, _PAINT["map"])
        for x, y, radius in world_map.obstacles.circles:
            self._add_cylinder(float(radius), (float(x), float(y)), _PAINT["map"])
        self.robot = self._load_robot()
        self._propulsion = propulsion_of(self.client, self.robot, model, acceleration, step, self._offset)

    def close(self) -> None:
        """Give the memory of the engine back."""
        if self.client >= 0:
            pybullet.disconnect(physicsClientId=self.client)
            self.client = -1

    def place(self, pose: Floats, own: Obstacles) -> None:
        """Put the robot down at rest among the map's obstacles and those of one scenario.

        Parameters
        ----------
        pose : ndarray
            (3,) x, y, theta; metres and radians.
        own : Obstacles
            Of the scenario.
        """
        self.arrange(own)
        # In the air the engine forgets the contacts of before, so that nothing is left of an earlier episode.
        for height, steps in ((1.0, 2), (0.0, _SETTLING)):
            self.move_to(pose, height)
            self._propulsion.halt()
            for _ in range(steps):
                pybullet.stepSimulation(physicsClientId=self.client)
        self.move_to(pose)  # settling may turn it by a hair

    def move_to(self, pose: Floats, height: float = 0.0) -> None:
        """Set the robot's pose, as high above the floor as asked for, and stop it."""
        x, y, theta = (float(value) for value in pose)
        turn = (0.0, 0.0, math.sin(0.5 * theta), math.cos(0.5 * theta))
        pybullet.resetBasePositionAndOrientation(
            self.robot, self._base_of(x, y, theta, height), turn, physicsClientId=self.client
        )
        pybullet.resetBaseVelocity(self.robot, (0.0,) * 3, (0.0,) * 3, physicsClientId=self.client)

    def drive(self, segments: Segments) -> None:
        """Let the robot follow commands.

        Parameters
        ----------
        segments : sequence of tuple
            Steps of the engine, and what is commanded during them, in the order of the axes of its kinematics.
        """
        for steps, command in segments:
            for _ in range(steps):
                self._propulsion.toward(command)
                pybullet.stepSimulation(physicsClientId=self.client)

    def pose(self) -> tuple[float, float, float]:
        """Return x, y, theta of the robot, in metres and radians."""
        (x, y, _), turn = self._base()
        rotation = pybullet.getMatrixFromQuaternion(turn)
        ox, oy, oz = self._offset
        # The engine places the centre of mass; the robot's origin is off by a fixed vector in its frame.
        return (
            x - (rotation[0] * ox + rotation[1] * oy + rotation[2] * oz),
            y - (rotation[3] * ox + rotation[4] * oy + rotation[5] * oz),
            math.atan2(rotation[3], rotation[0]),
        )

    def touches(self) -> bool:
        """Tell whether the robot touches an obstacle."""
        return any(
            contact[2] != self._floor and contact[8] <= 0.0
            for contact in pybullet.getContactPoints(bodyA=self.robot, physicsClientId=self.client)
        )

    def cast(self, directions: Floats, limit: float) -> Floats:
        """Return where the rays of the LiDAR end.

        Parameters
        ----------
        directions : ndarray
            (2, R) unit vectors in the robot's frame.
        limit : float
            Length of the rays, in metres.

        Returns
        -------
        ndarray
            (R,) metres; `limit` where nothing is met.
        """
        (x, y, z), turn = self._base()
        rotation = np.reshape(pybullet.getMatrixFromQuaternion(turn), (3, 3))
        above = np.array([0.0, 0.0, self.model.lidar_height]) - self._offset
        origin = np.array([x, y, z]) + rotation @ above
        ends = origin + limit * (rotation[:, :2] @ directions).T
        starts = np.broadcast_to(origin, ends.shape)
        hits = pybullet.rayTestBatch(
            starts.tolist(), ends.tolist(), collisionFilterMask=_SOLID, physicsClientId=self.client
        )
        return limit * np.array([hit[2] for hit in hits])

    def _base(self) -> tuple[tuple[float, float, float], tuple[float, float, float, float]]:
        place, turn = pybullet.getBasePositionAndOrientation(self.robot, physicsClientId=self.client)
        return place, turn

    def _base_of(self, x: float, y: float, theta: float, height: float) -> tuple[float, float, float]:
        ox, oy, oz = self._offset
        cosine, sine = math.cos(theta), math.sin(theta)
        return x + cosine * ox - sine * oy, y + sine * ox + cosine * oy, height + oz

    def _load_robot(self) -> int:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "robot.urdf"
            path.write_text(write_urdf(self.model), encoding="utf-8")
            robot = int(
                pybullet.loadURDF(
                    str(path), flags=pybullet.URDF_USE_INERTIA_FROM_FILE, physicsClientId=self.client
                )
            )
        self._offset = np.array(pybullet.getDynamicsInfo(robot, -1, physicsClientId=self.client)[3])
        for link in range(-1, pybullet.getNumJoints(robot, physicsClientId=self.client)):
            pybullet.setCollisionFilterGroupMask(
                robot, link, _ROBOT, _SOLID | _FLOOR, physicsClientId=self.client
            )
            pybullet.changeDynamics(
                robot, link, linearDamping=0.0, angularDamping=0.0, physicsClientId=self.client
            )
        return robot

    def _add_floor(self, world_map: WorldMap) -> None:
        plane = pybullet.createCollisionShape(pybullet.GEOM_PLANE, physicsClientId=self.client)
        self._floor = self._add_body(plane, (0.0, 0.0, 0.0), -1)
        pybullet.setCollisionFilterGroupMask(self._floor, -1, _FLOOR, _ROBOT, physicsClientId=self.client)
        if self.visible:
            x_min, y_min, x_max, y_max = world_map.bounds
            half = (0.5 * (x_max - x_min) + 1.0, 0.5 * (y_max - y_min) + 1.0, 0.005)
            slab = pybullet.createVisualShape(
                pybullet.GEOM_BOX, halfExtents=half, rgbaColor=_PAINT["floor"], physicsClientId=self.client
            )
            self._add_body(
                -1, (0.5 * (x_min + x_max), 0.5 * (y_min + y_max), -0.002), slab
            )  # above the plane, by 3 mm

    def arrange(self, own: Obstacles) -> None:
        """Stand up the obstacles of a scenario; solids of the same form are used again, so that memory stays flat."""
        waiting = {form: list(bodies) for form, bodies in self._solids.items()}
        for x, y, radius in own.circles.tolist():
            self._stand(waiting, radius, (x, y, 0.5 * HEIGHT), 0.0)
        for ring in own.polygons:
            form, (x, y), turn = canonical_form(ring)
            self._stand(waiting, form, (x, y, 0.0), turn)
        for bodies in waiting.values():
            for body in bodies:
                self._move_body(body, _AWAY, 0.0)

    def _stand(
        self, waiting: dict[Form, list[int]], form: Form, place: tuple[float, float, float], turn: float
    ) -> None:
        """Take a solid of some form that is not in use, or make one, and put it somewhere."""
        if waiting.get(form):
            body = waiting[form].pop()
        else:
            body = self._add_solid(form)
            self._solids.setdefault(form, []).append(body)
        self._move_body(body, place, turn)

    def _add_solid(self, form: Form) -> int:
        if isinstance(form, float):
            return self._add_cylinder(form, (0.0, 0.0), _PAINT["own"])
        (mesh,) = prisms([np.array(form)])
        return self._add_mesh(mesh, _PAINT["own"])

    def _move_body(self, body: int, place: tuple[float, float, float], turn: float) -> None:
        rotation = (0.0, 0.0, math.sin(0.5 * turn), math.cos(0.5 * turn))
        pybullet.resetBasePositionAndOrientation(body, place, rotation, physicsClientId=self.client)

    def _add_cylinder(self, radius: float, place: tuple[float, float], paint: tuple[float, ...]) -> int:
        size: dict[str, Any] = {"radius": radius, "physicsClientId": self.client}
        shape = pybullet.createCollisionShape(pybullet.GEOM_CYLINDER, height=HEIGHT, **size)
        drawn = -1
        if self.visible:
            drawn = pybullet.createVisualShape(pybullet.GEOM_CYLINDER, length=HEIGHT, rgbaColor=paint, **size)
        return self._add_obstacle(shape, drawn, (*place, 0.5 * HEIGHT))

    def _add_mesh(self, mesh: TriangleMesh, paint: tuple[float, ...]) -> int:
        content: dict[str, Any] = {
            "vertices": mesh.vertices.tolist(),
            "indices": mesh.faces.ravel().tolist(),
            "physicsClientId": self.client,
        }
        shape = pybullet.createCollisionShape(
            pybullet.GEOM_MESH, flags=pybullet.GEOM_FORCE_CONCAVE_TRIMESH, **content
        )
        drawn = (
            pybullet.createVisualShape(pybullet.GEOM_MESH, rgbaColor=paint, **content) if self.visible else -1
        )
        return self._add_obstacle(shape, drawn, (0.0, 0.0, 0.0))

    def _add_obstacle(self, shape: int, drawn: int, place: tuple[float, float, float]) -> int:
        body = self._add_body(shape, place, drawn)
        pybullet.setCollisionFilterGroupMask(body, -1, _SOLID, _ROBOT | _RAY, physicsClientId=self.client)
        return body

    def _add_body(self, shape: int, place: tuple[float, float, float], drawn: int) -> int:
        return int(
            pybullet.createMultiBody(0.0, shape, drawn, basePosition=place, physicsClientId=self.client)
        )


_PAINT = {
    "floor": (0.93, 0.93, 0.90, 1.0),
    "map": (0.55, 0.58, 0.62, 1.0),
    "own": (0.80, 0.50, 0.30, 1.0),
}
