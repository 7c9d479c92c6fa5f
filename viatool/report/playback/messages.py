"""ROS messages as plain data: fields by the names of their type, with the stamps and frames of what is played."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from viatool.arrays import Floats, Indices

MAP, ROBOT = "map", "base_link"
BESIDE = "viatool/base_link"
"""The robot's frame beside a recording, whose own tree of frames has a parent for `ROBOT` already."""
SECOND = 1_000_000_000
"""Nanoseconds, in which stamps are."""


@dataclass(frozen=True, eq=False)
class RosMessage:
    """One message.

    Parameters
    ----------
    stamp : int
        Nanoseconds; when it is played.
    topic, type : str
        Where, and of which ROS type.
    fields : mapping
        Values by the names of the type; messages within it are mappings, those that repeat lists of them.
    lasting : bool
        Whether those who listen later are to get it too.
    """

    stamp: int
    topic: str
    type: str
    fields: Mapping[str, Any]
    lasting: bool = False


def nanoseconds(seconds: float) -> int:
    """Return a time in nanoseconds."""
    return round(seconds * SECOND)


def header(stamp: int, frame: str = MAP) -> dict[str, Any]:
    """Return the header of a message."""
    sec, nanosec = divmod(stamp, SECOND)
    return {"stamp": {"sec": sec, "nanosec": nanosec}, "frame_id": frame}


def xyz(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> dict[str, float]:
    """Return a point or a vector."""
    return {"x": float(x), "y": float(y), "z": float(z)}


def yaw(angle: float) -> dict[str, float]:
    """Return a rotation about the upright axis as a quaternion."""
    return {**xyz(z=np.sin(0.5 * angle)), "w": float(np.cos(0.5 * angle))}


def pose_of(pose: Floats) -> dict[str, Any]:
    """Return a pose (3,)."""
    return {"position": xyz(pose[0], pose[1]), "orientation": yaw(float(pose[2]))}


def stamped_pose(stamp: int, pose: Floats) -> dict[str, Any]:
    """Return a pose (3,) in the map with its time."""
    return {"header": header(stamp), "pose": pose_of(pose)}


def standing(stamp: int, pose: Floats, robot: str = ROBOT) -> list[RosMessage]:
    """Return that the robot is at a pose (3,): its frame in the map, and the pose."""
    part = {
        "header": header(stamp),
        "child_frame_id": robot,
        "transform": {"translation": xyz(pose[0], pose[1]), "rotation": yaw(float(pose[2]))},
    }
    return [
        RosMessage(stamp, "/tf", "tf2_msgs/msg/TFMessage", {"transforms": [part]}),
        RosMessage(stamp, "/pose", "geometry_msgs/msg/PoseStamped", stamped_pose(stamp, pose)),
    ]


def path(stamp: int, stamps: Indices | Sequence[int], poses: Floats) -> RosMessage:
    """Return a whole path: poses (N, 3) with their own stamps (N,)."""
    each = [stamped_pose(int(at), pose) for at, pose in zip(stamps, poses, strict=True)]
    return RosMessage(
        stamp, "/path", "nav_msgs/msg/Path", {"header": header(stamp), "poses": each}, lasting=True
    )
