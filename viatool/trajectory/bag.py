"""ROS 1 and ROS 2 bags to arrays: odometry, laser scans, commands and transforms, as they were recorded."""

from __future__ import annotations

import re
from array import array
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from viatool.arrays import Floats, Indices
from viatool.errors import TrajectoryError, ViatoolError
from viatool.trajectory.scans import Scans
from viatool.trajectory.transforms import Transforms, heading_of, side_of

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader
    from rosbags.interfaces import Connection


SUFFIXES = (".bag", ".mcap", ".db3")
METADATA = "metadata.yaml"
ODOMETRY = "nav_msgs/msg/Odometry"
SCAN = "sensor_msgs/msg/LaserScan"
STAMPED = ("geometry_msgs/msg/TwistStamped", ODOMETRY)
COMMANDS = ("geometry_msgs/msg/Twist", *STAMPED)
_SCANS = 4096  # that are in memory at the same time
TRANSFORMS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")


@dataclass(frozen=True, eq=False)
class RecordedOdometry:
    """M poses of a frame of the robot: stamps (M,) in nanoseconds, poses (M, 3) in `frame`.

    The velocities (M, 3) are those that the robot measured, in its own frame: m/s ahead and to the left, and rad/s.
    """

    stamps: Indices
    poses: Floats
    velocities: Floats
    frame: str
    child: str


@dataclass(frozen=True, eq=False)
class RecordedCommands:
    """C commands: stamps (C,) in nanoseconds, values (C, 3); by the recorder's clock if `received`.

    The values are speeds ahead and to the left in m/s, and turning speeds in rad/s.
    """

    stamps: Indices
    values: Floats
    received: bool


@dataclass(frozen=True, eq=False)
class Bag:
    """What a bag holds; `commands` is None when they were not asked for. The scans are read when they are asked for."""

    odometry: RecordedOdometry
    commands: RecordedCommands | None
    transforms: Transforms
    scans: Iterator[Scans]


@dataclass(frozen=True, eq=False)
class BagParts:
    """Whatever a bag holds of what can be read; None where a topic is not there, and why, by what it is of."""

    odometry: RecordedOdometry | None
    commands: RecordedCommands | None
    transforms: Transforms
    scans: Iterator[Scans] | None
    missing: Mapping[str, str]


@dataclass(frozen=True)
class Topics:
    """Names of topics; None takes the usual name, or the only topic of the type."""

    scan: str | None = None
    odometry: str | None = None
    command: str | None = None


def is_bag(path: Path) -> bool:
    """Tell whether a path is a bag: a .bag, .mcap or .db3 file, or a folder that holds one or its metadata.yaml."""
    return path.suffix.lower() in SUFFIXES or (path / METADATA).is_file() or bool(_files_in(path))


def _files_in(folder: Path) -> list[Path]:
    """Return the files of bags in a folder, by name; none if it is not a folder."""
    if not folder.is_dir():
        return []
    return sorted(entry for entry in folder.iterdir() if entry.suffix.lower() in SUFFIXES and entry.is_file())


def _parts(path: Path) -> list[Path]:
    """Return what to open for a bag: itself, or the files of a folder that lost its metadata.yaml.

    Raises
    ------
    TrajectoryError
        If it cannot be told that the files of such a folder are the parts of one recording.
    """
    if not path.is_dir() or (path / METADATA).is_file():
        return [path]
    files = _files_in(path)
    if len(files) == 1:
        return files
    numbered = {file: re.fullmatch(r"(.*)_(\d+)(\.\w+)", file.name) for file in files}
    parts = sorted((match[1], match[3], int(match[2]), file) for file, match in numbered.items() if match)
    one = len({part[:2] for part in parts}) == 1
    if one and [part[2] for part in parts] == list(range(len(files))):  # as ros2 bag splits a recording
        return [part[3] for part in parts]
    raise TrajectoryError(
        f"the folder holds {len(files)} files ({', '.join(file.name for file in files)}) and no {METADATA} that would "
        "say how they belong together",
        f"name one of the files, or write the {METADATA} again with 'ros2 bag reindex'",
    )


@contextmanager
def open_bag(path: Path, topics: Topics, *, commands: bool) -> Iterator[Bag]:
    """Read the topics of a bag: first all but the scans, then the scans some at a time, while the bag is open.

    Parameters
    ----------
    path : Path
        A ROS 1 bag, a ROS 2 folder (also one without its metadata.yaml), or a single mcap or sqlite3 file.
    topics : Topics
        Which topics.
    commands : bool
        Whether the commands are needed.

    Yields
    ------
    Bag
        In the order of recording.

    Raises
    ------
    TrajectoryError
        If the bag is cut off or unreadable, lacks a topic, or holds a clock that goes back, poses that are
        not finite, or frames that change.
    """
    with _opened(path) as reader:
        scan = _choose(reader, "scan", topics.scan, (SCAN,), "/scan", "--scan-topic")
        odom = _choose(reader, "odometry", topics.odometry, (ODOMETRY,), "/odom", "--odom-topic")
        drive = None
        if commands:
            usual = COMMANDS if topics.command else COMMANDS[:2]
            drive = _choose(reader, "command", topics.command, usual, "/cmd_vel", "--cmd-topic")
        yield Bag(
            odometry=_read_odometry(reader, odom),
            commands=None if drive is None else _read_commands(reader, drive),
            transforms=_read_transforms(reader),
            scans=_read_scans(reader, scan),
        )


