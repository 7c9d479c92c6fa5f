"""ROS bags written by the project's own simulator: a driven episode as odometry, scans, commands, transforms."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from viatool.simulate import roll_out
from viatool.trajectory import Trajectory
from viatool.world import Scenes, WorldMap

KINDS = ("rosbag1", "sqlite3", "mcap")
START = 1_700_000_000_000_000_000  # nanoseconds
MILLISECOND = 1_000_000
ROS1, ROS2 = get_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.ROS2_HUMBLE)
ODOMETRY, SCAN = "nav_msgs/msg/Odometry", "sensor_msgs/msg/LaserScan"
TWIST, TF = "geometry_msgs/msg/Twist", "tf2_msgs/msg/TFMessage"
ROS1.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", TF))


@dataclass
class Message:
    """One message before it is written; `fields` are those of the ROS type, nested."""

    topic: str
    type: str
    received: int
    fields: dict[str, Any]


def drive_messages(
    policy: Any,
    world_map: WorldMap,
    episode: int = 0,
    *,
    drift: tuple[float, float, float] | None = None,
    mount: float = 0.0,
) -> tuple[list[Message], Trajectory]:
    """Drive one scenario without sensor noise; return its messages, and the states as the simulator saw them.

    With `drift` the odometry lives in a frame `odom` that lies so in the map, told by /tf; `mount` is the yaw of
    the LiDAR on the robot.
    """
    chosen = [world_map.scenarios[episode]]
    driven = roll_out(policy, world_map, chosen, noise=0.0)
    lidar = world_map.robot.lidar
    ranges = Scenes.of(world_map, chosen).cast(driven.poses, driven.episode, lidar)
    ranges = np.where(ranges >= lidar.maximum_range, np.inf, np.maximum(ranges, lidar.minimum_range))
    turned = lidar.angles() - mount
    messages = [static_transform("base_link", "laser", START, (0.0, 0.0, mount))]
    for row, pose in enumerate(driven.poses):
        now = START + round(1e9 * float(driven.time[row]))
        frame, seen = ("map", pose) if drift is None else ("odom", within(pose, drift))
        if drift is not None:
            messages.append(transform("/tf", "map", "odom", now, drift))
        messages.append(odometry(now, frame, seen))
        messages.append(scan(now + 0, turned, ranges[row], lidar.minimum_range, lidar.maximum_range))
        messages.append(
            Message("/cmd_vel", TWIST, now + 20 * MILLISECOND, twist(*driven.actions[row].tolist()))
        )
    return messages, driven


def within(pose: np.ndarray, frame: tuple[float, float, float]) -> np.ndarray:
    """Return a pose as seen from a frame."""
    away = (pose[0] - frame[0]) + 1j * (pose[1] - frame[1])
    away *= np.exp(-1j * frame[2])
    return np.array([away.real, away.imag, pose[2] - frame[2]])


def header(stamp: int, frame: str) -> dict[str, Any]:
    return {"stamp": {"sec": stamp // 10**9, "nanosec": stamp % 10**9}, "frame_id": frame}


def yaw(angle: float) -> dict[str, float]:
    return {"x": 0.0, "y": 0.0, "z": float(np.sin(angle / 2)), "w": float(np.cos(angle / 2))}


def twist(linear: float, angular: float) -> dict[str, Any]:
    return {"linear": {"x": linear, "y": 0.0, "z": 0.0}, "angular": {"x": 0.0, "y": 0.0, "z": angular}}


def odometry(stamp: int, frame: str, pose: np.ndarray) -> Message:
    place = {"position": {"x": pose[0], "y": pose[1], "z": 0.0}, "orientation": yaw(pose[2])}
    fields = {
        "header": header(stamp, frame),
        "child_frame_id": "base_link",
        "pose": {"pose": place, "covariance": np.zeros(36)},
        "twist": {"twist": twist(0.0, 0.0), "covariance": np.zeros(36)},
    }
    return Message("/odom", ODOMETRY, stamp + MILLISECOND, fields)


def scan(stamp: int, angles: np.ndarray, ranges: np.ndarray, least: float, largest: float) -> Message:
    fields = {
        "header": header(stamp, "laser"),
        "angle_min": float(angles[0]),
        "angle_max": float(angles[-1]),
        "angle_increment": float(angles[1] - angles[0]),
        "time_increment": 0.0,
        "scan_time": 0.1,
        "range_min": least,
        "range_max": largest,
        "ranges": ranges.astype(np.float32),
        "intensities": np.zeros(0, np.float32),
    }
    return Message("/scan", SCAN, stamp + 2 * MILLISECOND, fields)


def transform(topic: str, parent: str, child: str, stamp: int, pose: tuple[float, float, float]) -> Message:
    part = {
        "header": header(stamp, parent),
        "child_frame_id": child,
        "transform": {"translation": {"x": pose[0], "y": pose[1], "z": 0.0}, "rotation": yaw(pose[2])},
    }
    return Message(topic, TF, stamp, {"transforms": [part]})


def static_transform(parent: str, child: str, stamp: int, pose: tuple[float, float, float]) -> Message:
    return transform("/tf_static", parent, child, stamp, pose)


def build(store: Any, type_name: str, fields: dict[str, Any]) -> Any:
    """Make a message of nested dictionaries."""
    _, described = store.fielddefs[type_name]
    made = {}
    for name, (kind, detail) in described:
        if name not in fields:
            made[name] = 0  # a ROS 1 header counts its messages
        elif int(kind) == 2:
            made[name] = build(store, detail, fields[name])
        elif isinstance(fields[name], list):
            made[name] = [build(store, detail[0][1], part) for part in fields[name]]
        else:
            made[name] = fields[name]
    return store.types[type_name](**made)


def write_bag(path: Path, messages: list[Message], kind: str, *, empty: tuple[str, ...] = ()) -> Path:
    """Write a bag; returns the file or folder that a user would name. Topics in `empty` get no message."""
    first = kind == "rosbag1"
    store = ROS1 if first else ROS2
    plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
    target = path.with_suffix(".bag") if first else path
    target.parent.mkdir(parents=True, exist_ok=True)
    writer = Writer1(target) if first else Writer(target, version=9, storage_plugin=plugin)
    with writer:
        connections: dict[str, Any] = {}
        for message in sorted(messages, key=lambda message: message.received):
            if message.topic not in connections:
                connections[message.topic] = writer.add_connection(
                    message.topic, message.type, typestore=store
                )
            if message.topic in empty:
                continue
            made = build(store, message.type, message.fields)
            serialize = store.serialize_ros1 if first else store.serialize_cdr
            writer.write(connections[message.topic], message.received, serialize(made, message.type))
    return target


def only_file(folder: Path) -> Path:
    """Return the one mcap or sqlite3 file of a ROS 2 bag."""
    (file,) = (entry for entry in folder.iterdir() if entry.suffix in (".mcap", ".db3"))
    return file
