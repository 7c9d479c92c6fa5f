"""Obstacles as exact shapes: circles and simple polygons; boxes and walls are polygons."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from viatool.arrays import Booleans, Floats
from viatool.errors import MapError
from viatool.world.rings import (
    LARGEST,
    centroid,
    finite_points,
    fit,
    ring_edges,
    ring_width,
    simple_polygon,
    without_repeats,
)

if TYPE_CHECKING:
    from viatool.world.occupancy import OccupancyGrid

_AS_WIDE = 1.0 + 1e-9
"""So that an obstacle is thin which is as wide as may be passed, whatever is rounded."""


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
        (n, 2) corners of simple polygons; kept counter-clockwise, without repeated corners.
    grid : OccupancyGrid, optional
        Square cells, of which those that are not free are obstacles.
    names : tuple of str, optional
        What the circles, and after them the polygons, are called; empty where nobody named one.

    Raises
    ------
    MapError
        If a circle has no radius, a number is not finite, or a polygon is not simple.
    """

    circles: Floats = field(default_factory=_no_circles)
    polygons: tuple[Floats, ...] = ()
    grid: OccupancyGrid | None = None
    names: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "circles", _checked_circles(self.circles))
        polygons = (simple_polygon(ring, f"polygon {index}") for index, ring in enumerate(self.polygons))
        object.__setattr__(self, "polygons", tuple(polygons))
        if not self.names:
            object.__setattr__(self, "names", ("",) * len(self))
        elif len(self.names) != len(self):
            raise ValueError(f"{len(self.names)} names for {len(self)} shapes")

    def __len__(self) -> int:
        """Return the number of shapes, without the cells of a grid."""
        return len(self.circles) + len(self.polygons)

    def __add__(self, other: Obstacles) -> Obstacles:
        """Return both sets together; only one of them may have a grid."""
        if self.grid is not None and other.grid is not None:
            raise ValueError("both sets of obstacles have a grid")
        return replace(Obstacles.together([self, other]), grid=self.grid or other.grid)

    def select(self, which: Booleans) -> Obstacles:
        """Return some of the shapes, (len,) bool, with the grid."""
        rounds, others = np.split(np.asarray(which, dtype=bool), [len(self.circles)])
        rings = tuple(ring for ring, taken in zip(self.polygons, others, strict=True) if taken)
        names = tuple(name for name, taken in zip(self.names, which, strict=True) if taken)
        return Obstacles(self.circles[rounds], rings, self.grid, names)

    @classmethod
    def together(cls, parts: Sequence[Obstacles]) -> Obstacles:
        """Return the shapes of several sets as one, without grids."""
        circles = np.concatenate([_no_circles(), *(part.circles for part in parts)])
        rounds = (name for part in parts for name in part.names[: len(part.circles)])
        others = (name for part in parts for name in part.names[len(part.circles) :])
        rings = tuple(ring for part in parts for ring in part.polygons)
        return cls(circles, rings, names=(*rounds, *others))

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

    def widths(self) -> Floats:
        """Return how wide the circles, and after them the polygons, are from their narrowest side, (shapes,) metres."""
        return np.concatenate(
            [2.0 * self.circles[:, 2], np.array([ring_width(ring) for ring in self.polygons])]
        )

    def without_thin(self, thin: float) -> Obstacles:
        """Return what is left of the obstacles for rays that pass those that are thin."""
        return self.select(~passed_by(self.widths(), thin)) if thin > 0.0 else self


def passed_by(widths: Floats, thin: float) -> Booleans:
    """Tell which obstacles of (N,) widths a ray may pass that passes thin ones; none where that is 0."""
    return np.asarray((widths <= thin * _AS_WIDE) & (thin > 0.0))


def _checked_circles(circles: ArrayLike) -> Floats:
    """Return circles (K, 3), refusing by name any that are not circles."""
    given = np.asarray(circles, dtype=np.float64).reshape(-1, 3)
    wrong = np.flatnonzero(~(fit(given).all(axis=1) & (given[:, 2] > 0.0)))
    if wrong.size:
        x, y, radius = given[wrong[0]].tolist()
        raise MapError(
            f"circle {wrong[0]} has the centre ({x:g}, {y:g}) and the radius {radius:g} m, expected finite numbers of "
            f"at most {LARGEST:g} m and a radius above 0",
            "correct the circle, or leave it out",
        )
    return given


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
        boxes of a bent wall leave no notch at the bends. A corner that repeats the one before it is dropped.

    Raises
    ------
    MapError
        If the wall has no length or a number is not finite.
    """
    corner = without_repeats(finite_points(points, "wall"), closed=False)
    if len(corner) < 2:
        raise MapError("wall has no length: all of its corners coincide", "move its corners apart")
    boxes = []
    for first, second in pairwise(corner):
        dx, dy = second - first
        length = float(np.hypot(dx, dy))
        boxes.append(box_polygon(0.5 * (first + second), (length + thickness, thickness), np.arctan2(dy, dx)))
    return tuple(boxes)