@contextmanager
def open_parts(path: Path, topics: Topics) -> Iterator[BagParts]:
    """Read whatever topics a bag has; one that was named has to be there. Everything else is as for `open_bag`."""
    with _opened(path) as reader:
        missing: dict[str, str] = {}

        def find(what: str, *wanted: Any) -> list[Connection] | None:
            try:
                return _choose(reader, what, *wanted)
            except _MissingTopicError as error:
                missing[what] = error.message
                return None

        scan = find("scan", topics.scan, (SCAN,), "/scan", "--scan-topic")
        odom = find("odometry", topics.odometry, (ODOMETRY,), "/odom", "--odom-topic")
        usual = COMMANDS if topics.command else COMMANDS[:2]
        drive = find("command", topics.command, usual, "/cmd_vel", "--cmd-topic")
        yield BagParts(
            odometry=None if odom is None else _read_odometry(reader, odom),
            commands=None if drive is None else _read_commands(reader, drive),
            transforms=_read_transforms(reader),
            scans=None if scan is None else _read_scans(reader, scan),
            missing=missing,
        )


class _MissingTopicError(TrajectoryError):
    """Nobody named a topic, and a bag has none of the type."""


@contextmanager
def _opened(path: Path) -> Iterator[AnyReader]:
    """Open a bag."""
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    with _readable():
        reader = AnyReader(_parts(path), default_typestore=get_typestore(Stores.ROS2_HUMBLE))
        reader.open()
    try:
        yield reader
    finally:
        reader.close()


@contextmanager
def _readable() -> Iterator[None]:
    """Turn whatever the parsers of bags raise into one kind of error."""
    try:
        yield
    except (ViatoolError, ModuleNotFoundError):
        raise
    except Exception as error:  # a damaged file can fail anywhere in the parsers of four formats
        raise TrajectoryError(
            f"not a readable bag ({type(error).__name__}: {error})",
            "check that the recording was closed properly; 'ros2 bag reindex' or 'rosbag reindex' can repair some",
        ) from error


def _choose(
    reader: AnyReader, what: str, asked: str | None, types: Sequence[str], usual: str, option: str
) -> list[Connection]:
    """Return the connections of one topic: the one asked for, the usual one, or the only one of its type."""
    fitting = sorted({c.topic for c in reader.connections if c.msgtype in types})
    name = asked or (usual if usual in fitting else fitting[0] if len(fitting) == 1 else None)
    listed = ", ".join(sorted(f"{c.topic} ({c.msgtype})" for c in reader.connections)) or "none"
    if name is None and fitting:
        raise TrajectoryError(
            f"the bag has several {what} topics: {', '.join(fitting)}", f"name one with {option}"
        )
    if name not in fitting:
        wanted = f"'{name}' of type {' or '.join(types)}" if name else f"of type {' or '.join(types)}"
        kind = TrajectoryError if asked else _MissingTopicError
        raise kind(
            f"the bag has no {what} topic {wanted}; its topics: {listed}",
            f"record it, or name it with {option}",
        )
    return [c for c in reader.connections if c.topic == name]


def _messages(reader: AnyReader, connections: list[Connection]) -> Iterator[tuple[int, Any]]:
    """Yield when a message was recorded, in nanoseconds, and the message."""
    if connections:  # rosbags reads none as all
        with _readable():
            for connection, received, raw in reader.messages(connections=connections):
                yield received, reader.deserialize(raw, connection.msgtype)


def _stamp(header: Any) -> int:
    return int(header.stamp.sec) * 1_000_000_000 + int(header.stamp.nanosec)


def _frame(name: str) -> str:
    return name.removeprefix("/")  # ROS 1 names


def _quaternion(rotation: Any) -> tuple[float, float, float, float]:
    return float(rotation.x), float(rotation.y), float(rotation.z), float(rotation.w)


