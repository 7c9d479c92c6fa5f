"""Where the robot of a recording stood on the map, and how its LiDAR sits on it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from viatool.arrays import Booleans, Floats, Indices
from viatool.errors import TrajectoryError
from viatool.trajectory.bag import RecordedOdometry
from viatool.trajectory.transforms import Transforms, compose, interpolate, turns_between


@dataclass(frozen=True)
class Mount:
    """How a LiDAR sits on the robot: place in m and heading in rad, and its side (-1: upside down)."""

    x: float = 0.0
    y: float = 0.0
    yaw: float = 0.0
    side: int = 1

    @property
    def away(self) -> float:
        """Return its distance from the robot's origin, in metres."""
        return float(np.hypot(self.x, self.y))


@dataclass(frozen=True, eq=False)
class Placing:
    """What tells poses on the map.

    Parameters
    ----------
    odometry : RecordedOdometry
        Poses of the robot in a frame of its own.
    transforms : Transforms
        How that frame lies in the map's, and the LiDAR on the robot.
    frame : str
        The frame that is the map's.
    gap : float
        Seconds over which poses are interpolated.
    """

    odometry: RecordedOdometry
    transforms: Transforms
    frame: str
    gap: float

    def locate(self, at: Indices) -> tuple[Floats, Booleans]:
        """Return the pose of the robot in the map frame at instants (S,) in ns, (S, 3), and whether it is known.

        Raises
        ------
        TrajectoryError
            If the odometry's frame lies upside down in the map's, or nothing connects them.
        """
        odometry = self.odometry
        poses, known = interpolate(odometry.stamps, odometry.poses, at, self.gap)
        if odometry.frame == self.frame:
            return poses, known
        drift, seen, side = self.transforms.locate(odometry.frame, self.frame, at, self.gap)
        if side < 0:
            raise TrajectoryError(
                f"the odometry's frame '{odometry.frame}' lies upside down in '{self.frame}'",
                "record odometry in a frame whose z axis points upwards (REP 103)",
            )
        return compose(drift, poses), known & seen

    def mount(self, sensor: str) -> Mount:
        """Return how the LiDAR sits on the robot, by the frame of its scans.

        Raises
        ------
        TrajectoryError
            If that is not known, or the LiDAR moves on the robot.
        """
        robot = self.odometry.child
        if sensor == robot:
            return Mount()
        mount, side = self.transforms.mount(sensor, robot, self.gap)
        if not len(mount):
            raise TrajectoryError(
                f"the transforms between the robot '{robot}' and the LiDAR '{sensor}' are never known at the same time",
                "record /tf and /tf_static throughout",
            )
        moved = mount - mount[0]
        moved[:, 2] = turns_between(mount[0, 2], mount[:, 2])
        if np.abs(moved).max() > 1e-3:
            raise TrajectoryError(
                f"the LiDAR '{sensor}' moves on the robot '{robot}'", "record a LiDAR that is fixed to it"
            )
        x, y, yaw = mount[0].tolist()
        return Mount(x, y, yaw, side)
