"""Recordings that viatool wrote, read back by rosbags."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import to_rgb
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from viatool.report.outputs import Output, write_outputs

DELETE_ALL, TRIANGLES, LINES = 3, 11, 5


@dataclass
class Played:
    """One message with the nanoseconds at which it is played, and its type."""

    at: int
    type: str
    message: Any


def play(document: Any, path: Path) -> dict[str, list[Played]]:
    """Write a document as a recording, and return its messages by topic."""
    write_outputs(document, [Output("mcap", path)])
    return read(path)


def read(path: Path) -> dict[str, list[Played]]:
    """Return the messages of a recording by topic, and all in their order under the empty name."""
    found: dict[str, list[Played]] = defaultdict(list)
    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        for connection, at, raw in reader.messages():
            one = Played(at, connection.msgtype, reader.deserialize(raw, connection.msgtype))
            found[connection.topic].append(one)
            found[""].append(one)
    return found


def drawn(played: list[Played]) -> list[tuple[int, Any]]:
    """Return when each marker that is drawn is played, and the marker."""
    return [
        (one.at, marker) for one in played for marker in one.message.markers if marker.action != DELETE_ALL
    ]


def stamp(header: Any) -> int:
    return header.stamp.sec * 10**9 + header.stamp.nanosec


def heading(rotation: Any) -> float:
    return 2.0 * float(np.arctan2(rotation.z, rotation.w))


def pose(given: Any) -> list[float]:
    return [given.position.x, given.position.y, heading(given.orientation)]


def has_colour(marker: Any, colour: str) -> bool:
    return np.allclose([marker.color.r, marker.color.g, marker.color.b], to_rgb(colour), atol=1e-6)


def holds(marker: Any, place: Any) -> bool:
    """Tell whether a place (2,) is in one of a marker's triangles, or on its edge."""
    points = np.array([(point.x, point.y) for point in marker.points]).reshape(-1, 3, 2)
    edges = np.roll(points, -1, axis=1) - points
    away = np.asarray(place) - points
    side = edges[..., 0] * away[..., 1] - edges[..., 1] * away[..., 0]
    return bool(((side >= -1e-9).all(axis=1) | (side <= 1e-9).all(axis=1)).any())


def lines(marker: Any) -> np.ndarray:
    """Return the ends of a marker's lines, (L, 2, 2)."""
    return np.array([(point.x, point.y) for point in marker.points]).reshape(-1, 2, 2)


def cell(grid: Any, x: float, y: float) -> int:
    """Return what a map without yaw says of a place."""
    info = grid.info
    column = int((x - info.origin.position.x) // info.resolution)
    row = int((y - info.origin.position.y) // info.resolution)
    return int(np.asarray(grid.data).reshape(info.height, info.width)[row, column])