def _read_odometry(reader: AnyReader, connections: list[Connection]) -> RecordedOdometry:
    stamps, poses, velocities, frames = array("q"), array("d"), array("d"), set()
    for _, message in _messages(reader, connections):
        pose, twist = message.pose.pose, message.twist.twist
        rotation = _quaternion(pose.orientation)
        if side_of(rotation) < 0:
            raise TrajectoryError(
                f"odometry message {len(stamps)} has the robot upside down",
                "check the node that published it",
            )
        stamps.append(_stamp(message.header))
        poses.extend((pose.position.x, pose.position.y, heading_of(rotation)))
        velocities.extend((twist.linear.x, twist.linear.y, twist.angular.z))
        frames.add((_frame(message.header.frame_id), _frame(message.child_frame_id)))
    table = np.array(poses).reshape(-1, 3)
    bad = np.flatnonzero(~np.isfinite(table).all(axis=1))
    if bad.size:
        raise TrajectoryError(
            f"odometry message {bad[0]} has the pose {table[bad[0]].tolist()} (a heading that is nan stands for "
            "a quaternion that is not a rotation)",
            "check the node that published it, or cut the recording",
        )
    if len(frames) > 1:
        raise TrajectoryError(
            f"the odometry changes its frames: {sorted(frames)}", "record one odometry, or name its topic"
        )
    frame, child = frames.pop() if frames else ("", "")
    moving = np.array(velocities).reshape(-1, 3)
    return RecordedOdometry(_ordered(np.array(stamps), "odometry"), table, moving, frame, child)


def _read_scans(reader: AnyReader, connections: list[Connection]) -> Iterator[Scans]:
    """Yield all scans, `_SCANS` at a time."""
    messages = _messages(reader, connections)
    before, last, frames = 0, np.zeros(0, dtype=np.int64), set[str]()
    while some := list(islice(messages, _SCANS)):
        frames.update(_frame(message.header.frame_id) for _, message in some)
        if len(frames) > 1:
            raise TrajectoryError(
                f"the scans come from several frames: {', '.join(sorted(frames))}",
                "record one LiDAR on one topic",
            )
        stamps = np.array([_stamp(message.header) for _, message in some], dtype=np.int64)
        _ordered(np.concatenate([last, stamps]), "scan", before - len(last))
        yield Scans(
            stamps,
            np.array([received for received, _ in some], dtype=np.int64),
            tuple(np.asarray(message.ranges, dtype=np.float32) for _, message in some),  # the message's type
            _geometry([message for _, message in some], before),
            *frames,
        )
        before, last = before + len(some), stamps[-1:]


def _geometry(scans: Sequence[Any], before: int) -> Floats:
    """Return the first angle, angle step, least and largest range of scans, of which so many stand before them."""
    described = np.array(
        [(scan.angle_min, scan.angle_increment, scan.range_min, scan.range_max) for scan in scans],
        dtype=np.float64,
    )
    usable = np.isfinite(described[:, :2]).all(axis=1) & (described[:, 2] < described[:, 3])
    bad = np.flatnonzero(~usable)
    if bad.size:
        raise TrajectoryError(
            f"scan {before + bad[0]} has the first angle, angle step, least and largest range "
            f"{described[bad[0]].tolist()}",
            "check the LiDAR's driver",
        )
    return described


def _read_commands(reader: AnyReader, connections: list[Connection]) -> RecordedCommands:
    stamped = connections[0].msgtype in STAMPED
    stamps, values = array("q"), array("d")
    for recorded, message in _messages(reader, connections):
        twist = message.twist if stamped else message
        twist = twist.twist if connections[0].msgtype == ODOMETRY else twist
        stamps.append(_stamp(message.header) if stamped else recorded)
        values.extend((twist.linear.x, twist.linear.y, twist.angular.z))
    table = np.array(values).reshape(-1, 3)
    bad = np.flatnonzero(~np.isfinite(table).all(axis=1))
    if bad.size:
        raise TrajectoryError(
            f"command {bad[0]} is {table[bad[0]].tolist()}, which is not finite",
            "cut the recording before it",
        )
    return RecordedCommands(_ordered(np.array(stamps), "command"), table, received=not stamped)


def _read_transforms(reader: AnyReader) -> Transforms:
    found = Transforms()
    connections = [c for c in reader.connections if c.msgtype in TRANSFORMS]
    for connection in connections:
        static = connection.topic.endswith("tf_static")
        for _, message in _messages(reader, [connection]):
            for part in message.transforms:
                shift = part.transform.translation
                found.add(
                    _frame(part.child_frame_id),
                    _frame(part.header.frame_id),
                    _stamp(part.header),
                    (float(shift.x), float(shift.y)),
                    _quaternion(part.transform.rotation),
                    static=static,
                )
    return found


def are_stamped(stamps: Sequence[int] | Indices) -> bool:
    """Tell whether somebody stamped messages: those that nobody did bear the time 0."""
    return bool(len(stamps)) and bool(np.any(np.asarray(stamps) != 0))


def _ordered(stamps: Indices, what: str, before: int = 0) -> Indices:
    """Return stamps, refusing a clock that goes back; so many messages stand before them."""
    back = np.flatnonzero(np.diff(stamps) < 0)
    if back.size:
        row = int(back[0]) + 1
        raise TrajectoryError(
            f"the clock of the {what} messages goes back by {(stamps[row - 1] - stamps[row]) * 1e-9:g} s in "
            f"message {before + row}",
            "record one run without restarting the simulation or setting the clock",
        )
    return stamps
