"""Obstacles as exact shapes: circles and simple polygons; boxes and walls are polygons."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from viatool.arrays import Floats
from viatool.errors import MapError

if TYPE_CHECKING:
    from viatool.world.occupancy import OccupancyGrid


def _no_circles() -> Floats:
    return np.zeros((0, 3))


@dataclass(frozen=True, eq=False)
class Obstacles:
    """A set of obstacles; shapes may overlap.

    Parameters
    ----------
    circles : ndarray
        (K, 3) x, y, radius in metres.
    polygons : tuple of ndarray
        (n, 2) corners of simple polygons, counter-clockwise, the first corner not repeated.
    grid : OccupancyGrid, optional
        Square cells, of which those that are not free are obstacles.
    """

    circles: Floats = field(default_factory=_no_circles)
    polygons: tuple[Floats, ...] = ()
    grid: OccupancyGrid | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "circles", np.asarray(self.circles, dtype=np.float64).reshape(-1, 3))
        polygons = tuple(np.asarray(polygon, dtype=np.float64) for polygon in self.polygons)
        object.__setattr__(self, "polygons", polygons)

    def __len__(self) -> int:
        """Return the number of shapes, without the cells of a grid."""
        return len(self.circles) + len(self.polygons)

    def __add__(self, other: Obstacles) -> Obstacles:
        """Return both sets together; only one of them may have a grid."""
        if self.grid is not None and other.grid is not None:
            raise ValueError("both sets of obstacles have a grid")
        circles = np.concatenate([self.circles, other.circles])
        return Obstacles(circles, self.polygons + other.polygons, self.grid or other.grid)

    def edges(self) -> Floats:
        """Return the edges of all polygons.

        Returns
        -------
        ndarray
            (M, 4) x, y of the first end, x, y of the second; the inside of a polygon lies to their left.
        """
        return np.concatenate([np.zeros((0, 4)), *(ring_edges(polygon) for polygon in self.polygons)])

    def centres(self) -> Floats:
        """Return the centres of the circles and the centroids of the polygons, (K + polygons, 2)."""
        return np.concatenate([self.circles[:, :2], *(centroid(polygon)[None] for polygon in self.polygons)])


def ring_edges(ring: Floats) -> Floats:
    """Return the edges of one closed ring of n corners, (n, 4)."""
    return np.concatenate([ring, np.roll(ring, -1, axis=0)], axis=1)


def signed_area(ring: Floats) -> float:
    """Return the area of a ring in m^2, positive when its corners run counter-clockwise."""
    x, y = (ring - ring.mean(axis=0)).T
    return float(0.5 * np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


def centroid(ring: Floats) -> Floats:
    """Return the centre of area of a simple ring, (2,)."""
    origin = ring.mean(axis=0)
    first = ring - origin
    second = np.roll(first, -1, axis=0)
    cross = first[:, 0] * second[:, 1] - second[:, 0] * first[:, 1]
    return np.asarray(origin + ((first + second) * cross[:, None]).sum(axis=0) / (3.0 * cross.sum()))


def is_convex(ring: Floats) -> bool:
    """Tell whether a simple counter-clockwise ring is convex; straight corners are allowed."""
    along = np.roll(ring, -1, axis=0) - ring
    turn = along[:, 0] * np.roll(along[:, 1], -1) - along[:, 1] * np.roll(along[:, 0], -1)
    return bool(np.all(turn >= 0.0))


def box_polygon(center: ArrayLike, size: ArrayLike, yaw: ArrayLike = 0.0) -> Floats:
    """Return the corners of yawed boxes.

    Parameters
    ----------
    center : array_like
        (..., 2) in metres.
    size : array_like
        (..., 2) lengths along the box's own x and y, in metres.
    yaw : array_like
        (...) counter-clockwise, in radians.

    Returns
    -------
    ndarray
        (..., 4, 2), counter-clockwise.
    """
    middle, half = np.asarray(center, dtype=np.float64), 0.5 * np.asarray(size, dtype=np.float64)
    corner = half[..., None, :] * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    cosine, sine = np.cos(yaw)[..., None], np.sin(yaw)[..., None]
    x = cosine * corner[..., 0] - sine * corner[..., 1]
    y = sine * corner[..., 0] + cosine * corner[..., 1]
    return np.asarray(middle[..., None, :] + np.stack([x, y], axis=-1))


def wall_polygons(points: ArrayLike, thickness: float) -> tuple[Floats, ...]:
    """Return one box for each segment of a polyline.

    Parameters
    ----------
    points : array_like
        (n, 2) corners of the wall's middle line, n at least 2, in metres.
    thickness : float
        Full width of the wall in metres. Every segment is longer by half of it at both ends, so that the
        boxes of a bent wall leave no notch at the bends.
    """
    corner = np.asarray(points, dtype=np.float64)
    boxes = []
    for first, second in pairwise(corner):
        dx, dy = second - first
        length = float(np.hypot(dx, dy))
        boxes.append(box_polygon(0.5 * (first + second), (length + thickness, thickness), np.arctan2(dy, dx)))
    return tuple(boxes)


def simple_polygon(points: Sequence[Sequence[float]] | Floats, name: str = "polygon") -> Floats:
    """Return corners as a simple counter-clockwise ring.

    Parameters
    ----------
    points : array_like
        (n, 2) corners in metres, in either direction; a repeated first corner at the end is dropped.
    name : str
        What to call the polygon in an error.

    Raises
    ------
    MapError
        If it has fewer than three corners or no area, or crosses or touches itself.
    """
    from shapely import Polygon, is_valid_reason

    ring = np.asarray(points, dtype=np.float64)
    if len(ring) > 1 and np.array_equal(ring[0], ring[-1]):
        ring = ring[:-1]
    if len(ring) < 3:
        raise MapError(f"{name} has {len(ring)} distinct corners, expected at least 3", "add the corners")
    outline = Polygon(ring)
    if not outline.is_valid:
        reason = str(is_valid_reason(outline)).replace("[", " at (").replace("]", ")").replace(" )", ")")
        raise MapError(
            f"{name} is not a simple polygon: {reason}",
            "list the corners once around the outline, without crossing it",
        )
    if outline.area <= 0.0:
        raise MapError(f"{name} has no area", "move its corners apart")
    return ring if signed_area(ring) > 0.0 else ring[::-1].copy()
