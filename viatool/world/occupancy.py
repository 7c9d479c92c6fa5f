"""Occupancy grids: maps of square cells, with exact distances, ray casting and outlines of what is blocked.

A grid is measured in its own frame, in which a cell is the unit square [i, i+1] x [j, j+1] of column i and
row j, counted from the lower left. What lies beyond the outermost cells counts as blocked.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from viatool.arrays import Booleans, Floats, Plane, Reals
from viatool.errors import MapError
from viatool.world.grid_casting import free_squares, march_rays
from viatool.world.grid_measurement import RowTables, enclosed_cells, point_distances, segment_distances
from viatool.world.rings import LARGEST, LEAST_EDGE, fit

if TYPE_CHECKING:
    from shapely.geometry.base import BaseGeometry


class Cell(IntEnum):
    """What a cell holds."""

    FREE = 0
    OCCUPIED = 1
    UNKNOWN = 2


@dataclass(frozen=True, eq=False)
class OccupancyGrid:
    """Square cells that are free, occupied or unknown.

    Parameters
    ----------
    cells : ndarray
        (rows, columns) uint8 of `Cell`; row 0 is the lowest.
    resolution : float
        Side of a cell, in metres.
    origin : tuple of float
        Pose x, y, yaw of the lower left corner of the lower left cell; metres and radians.
    unknown_is_free : bool
        Whether unknown cells count as free; by default they are obstacles.

    Raises
    ------
    MapError
        If there is no cell, the side of a cell is not a length above 0, or the origin is not finite.
    """

    cells: NDArray[np.uint8]
    resolution: float
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    unknown_is_free: bool = False

    def __post_init__(self) -> None:
        if self.cells.ndim != 2 or not self.cells.size:
            raise MapError(
                f"occupancy grid has cells of shape {self.cells.shape}, expected (rows, columns)",
                "give some cells",
            )
        if not (self.resolution > LEAST_EDGE and fit(self.resolution)):
            raise MapError(
                f"occupancy grid has cells of {self.resolution} m, expected a length above 0",
                "correct the resolution",
            )
        if not fit(self.origin).all():
            raise MapError(
                f"occupancy grid has the origin {self.origin}, expected finite numbers of at most {LARGEST:g}",
                "correct the origin",
            )

    @cached_property
    def blocked(self) -> Booleans:
        """Which cells are obstacles, (rows, columns)."""
        if self.unknown_is_free:
            return np.asarray(self.cells == Cell.OCCUPIED)
        return np.asarray(self.cells != Cell.FREE)

    @property
    def outline(self) -> Floats:
        """Return the corners of the whole grid, (4, 2) counter-clockwise, in metres."""
        rows, columns = self.cells.shape
        return self.to_map(np.array([[0, 0], [columns, 0], [columns, rows], [0, rows]], dtype=np.float64))

    @property
    def free_area(self) -> tuple[float, float, float, float] | None:
        """Smallest x, y and largest x, y of the free cells, in metres; None if there is none."""
        rows, columns = (np.flatnonzero(~self.blocked.all(axis=axis)) for axis in (1, 0))
        if not len(rows):
            return None
        (left, right), (low, high) = (columns[[0, -1]] + [0, 1]), (rows[[0, -1]] + [0, 1])
        corners = self.to_map(np.array([[left, low], [right, low], [right, high], [left, high]], float))
        (x_min, y_min), (x_max, y_max) = corners.min(axis=0), corners.max(axis=0)
        return float(x_min), float(y_min), float(x_max), float(y_max)

    def share(self, kind: Cell) -> float:
        """Return the share of the cells that are of a kind, in [0, 1]."""
        return float(np.count_nonzero(self.cells == kind)) / self.cells.size

    def to_map(self, points: Floats) -> Floats:
        """Return points (..., 2) of the grid's frame in the map frame, in metres."""
        x, y, yaw = self.origin
        turned = (points[..., 0] + 1j * points[..., 1]) * (self.resolution * _direction(yaw))
        return np.stack([x + turned.real, y + turned.imag], axis=-1)

    def clearance(self, points: Plane) -> Floats:
        """Return the exact distance from points (B,) of the map frame to what is blocked, in metres."""
        return self.resolution * point_distances(self._to_grid(points), self._tables)

    def segment_clearance(self, starts: Plane, ends: Plane) -> Floats:
        """Return the exact distance from segments (B,) of the map frame to what is blocked, in metres."""
        first, second = self._to_grid(starts), self._to_grid(ends)
        return self.resolution * segment_distances(first, second, self._tables)

    def encloses(self, corners: Plane) -> Booleans:
        """Tell which outlines, (n, B) in the map frame, surround the middle of a blocked cell."""
        return enclosed_cells(self._to_grid(corners), self._counts)

    def cast(self, places: Plane, headings: Floats, directions: Reals, limit: float) -> Floats:
        """Return the distance at which each ray first meets something blocked.

        Parameters
        ----------
        places : ndarray
            (B,) origins of the ray fans, in the map frame.
        headings : ndarray
            (B,) radians.
        directions : ndarray
            (2, R) unit vectors of the rays in the fan's frame.
        limit : float
            Range of a ray that meets nothing nearer, in metres.

        Returns
        -------
        ndarray
            (B, R) metres; 0 for a fan within something blocked.
        """
        unit = directions[0].astype(np.float64) + 1j * directions[1]
        rays = np.exp(1j * (headings - self.origin[2]))[:, None] * unit
        places = np.repeat(self._to_grid(places), rays.shape[1])
        ranges = march_rays(places, rays.ravel(), self._free_squares, limit / self.resolution)
        return np.minimum(self.resolution * ranges, limit).reshape(rays.shape)

    def polygons(self) -> BaseGeometry:
        """Return what is blocked as closed polygons with holes, exact at the edges of the cells."""
        import shapely

        from viatool.world.grid_outline import blocked_polygons

        traced = blocked_polygons(self.blocked)
        return shapely.transform(shapely.MultiPolygon(traced), self.to_map)

    def _to_grid(self, points: Plane) -> Plane:
        x, y, yaw = self.origin
        away = (points - (x + 1j * y)) / self.resolution
        return away if yaw == 0.0 else away * np.conj(_direction(yaw))

    @cached_property
    def _tables(self) -> RowTables:
        return RowTables.of(self.blocked)

    @cached_property
    def _counts(self) -> NDArray[np.int32]:
        counts = np.zeros((self.blocked.shape[0], self.blocked.shape[1] + 1), np.int32)
        np.cumsum(self.blocked, axis=1, out=counts[:, 1:])
        return counts

    @cached_property
    def _free_squares(self) -> NDArray[np.uint8]:
        return free_squares(self.blocked)


def _direction(yaw: float) -> complex:
    """Return the unit vector of a heading; exact for no turn."""
    return complex(np.cos(yaw), np.sin(yaw))
