"""The shapes of one scene as flat arrays: circles, and edges with the side from which they are seen."""

from __future__ import annotations

from collections.abc import Mapping
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
    without : Shapes, optional
        What is there for certain, if the others hold places at which a thing may be or not; None where all is certain.
    """

    centres: Plane
    radii: Floats
    first: Plane
    second: Plane
    scale: float
    without: Shapes | None = None

    def __len__(self) -> int:
        """Return the number of circles and edges."""
        return len(self.radii) + len(self.first)

    @property
    def certain(self) -> Shapes:
        """Return what is there for certain."""
        return self if self.without is None else self.without

    @classmethod
    def of(
        cls, world_map: WorldMap, scenario: Scenario | None, roams: Mapping[str, float] | None = None
    ) -> Shapes:
        """Return the shapes of a map with the obstacles of a scenario.

        Parameters
        ----------
        world_map : WorldMap
            Arena and obstacles.
        scenario : Scenario or None
            Whose obstacles are there as well.
        roams : mapping, optional
            Obstacles of the map, by name, that are somewhere within so many metres of their place: shapes around all of
            these, which `certain` does not hold.
        """
        obstacles, names = world_map.obstacles, world_map.obstacles.names
        own = Obstacles() if scenario is None else scenario.obstacles
        radii = np.array([(roams or {}).get(name, 0.0) if name else 0.0 for name in names])
        if not radii.any():
            return cls._around(world_map.arena, obstacles + own)
        certain = cls._around(world_map.arena, obstacles.select(radii == 0.0) + own)
        count, loose = len(obstacles.circles), radii > 0.0
        circles = obstacles.circles[loose[:count]] + radii[:count][loose[:count], None] * (0.0, 0.0, 1.0)
        parts = [
            _grown(ring, radius)
            for ring, radius in zip(obstacles.polygons, radii[count:], strict=True)
            if radius
        ]
        circles = np.concatenate([circles, *(part[0] for part in parts)])
        first, second = (
            np.concatenate([getattr(certain, name), *(part[1 + end] for part in parts)])
            for end, name in enumerate(("first", "second"))
        )
        extents = [certain.scale - 1.0, np.abs(first).max(), *np.abs(circles).sum(axis=1)]
        return cls(
            np.concatenate([certain.centres, _points(circles)]), np.concatenate([certain.radii, circles[:, 2]]),
            first, second, 1.0 + float(max(extents)), certain,
        )  # fmt: skip

    @classmethod
    def _around(cls, arena: Floats, obstacles: Obstacles) -> Shapes:
        circles = obstacles.circles[obstacles.circles[:, 2] > 0.0]
        rings = [arena, *(polygon[::-1] for polygon in obstacles.polygons), *_grid_rings(obstacles)]
        first = np.concatenate([_points(ring) for ring in rings])
        second = np.concatenate([np.roll(_points(ring), -1) for ring in rings])
        extents = [np.abs(first).max(), *(np.abs(circles).sum(axis=1) if len(circles) else ())]
        return cls(_points(circles), circles[:, 2].copy(), first, second, 1.0 + float(max(extents)))


def _grown(ring: Floats, radius: float) -> tuple[Floats, Plane, Plane]:
    """Return what surrounds all within a radius of a polygon: circles at its corners, and its sides moved outward."""
    corners = _points(ring)
    side = np.roll(corners, -1) - corners
    outward = -1j * radius * side / np.abs(side)
    circles = np.column_stack([ring, np.full(len(ring), radius)])
    return circles, corners + side + outward, corners + outward


def _points(corners: Floats) -> Plane:
    return np.asarray(corners[:, 0] + 1j * corners[:, 1])


def _grid_rings(obstacles: Obstacles) -> list[Floats]:
    """Return the rings around occupied cells, free space to their left."""
    from viatool.world.grid_outline import trace_rings

    grid = obstacles.grid
    if grid is None:
        return []
    return [grid.to_map(ring.astype(np.float64))[::-1] for ring in trace_rings(grid.blocked)]
