"""Markers: what RViz and Foxglove draw of polygons, outlines, arrows and words."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from viatool.arrays import Floats
from viatool.report.foreign import one_line
from viatool.report.playback.messages import RosMessage, header, pose_of, xyz

if TYPE_CHECKING:
    from shapely.geometry.base import BaseGeometry

ARROW, LINES, TEXT, TRIANGLES = 0, 5, 9, 11
_DELETE, _DELETE_ALL = 2, 3
_MARKER, _MARKERS = "visualization_msgs/msg/Marker", "visualization_msgs/msg/MarkerArray"
_LINE, _LETTER = 0.02, 0.15  # metres
_STILL = np.zeros(3)

Marker = dict[str, Any]


def marker(
    kind: int,
    stamp: int,
    name: str,
    number: int,
    colour: str,
    *,
    alpha: float = 1.0,
    points: Floats | None = None,
    pose: Floats = _STILL,
    size: tuple[float, float, float] = (1.0, 1.0, 1.0),
    text: str = "",
) -> Marker:
    """Return a marker in the map.

    Parameters
    ----------
    kind : int
        What it is, a number of ``visualization_msgs/msg/Marker``.
    stamp : int
        Nanoseconds.
    name, number : str, int
        Its namespace and number within it: it takes the place of the one that had both.
    colour : str
        As ``#RRGGBB``.
    alpha : float
        Its opacity.
    points : ndarray, optional
        (P, 2) metres.
    pose : ndarray
        (3,) of its frame.
    size : tuple of float
        Metres along its axes, or as its kind takes them.
    text : str
        Of a text.
    """
    return {
        "header": header(stamp),
        "ns": one_line(name),
        "id": number,
        "type": kind,
        "action": 0,
        "pose": pose_of(pose),
        "scale": xyz(*size),
        "color": _colour(colour, alpha),
        "points": [] if points is None else [xyz(x, y) for x, y in points.tolist()],
        "text": one_line(text),
    }


def filled(
    regions: Iterable[BaseGeometry], stamp: int, name: str, number: int, colour: str, *, alpha: float
) -> Marker:
    """Return convex shapely geometries as one filled marker; one without an area is as wide as a line."""
    wide = (one if one.geom_type == "Polygon" else one.buffer(0.5 * _LINE) for one in regions)
    triangles = [_triangles(np.asarray(region.exterior.coords)[:, :2]) for region in wide]
    points = np.concatenate([np.zeros((0, 2)), *triangles])
    return marker(TRIANGLES, stamp, name, number, colour, alpha=alpha, points=points)


def outlined(rings: Iterable[Floats], stamp: int, name: str, number: int, colour: str) -> Marker:
    """Return closed rings (n, 2), the first corner repeated or not, as lines."""
    edges = [np.stack([ring, np.roll(ring, -1, axis=0)], axis=1).reshape(-1, 2) for ring in rings]
    points = np.concatenate([np.zeros((0, 2)), *edges])
    return marker(LINES, stamp, name, number, colour, points=points, size=(_LINE, 0.0, 0.0))


def words(text: str, stamp: int, name: str, number: int, colour: str, place: Floats) -> Marker:
    """Return a text that faces the viewer, at a place (2,)."""
    pose = np.array([place[0], place[1], 0.0])
    found = marker(TEXT, stamp, name, number, colour, pose=pose, size=(0.0, 0.0, _LETTER), text=text)
    found["pose"]["position"]["z"] = 2.0 * _LETTER
    return found


def removed(stamp: int) -> Marker:
    """Return the marker that removes all others of its topic."""
    return {"header": header(stamp), "pose": pose_of(_STILL), "action": _DELETE_ALL}


def markers(
    stamp: int, topic: str, found: Sequence[Marker], *, afresh: bool = False, lasting: bool = False
) -> RosMessage:
    """Return markers as one message; in place of all before of their topic if they begin afresh."""
    each = [removed(stamp), *found] if afresh else list(found)
    return RosMessage(stamp, topic, _MARKERS, {"markers": each}, lasting)


def single(stamp: int, topic: str, found: Marker) -> RosMessage:
    """Return one marker as a lasting message; one that has nothing to draw is removed."""
    return RosMessage(
        stamp, topic, _MARKER, found if found["points"] else found | {"action": _DELETE}, lasting=True
    )


def circle(centre: Floats | Sequence[float], radius: float) -> Floats:
    """Return the corners (48, 2) of a polygon on a circle, to be drawn."""
    angle = np.linspace(0.0, 2.0 * np.pi, 48, endpoint=False)
    return np.asarray(centre, dtype=np.float64) + radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def _triangles(ring: Floats) -> Floats:
    """Return the triangles of a convex polygon whose first corner is repeated, (3 T, 2)."""
    corners = ring[:-1]
    first = np.broadcast_to(corners[0], (len(corners) - 2, 2))
    return np.stack([first, corners[1:-1], corners[2:]], axis=1).reshape(-1, 2)


def _colour(colour: str, alpha: float) -> dict[str, float]:
    red, green, blue = (int(colour[at : at + 2], 16) / 255.0 for at in (1, 3, 5))
    return {"r": red, "g": green, "b": blue, "a": alpha}
