"""The geometry of many situations at once: each has the map's obstacles and its own."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from viatool.world.casting import Ranges, Surroundings, cast_rays
from viatool.world.measurement import line_distance, point_edge_squared, segment_edge_squared, winding_number
from viatool.world.robot import Footprint, Lidar
from viatool.world.scenario import Scenario
from viatool.world.shapes import Floats, Obstacles, is_convex, ring_edges

if TYPE_CHECKING:
    from shapely.geometry.base import BaseGeometry

    from viatool.world.world_map import WorldMap

Indices = NDArray[np.int64]
Booleans = NDArray[np.bool_]

# Points x shapes that are measured at once, so that memory stays flat for any number of points.
_CHUNK = 1 << 18
# What fills the arrays of a scene that has fewer shapes than another: too far away to be near or seen.
_NO_CIRCLE = (0.0, 0.0, -1e9)
_NO_EDGE = (1e9, 1e9, 1e9, 1e9)
# The shapes of their own of one situation that has none.
NO_CIRCLES: Floats = np.zeros((1, 0, 3))
NO_EDGES: Floats = np.zeros((1, 0, 4))


class Scenes:
    """Obstacles and arena of S situations, for batches of points and ray fans.

    Parameters
    ----------
    arena : ndarray
        (n, 2) corners of the arena, counter-clockwise, in metres.
    shared : Obstacles
        What all situations have.
    circles : ndarray
        (S, K, 3) x, y, radius of each situation's own circles, in metres.
    edges : ndarray
        (S, M, 4) edges of each situation's own polygons, their inside to the left; in metres.

    Notes
    -----
    Methods take B points with the index of the situation that each belongs to. Costs grow with B times the
    number of shapes, which suits maps of up to some hundred edges.
    """

    def __init__(self, arena: Floats, shared: Obstacles, circles: Floats, edges: Floats) -> None:
        self._arena = ring_edges(arena)
        self._convex = is_convex(arena)
        count, rounds, sides = len(circles), shared.circles, shared.edges()
        self._circles = np.concatenate([np.broadcast_to(rounds, (count, *rounds.shape)), circles], axis=1)
        self._edges = np.concatenate([np.broadcast_to(sides, (count, *sides.shape)), edges], axis=1)
        self._own = (len(rounds), len(sides))

    @classmethod
    def of(cls, world_map: WorldMap, scenarios: Sequence[Scenario | None]) -> Scenes:
        """Return the situations of scenarios; None is the map with nothing added."""
        own = [Obstacles() if scenario is None else scenario.obstacles for scenario in scenarios]
        circles = _pad([obstacles.circles for obstacles in own], _NO_CIRCLE)
        edges = _pad([obstacles.edges() for obstacles in own], _NO_EDGE)
        return cls(world_map.arena, world_map.obstacles, circles, edges)

    def __len__(self) -> int:
        """Return the number of situations."""
        return len(self._circles)

    def replace(self, which: Indices, circles: Floats, edges: Floats) -> None:
        """Give some situations other obstacles of their own, in place.

        Parameters
        ----------
        which : ndarray
            (W,) indices of the situations.
        circles, edges : ndarray
            (W, k, 3) and (W, m, 4), at most as many as the situations were made for.
        """
        for array, own, values, nothing in (
            (self._circles, self._own[0], circles, _NO_CIRCLE),
            (self._edges, self._own[1], edges, _NO_EDGE),
        ):
            room, needed = array.shape[1] - own, values.shape[1]
            if needed > room:
                raise ValueError(f"scenes have room for {room} shapes of their own, got {needed}")
            array[which, own : own + needed] = values
            array[which, own + needed :] = nothing

    def cast(
        self,
        poses: Floats,
        scene: Indices,
        lidar: Lidar,
        *,
        angles: Floats | None = None,
        dtype: type = np.float64,
    ) -> Ranges:
        """Return what a perfect LiDAR without a minimum range would read.

        Parameters
        ----------
        poses : ndarray
            (B, 3) x, y, theta of the LiDAR; metres and radians.
        scene : ndarray
            (B,) indices of the situations.
        lidar : Lidar
            Directions of the rays and maximum range.
        angles : ndarray, optional
            (R,) other directions than the LiDAR's, in the robot's frame; radians.
        dtype : type
            np.float64, or np.float32 for twice the speed at an error of about 1e-6 of the range (up to 1e-3
            of it for a ray that grazes a circle).

        Returns
        -------
        ndarray
            (B, R) metres: `lidar.maximum_range` where nothing is nearer, 0 everywhere for a LiDAR inside an
            obstacle or outside the arena.
        """
        rays = lidar.angles() if angles is None else angles
        directions: Ranges = np.stack([np.cos(rays), np.sin(rays)]).astype(dtype)

        def measure(place: Floats, index: Indices) -> Ranges:
            ranges = cast_rays(place, self._surroundings(index), directions, lidar.maximum_range)
            if self._edges.shape[1] or not self._convex:
                ranges[self._blocked(place[:, :2], index)] = 0.0
            return ranges

        rows: Ranges = self._in_chunks(measure, scene, poses, rays=len(rays))
        return rows

    def _surroundings(self, scene: Indices) -> Surroundings:
        """Return the shapes around B ray fans."""
        arena = np.broadcast_to(self._arena, (len(scene), *self._arena.shape))
        edges = self._edges[scene][..., [2, 3, 0, 1]]  # obstacles are seen from their right
        if self._convex:
            return Surroundings(self._circles[scene], edges, arena)
        return Surroundings(self._circles[scene], np.concatenate([edges, arena], axis=1), arena[:, :0])

    def blocked(self, points: Floats, scene: Indices) -> Booleans:
        """Tell which points (B, 2) lie inside an obstacle or outside the arena."""
        inside: Booleans = self._in_chunks(self._blocked, scene, points)
        return inside

    def clearance(self, points: Floats, scene: Indices) -> Floats:
        """Return the distance from points to the nearest obstacle or wall of the arena.

        Parameters
        ----------
        points : ndarray
            (B, 2) metres.
        scene : ndarray
            (B,) indices of the situations.

        Returns
        -------
        ndarray
            (B,) metres; 0 inside an obstacle and outside the arena.

        Notes
        -----
        Sound: under rounding only (float64 to nearest). Cost: O(B (K + M)).
        """
        distances: Floats = self._in_chunks(self._clearance, scene, points)
        return distances

    def segment_clearance(self, starts: Floats, ends: Floats, scene: Indices) -> Floats:
        """Return the smallest distance from any point of segments to an obstacle or wall of the arena.

        Parameters
        ----------
        starts, ends : ndarray
            (B, 2) metres.
        scene : ndarray
            (B,) indices of the situations.

        Returns
        -------
        ndarray
            (B,) metres; 0 where a segment touches or lies inside an obstacle, or leaves the arena.

        Notes
        -----
        Sound: under rounding only (float64 to nearest). Cost: O(B (K + M)).
        """
        distances: Floats = self._in_chunks(self._segment_clearance, scene, starts, ends)
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
            (B,) indices of the situations.

        Returns
        -------
        ndarray
            (B,) metres; 0 where the footprint touches an obstacle or leaves the arena.
        """
        if footprint.kind != "polygon":
            return np.maximum(self.clearance(poses[:, :2], scene) - footprint.radius, 0.0)

        def measure(place: Floats, index: Indices) -> Floats:
            return self._polygon_clearance(place, footprint.polygon, index)

        distances: Floats = self._in_chunks(measure, scene, poses)
        return distances

    def shapely(self, scene_index: int, *, margin: float = 1.0) -> BaseGeometry:
        """Return everything that is not free, for drawing and as an oracle.

        Parameters
        ----------
        scene_index : int
            Which situation.
        margin : float
            How far the region outside of the arena extends beyond the arena's bounds, in metres.

        Returns
        -------
        shapely geometry
            Obstacles and the outside of the arena. Circles are circumscribed by 256-gons.
        """
        import shapely

        arena = shapely.Polygon(self._arena[:, :2])
        frame = shapely.box(*arena.bounds).buffer(margin, join_style="mitre")
        return shapely.union_all([frame.difference(arena), *self._shapes(scene_index)])

    def _shapes(self, scene_index: int) -> list[BaseGeometry]:
        """Return the obstacles of one situation as shapely polygons."""
        import shapely

        quarter = 64
        circles = self._circles[scene_index]
        circles = circles[circles[:, 2] > 0.0]
        outer = circles[:, 2] / np.cos(np.pi / (4 * quarter))
        shapes = list(shapely.buffer(shapely.points(circles[:, :2]), outer, quad_segs=quarter))
        ring: list[list[float]] = []
        for *first, x, y in self._edges[scene_index].tolist():
            ring.append(first)
            if [x, y] == ring[0]:  # closed
                if len(ring) > 1:
                    shapes.append(shapely.Polygon(ring))
                ring = []
        return shapes

    def _in_chunks(self, measure: Callable[..., Any], scene: Indices, *arrays: Floats, rays: int = 1) -> Any:
        """Apply a measurement to arrays of B rows, some rows at a time."""
        shapes = self._circles.shape[1] + self._edges.shape[1] + len(self._arena)
        step = max(1, _CHUNK // (shapes * rays))
        if len(scene) <= step:
            return measure(*arrays, scene)
        parts = [slice(first, first + step) for first in range(0, len(scene), step)]
        return np.concatenate([measure(*(array[part] for array in arrays), scene[part]) for part in parts])

    def _blocked(self, points: Floats, scene: Indices) -> Booleans:
        circles = self._circles[scene]
        away = np.square(circles[..., :2] - points[:, None]).sum(axis=-1)
        blocked = np.any((away <= np.square(circles[..., 2])) & (circles[..., 2] > 0.0), axis=1)
        if self._edges.shape[1]:
            blocked |= winding_number(points, self._edges[scene]) > 0
        return np.asarray(blocked | (winding_number(points, self._arena) == 0))

    def _clearance(self, points: Floats, scene: Indices) -> Floats:
        nearest = self._arena_clearance(points)
        circles = self._circles[scene]
        if circles.shape[1]:
            x, y = circles[..., 0] - points[:, :1], circles[..., 1] - points[:, 1:]
            away = np.sqrt(x * x + y * y) - circles[..., 2]
            nearest = np.minimum(nearest, away.min(axis=1))
        if self._edges.shape[1]:
            edges = self._edges[scene]
            away = np.sqrt(point_edge_squared(points[:, None], edges).min(axis=1))
            away[winding_number(points, edges) > 0] = 0.0
            nearest = np.minimum(nearest, away)
        return np.maximum(nearest, 0.0)

    def _arena_clearance(self, points: Floats) -> Floats:
        """Return the distance (B,) to the arena's walls, at most 0 outside."""
        if self._convex:
            return np.asarray(line_distance(points[:, None], self._arena).min(axis=1))
        nearest = np.sqrt(point_edge_squared(points[:, None], self._arena).min(axis=1))
        nearest[winding_number(points, self._arena) == 0] = 0.0
        return np.asarray(nearest)

    def _segment_clearance(self, starts: Floats, ends: Floats, scene: Indices) -> Floats:
        segments = np.concatenate([starts, ends], axis=1)[:, None]
        if self._convex:
            nearest = np.minimum(self._arena_clearance(starts), self._arena_clearance(ends))
        else:
            nearest = np.sqrt(segment_edge_squared(segments, self._arena).min(axis=1))
            nearest[winding_number(starts, self._arena) == 0] = 0.0
        circles = self._circles[scene]
        if circles.shape[1]:
            away = np.sqrt(point_edge_squared(circles[..., :2], segments)) - circles[..., 2]
            nearest = np.minimum(nearest, away.min(axis=1))
        if self._edges.shape[1]:
            edges = self._edges[scene]
            away = np.sqrt(segment_edge_squared(segments, edges).min(axis=1))
            away[winding_number(starts, edges) > 0] = 0.0
            nearest = np.minimum(nearest, away)
        return np.maximum(nearest, 0.0)

    def _polygon_clearance(self, poses: Floats, polygon: Floats, scene: Indices) -> Floats:
        cosine, sine = np.cos(poses[:, 2, None]), np.sin(poses[:, 2, None])
        x = poses[:, :1] + cosine * polygon[:, 0] - sine * polygon[:, 1]
        y = poses[:, 1:2] + sine * polygon[:, 0] + cosine * polygon[:, 1]
        corners = np.stack([x, y], axis=-1)  # (B, n, 2)
        following = np.roll(corners, -1, axis=1)
        nearest = np.full(len(poses), np.inf)
        for side in range(len(polygon)):
            np.minimum(
                nearest, self._segment_clearance(corners[:, side], following[:, side], scene), out=nearest
            )
        # An obstacle may lie wholly within the outline: then its centre, or a corner of it, does.
        outline = np.concatenate([corners, following], axis=-1)
        inside = np.concatenate([self._circles[scene, :, :2], self._edges[scene, :, :2]], axis=1)
        for obstacle in range(inside.shape[1]):
            nearest[winding_number(inside[:, obstacle], outline) > 0] = 0.0
        return nearest


def _pad(arrays: Sequence[Floats], nothing: tuple[float, ...]) -> Floats:
    """Stack arrays of different lengths, (S, longest, n), filled up with `nothing`."""
    longest = max((len(array) for array in arrays), default=0)
    stacked = np.empty((len(arrays), longest, len(nothing)))
    stacked[:] = nothing
    for row, array in zip(stacked, arrays, strict=True):
        row[: len(array)] = array
    return stacked
