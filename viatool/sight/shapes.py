"""The shapes of one scene as flat arrays: circles, and edges with the side from which they are seen."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from viatool.arrays import Booleans, Floats, Plane
from viatool.world import Obstacles, Scenario, WorldMap
from viatool.world.shapes import passed_by


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
    widths : tuple of ndarray
        (K,) and (M,) of the obstacles that they are parts of, in metres; infinite where no ray passes them.
    without : Shapes, optional
        What is there for certain, if the others hold places at which a thing may be or not; None where all is certain.
    thin : float
        The widest obstacle that a ray may pass without seeing it, in metres.
    """

    centres: Plane
    radii: Floats
    first: Plane
    second: Plane
    scale: float
    widths: tuple[Floats, Floats]
    without: Shapes | None = None
    thin: float = 0.0

    def __len__(self) -> int:
        """Return the number of circles and edges."""
        return len(self.radii) + len(self.first)

    @property
    def certain(self) -> Shapes:
        """Return what is there for certain."""
        return self if self.without is None else self.without

    @classmethod
    def of(
        cls,
        world_map: WorldMap,
        scenario: Scenario | None,
        roams: Mapping[str, float] | None = None,
        *,
        measured: bool = False,
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
        measured : bool
            Whether widths are measured, as those count that rays may pass.
        """
        obstacles, names = world_map.obstacles, world_map.obstacles.names
        own = Obstacles() if scenario is None else scenario.obstacles
        radii = np.array([(roams or {}).get(name, 0.0) if name else 0.0 for name in names])
        if not radii.any():
            return cls._around(world_map.arena, obstacles + own, measured)
        certain = cls._around(world_map.arena, obstacles.select(radii == 0.0) + own, measured)
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
        sizes = len(circles), len(first) - len(certain.first)
        wide = [
            np.concatenate([known, np.full(size, np.inf)])
            for known, size in zip(certain.widths, sizes, strict=True)
        ]
        return cls(
            np.concatenate([certain.centres, _points(circles)]), np.concatenate([certain.radii, circles[:, 2]]),
            first, second, 1.0 + float(max(extents)), (wide[0], wide[1]), certain,
        )  # fmt: skip

    @classmethod
    def _around(cls, arena: Floats, obstacles: Obstacles, measured: bool) -> Shapes:
        circles, cells = obstacles.circles, _grid_rings(obstacles)
        rings = [arena, *(polygon[::-1] for polygon in obstacles.polygons), *cells]
        widths = obstacles.widths() if measured else np.full(len(obstacles), np.inf)
        around = [np.inf, *widths[len(circles) :].tolist(), *(np.inf for _ in cells)]
        first = np.concatenate([_points(ring) for ring in rings])
        second = np.concatenate([np.roll(_points(ring), -1) for ring in rings])
        extents = [np.abs(first).max(), *(np.abs(circles).sum(axis=1) if len(circles) else ())]
        sides = np.repeat(around, [len(ring) for ring in rings])
        return cls(
            _points(circles),
            circles[:, 2].copy(),
            first,
            second,
            1.0 + float(max(extents)),
            (widths[: len(circles)], sides),
        )

    @classmethod
    def nothing(cls, scale: float) -> Shapes:
        """Return no shapes, on a map whose coordinates are below a scale."""
        none, lengths = np.zeros(0, dtype=complex), np.zeros(0)
        return cls(none, lengths, none, none, scale, (lengths, lengths))

    def passing(self, thin: float) -> Shapes:
        """Return the same as rays see them that may pass obstacles of a width without seeing them."""
        without = None if self.without is None else self.without.passing(thin)
        return replace(self, thin=thin, without=without)

    @property
    def passed(self) -> tuple[Booleans, Booleans]:
        """Tell which circles (K,) and which edges (M,) a ray may pass."""
        circles, edges = (passed_by(widths, self.thin) for widths in self.widths)
        return circles, edges


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
