"""The geometry of many scenes at once: each has the map's obstacles and its own."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from viatool.arrays import Booleans, Floats, Indices, Plane, Reals
from viatool.world.casting import Surroundings, cast_rays
from viatool.world.lidar import Lidar
from viatool.world.measurement import (
    as_plane,
    dot,
    point_edge_squared,
    segment_edge_squared,
    winding_number,
)
from viatool.world.region import blocked_region
from viatool.world.rings import is_convex
from viatool.world.robot import Footprint
from viatool.world.scenario import Scenario
from viatool.world.shapes import Obstacles

if TYPE_CHECKING:
    from shapely.geometry.base import BaseGeometry

    from viatool.world.world_map import WorldMap


# Points x shapes (x rays) that are measured at once: memory stays flat, and the arrays stay in the cache.
_CHUNK = 160_000
# Of so many edges about one is seen: the others face away, or are behind the LiDAR or too far off.
_EDGES_SEEN = 6
# What fills the arrays of a scene that has fewer shapes than another: too far away to be near or seen.
_NO_CIRCLE = (1e9, 1e9, 0.0)
_NO_EDGE = (1e9, 1e9, 1e9, 1e9)
# The shapes of their own of one scene that has none.
NO_CIRCLES: Floats = np.zeros((1, 0, 3))
NO_EDGES: Floats = np.zeros((1, 0, 4))


@dataclass(frozen=True, eq=False)
class FlatScenes:
    """The same as plain numbers, in metres.

    Parameters
    ----------
    circles, edges : ndarray
        (S, K, 3) x, y, radius, and (S, M, 4) both ends, the inside to the left.
    walls : ndarray
        (n, 4) both ends of the arena's, the inside to the left.
    normals : ndarray
        (n, 3) of a convex arena: outward, and how far outward the wall is.
    convex : bool
        Whether the arena is.
    """

    circles: Floats
    edges: Floats
    walls: Floats
    normals: Floats
    convex: bool


class Scenes:
    """Obstacles and arena of S scenes, for batches of points and ray fans.

    Parameters
    ----------
    arena : ndarray
        (n, 2) corners of the arena, counter-clockwise, in metres.
    shared : Obstacles
        What all scenes have.
    circles : ndarray
        (S, K, 3) x, y, radius of each scene's own circles, in metres.
    edges : ndarray
        (S, M, 4) edges of each scene's own polygons, their inside to the left; in metres.

    Notes
    -----
    Methods take B points with the index of the scene that each belongs to. Costs grow with B times the
    number of shapes, which suits up to some hundred edges; a grid of cells is its own index, so its size does
    not matter. A point or a pose that is not finite counts as contact: whatever is not a number becomes a distance of
    0 (`np.fmax` ignores NaN, `np.minimum` passes it on).
    """

    def __init__(self, arena: Floats, shared: Obstacles, circles: Floats, edges: Floats) -> None:
        corners = as_plane(arena)[:, None]
        self._arena = corners, np.roll(corners, -1, axis=0)  # (n, 1) both ends of its edges
        self._convex = is_convex(arena)
        along = self._arena[1] - corners
        self._normals = -1j * along / np.abs(along)
        self._offsets = dot(self._normals, corners)
        rounds = np.broadcast_to(shared.circles, (len(circles), *shared.circles.shape))
        sides = np.broadcast_to(shared.edges(), (len(edges), *shared.edges().shape))
        rounds, sides = np.concatenate([rounds, circles], axis=1).T, np.concatenate([sides, edges], axis=1).T
        self._centres: Plane = rounds[0] + 1j * rounds[1]  # (K, S)
        self._radii: Floats = rounds[2].copy()
        self._first: Plane = sides[0] + 1j * sides[1]  # (M, S)
        self._second: Plane = sides[2] + 1j * sides[3]
        self._own = len(shared.circles), shared.edges().shape[0]
        self._grid = shared.grid

    @classmethod
    def of(cls, world_map: WorldMap, scenarios: Sequence[Scenario | None]) -> Scenes:
        """Return the scenes of scenarios; None is the map with nothing added."""
        return cls.around(world_map, own_of(scenarios))

    @classmethod
    def around(cls, world_map: WorldMap, own: Sequence[Obstacles], thin: float = 0.0) -> Scenes:
        """Return scenes with obstacles of their own, as rays meet them that pass all obstacles of a width."""
        own = [obstacles.without_thin(thin) for obstacles in own]
        circles = _pad([obstacles.circles for obstacles in own], _NO_CIRCLE)
        edges = _pad([obstacles.edges() for obstacles in own], _NO_EDGE)
        return cls(world_map.arena, world_map.obstacles.without_thin(thin), circles, edges)

    def __len__(self) -> int:
        """Return the number of scenes."""
        return int(self._centres.shape[1])

    def replace(self, which: Indices, circles: Floats, edges: Floats) -> None:
        """Give some scenes other obstacles of their own, in place.

        Parameters
        ----------
        which : ndarray
            (W,) indices of the scenes.
        circles, edges : ndarray
            (W, k, 3) and (W, m, 4), as many as the scenes were made for.
        """
        rounds, sides = circles.T, edges.T
        self._centres[self._own[0] :, which] = rounds[0] + 1j * rounds[1]
        self._radii[self._own[0] :, which] = rounds[2]
        if edges.shape[1]:
            self._first[self._own[1] :, which] = sides[0] + 1j * sides[1]
            self._second[self._own[1] :, which] = sides[2] + 1j * sides[3]

    @property
    def flat(self) -> FlatScenes | None:
        """Return all shapes as plain numbers; None where there is a grid."""
        if self._grid is not None:
            return None
        first, second = (end[:, 0] for end in self._arena)
        return FlatScenes(
            np.stack([self._centres.real, self._centres.imag, self._radii], axis=-1).swapaxes(0, 1),
            np.stack(
                [self._first.real, self._first.imag, self._second.real, self._second.imag], axis=-1
            ).swapaxes(0, 1),
            np.column_stack([first.real, first.imag, second.real, second.imag]),
            np.column_stack([self._normals.real, self._normals.imag, self._offsets]),
            self._convex,
        )

    def cast(
        self,
        poses: Floats,
        scene: Indices,
        lidar: Lidar,
        *,
        directions: Reals | None = None,
        dtype: type = np.float64,
    ) -> Reals:
        """Return what a perfect LiDAR without a minimum range would read.

        Parameters
        ----------
        poses : ndarray
            (B, 3) x, y, theta of the LiDAR; metres and radians.
        scene : ndarray
            (B,) indices of the scenes.
        lidar : Lidar
            Directions of the rays and maximum range.
        directions : ndarray, optional
            (2, R) unit vectors of other rays than the LiDAR's, in the robot's frame; `dtype` is then theirs.
        dtype : type
            np.float64, or np.float32 for twice the speed at an error of about 1e-6 of the range (up to 1e-3
            of it for a ray that grazes a circle).

        Returns
        -------
        ndarray
            (B, R) metres: `lidar.maximum_range` where nothing is nearer, 0 everywhere for a LiDAR inside an
            obstacle or outside the arena.
        """
        rays = lidar.directions().astype(dtype) if directions is None else directions

        def measure(place: Plane, heading: Floats, index: Indices) -> Reals:
            around = self._surroundings(index)
            ranges = cast_rays(place, heading, around, rays, lidar.maximum_range)
            if len(self._first):  # seen from their right, hence the other direction
                count = len(self._first)
                ranges[winding_number(place, around.second[:count], around.first[:count]) > 0] = 0.0
            if not self._convex:
                ranges[winding_number(place, *self._arena) == 0] = 0.0
            if self._grid is not None:
                met = self._grid.cast(place, heading, rays, lidar.maximum_range)
                np.minimum(ranges, met.astype(ranges.dtype), out=ranges)
            ranges[~(np.isfinite(place) & np.isfinite(heading))] = 0.0
            return ranges

        places = as_plane(poses)
        ranges: Reals = self._in_chunks(measure, scene, places, poses[:, 2], rays=rays.shape[1])
        return ranges

    def _surroundings(self, scene: Indices) -> Surroundings:
        """Return the shapes around B ray fans."""
        centres, radii = self._centres.take(scene, axis=1), self._radii.take(scene, axis=1)
        # Obstacles are seen from their right, the arena's walls from their left.
        first, second = self._second.take(scene, axis=1), self._first.take(scene, axis=1)
        if self._convex:
            return Surroundings(centres, radii, first, second, self._normals, self._offsets)
        walls = (np.broadcast_to(ends, (len(ends), len(scene))) for ends in self._arena)
        first, second = (np.concatenate(pair) for pair in zip((first, second), walls, strict=True))
        return Surroundings(centres, radii, first, second, self._normals[:0], self._offsets[:0])

    def blocked(self, points: Floats, scene: Indices) -> Booleans:
        """Tell which points (B, 2) lie inside an obstacle or outside the arena."""
        inside: Booleans = self._in_chunks(self._blocked, scene, as_plane(points))
        return inside

    def clearance(self, points: Floats, scene: Indices) -> Floats:
        """Return the distance from points to the nearest obstacle or wall of the arena.

        Parameters
        ----------
        points : ndarray
            (B, 2) metres.
        scene : ndarray
            (B,) indices of the scenes.

        Returns
        -------
        ndarray
            (B,) metres; 0 inside an obstacle and outside the arena.

        Notes
        -----
        Sound: under rounding only (float64 to nearest). Cost: O(B (K + M)).
        """
        distances: Floats = self._in_chunks(self._clearance, scene, as_plane(points))
        return distances

    def farthest_within(self, corners: Floats, scene: Indices) -> Floats:
        """Return how far the hulls of points are at most from the one obstacle or wall that is nearest to all of them.

        Parameters
        ----------
        corners : ndarray
            (B, K, 2) metres.
        scene : ndarray
            (B,) indices of the scenes.

        Returns
        -------
        ndarray
            (B,) metres, infinite where there is none: no point of the hull is farther from every obstacle and wall.
            Cells of a grid do not count.

        Notes
        -----
        Sound: under rounding only. Circles, edges and what is behind a wall are convex, so the distance from one is a
        convex function, which is largest at a corner.
        """

        def measure(points: Plane, index: Indices) -> Floats:
            each = index[:, None]
            away = [np.abs(self._centres[:, each] - points) - self._radii[:, each]]  # (N, B, K)
            away.append(np.sqrt(point_edge_squared(points, self._first[:, each], self._second[:, each])))
            if self._convex:
                away.append(self._offsets[..., None] - dot(self._normals[..., None], points))
            else:
                first, second = (end[..., None] for end in self._arena)
                away.append(np.sqrt(point_edge_squared(points, first, second)))
            return np.asarray(np.maximum(np.concatenate(away).max(axis=2).min(axis=0), 0.0))

        found: Floats = self._in_chunks(measure, scene, as_plane(corners), rays=corners.shape[1])
        return found

    def segment_clearance(self, starts: Floats, ends: Floats, scene: Indices) -> Floats:
        """Return the smallest distance from any point of segments to an obstacle or wall of the arena.

        Parameters
        ----------
        starts, ends : ndarray
            (B, 2) metres.
        scene : ndarray
            (B,) indices of the scenes.

        Returns
        -------
        ndarray
            (B,) metres; 0 where a segment touches or lies inside an obstacle, or leaves the arena.

        Notes
        -----
        Sound: under rounding only (float64 to nearest). Cost: O(B (K + M)).
        """
        distances: Floats = self._in_chunks(self._segment_clearance, scene, as_plane(starts), as_plane(ends))
        return distances

    def footprint_clearance(self, poses: Floats, footprint: Footprint, scene: Indices) -> Floats:
        """Return the distance from the robot's outline to the nearest obstacle or wall of the arena.

        Parameters
        ----------
        poses : ndarray
            (B, 3) x, y, theta; metres and radians.
        footprint : Footprint
            Outline in the robot's frame; its whole area counts.
        scene : ndarray
            (B,) indices of the scenes.

        Returns
        -------
        ndarray
            (B,) metres; 0 where the footprint touches an obstacle or leaves the arena.
        """
        if footprint.kind != "polygon":
            return np.fmax(self.clearance(poses[:, :2], scene) - footprint.radius, 0.0)

        def measure(place: Floats, index: Indices) -> Floats:
            return self._polygon_clearance(place, footprint.polygon, index)

        distances: Floats = self._in_chunks(measure, scene, poses)
        return distances

    def shapely(self, scene_index: int, *, margin: float = 1.0) -> BaseGeometry:
        """Return everything that is not free, for drawing and as an oracle.

        Parameters
        ----------
        scene_index : int
            Which scene.
        margin : float
            How far the region outside of the arena extends beyond the arena's bounds, in metres.

        Returns
        -------
        shapely geometry
            Obstacles and the outside of the arena. Circles are circumscribed by polygons.
        """
        corners = self._arena[0][:, 0]
        centres, radii = self._centres[:, scene_index], self._radii[:, scene_index]
        first, second = self._first[:, scene_index], self._second[:, scene_index]
        return blocked_region(corners, centres, radii, first, second, margin, self._grid)

    def _in_chunks(
        self, measure: Callable[..., Any], scene: Indices, *arrays: NDArray[Any], rays: int = 1
    ) -> Any:
        """Apply a measurement to arrays of B rows, some rows at a time."""
        shapes = len(self._centres) + len(self._first) / _EDGES_SEEN + len(self._normals)
        pieces = math.ceil(len(scene) * shapes * rays / _CHUNK)
        if pieces <= 1:
            return measure(*arrays, scene)
        step = math.ceil(len(scene) / pieces)
        parts = [slice(first, first + step) for first in range(0, len(scene), step)]
        return np.concatenate([measure(*(array[part] for array in arrays), scene[part]) for part in parts])

    def _blocked(self, points: Plane, scene: Indices) -> Booleans:
        return np.asarray(self._clearance(points, scene) <= 0.0)

    def _clearance(self, points: Plane, scene: Indices) -> Floats:
        nearest = self._arena_clearance(points)
        if len(self._centres):
            centres, radii = self._centres.take(scene, axis=1), self._radii.take(scene, axis=1)
            nearest = np.minimum(nearest, (np.abs(centres - points) - radii).min(axis=0))
        if len(self._first):
            edges = self._first.take(scene, axis=1), self._second.take(scene, axis=1)
            away = np.sqrt(point_edge_squared(points, *edges).min(axis=0))
            away[winding_number(points, *edges) > 0] = 0.0
            nearest = np.minimum(nearest, away)
        if self._grid is not None:
            nearest = np.minimum(nearest, self._grid.clearance(points))
        return np.fmax(nearest, 0.0)

    def _arena_clearance(self, points: Plane) -> Floats:
        """Return the distance (B,) to the arena's walls, at most 0 outside."""
        if self._convex:
            return np.asarray((self._offsets - dot(self._normals, points)).min(axis=0))
        nearest = np.sqrt(point_edge_squared(points, *self._arena).min(axis=0))
        nearest[winding_number(points, *self._arena) == 0] = 0.0
        return np.asarray(nearest)

    def _segment_clearance(self, starts: Plane, ends: Plane, scene: Indices) -> Floats:
        nearest = np.minimum(self._arena_clearance(starts), self._arena_clearance(ends))
        if not self._convex:
            away = np.sqrt(segment_edge_squared(starts, ends, *self._arena).min(axis=0))
            nearest = np.minimum(nearest, away)
        if len(self._centres):
            centres, radii = self._centres.take(scene, axis=1), self._radii.take(scene, axis=1)
            away = np.sqrt(point_edge_squared(centres, starts, ends)) - radii
            nearest = np.minimum(nearest, away.min(axis=0))
        if len(self._first):
            edges = self._first.take(scene, axis=1), self._second.take(scene, axis=1)
            away = np.sqrt(segment_edge_squared(starts, ends, *edges).min(axis=0))
            away[winding_number(starts, *edges) > 0] = 0.0
            nearest = np.minimum(nearest, away)
        if self._grid is not None:
            nearest = np.minimum(nearest, self._grid.segment_clearance(starts, ends))
        return np.fmax(nearest, 0.0)

    def _polygon_clearance(self, poses: Floats, polygon: Floats, scene: Indices) -> Floats:
        corners = as_plane(poses) + np.exp(1j * poses[:, 2]) * as_plane(polygon)[:, None]  # (n, B)
        following = np.roll(corners, -1, axis=0)
        nearest = np.full(len(poses), np.inf)
        for first, second in zip(corners, following, strict=True):
            np.minimum(nearest, self._segment_clearance(first, second, scene), out=nearest)
        # An obstacle may lie wholly within the outline: then its centre, or a corner of it, does.
        for obstacle in (*self._centres, *self._first):
            nearest[winding_number(obstacle[scene], corners, following) > 0] = 0.0
        if self._grid is not None:
            nearest[self._grid.encloses(corners)] = 0.0
        return nearest


def own_of(scenarios: Sequence[Scenario | None]) -> list[Obstacles]:
    """Return what scenarios add to a map; nothing where there is none."""
    return [Obstacles() if scenario is None else scenario.obstacles for scenario in scenarios]


def _pad(arrays: Sequence[Floats], nothing: tuple[float, ...]) -> Floats:
    """Stack arrays of different lengths, (S, longest, n), filled up with `nothing`."""
    longest = max((len(array) for array in arrays), default=0)
    stacked = np.empty((len(arrays), longest, len(nothing)))
    stacked[:] = nothing
    for row, array in zip(stacked, arrays, strict=True):
        row[: len(array)] = array
    return stacked
