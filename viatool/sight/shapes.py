"""The shapes of one scene as flat arrays: circles, and edges with the side from which they are seen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from viatool.arrays import Floats, Plane
from viatool.world import Obstacles, Scenario, WorldMap


@dataclass(frozen=True, eq=False)
class Shapes:
    """Everything that a robot in one scene can see or run into.

    Parameters
    ----------
    centres, radii : ndarray
        (K,) of circles; points x + iy in metres.
    first, second : ndarray
        (M,) both ends of edges, the visible side to their left: walls of the arena, sides of polygons, and the
        outline of occupied cells.
    scale : float
        A bound of every coordinate and radius, in metres, at least 1.
    """

    centres: Plane
    radii: Floats
    first: Plane
    second: Plane
    scale: float

    def __len__(self) -> int:
        """Return the number of circles and edges."""
        return len(self.radii) + len(self.first)

    @classmethod
    def of(cls, world_map: WorldMap, scenario: Scenario | None) -> Shapes:
        """Return the shapes of a map with the obstacles of a scenario."""
        obstacles = world_map.obstacles + (Obstacles() if scenario is None else scenario.obstacles)
        circles = obstacles.circles[obstacles.circles[:, 2] > 0.0]
        rings = [world_map.arena, *(polygon[::-1] for polygon in obstacles.polygons), *_grid_rings(obstacles)]
        first = np.concatenate([_points(ring) for ring in rings])
        second = np.concatenate([np.roll(_points(ring), -1) for ring in rings])
        extents = [np.abs(first).max(), *(np.abs(circles).sum(axis=1) if len(circles) else ())]
        return cls(_points(circles), circles[:, 2].copy(), first, second, 1.0 + float(max(extents)))


def _points(corners: Floats) -> Plane:
    return np.asarray(corners[:, 0] + 1j * corners[:, 1])


def _grid_rings(obstacles: Obstacles) -> list[Floats]:
    """Return the rings around occupied cells, free space to their left."""
    from viatool.world.grid_outline import trace_rings

    grid = obstacles.grid
    if grid is None:
        return []
    return [grid.to_map(ring.astype(np.float64))[::-1] for ring in trace_rings(grid.blocked)]
