"""Random worlds with every kind of shape, and the same questions answered by shapely, one at a time."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import shapely

from viatool.world import (
    Lidar,
    Obstacles,
    Scenario,
    WorldMap,
    box_polygon,
    simple_polygon,
    wall_polygons,
)

SQUARE = box_polygon((0.0, 0.0), (10.0, 8.0), 0.0)
L_SHAPED = simple_polygon([[-5, -4], [5, -4], [5, 1], [1, 1], [1, 4], [-5, 4]])
TILTED = simple_polygon([[-6, 0], [0, -5], [6, 0.5], [1, 5]])
ARENAS = {"box": SQUARE, "l-shaped": L_SHAPED, "tilted": TILTED}


def star(rng: np.random.Generator) -> np.ndarray:
    """Return a simple polygon that is usually not convex."""
    angle = np.sort(rng.uniform(0.0, 2.0 * np.pi, 7)) + np.linspace(0.0, 1e-3, 7)
    radius = rng.uniform(0.2, 0.9, 7)
    ring = rng.uniform(-4.0, 4.0, 2) + np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    return simple_polygon(ring) if shapely.Polygon(ring).is_valid else star(rng)


def random_obstacles(rng: np.random.Generator, circles: int, polygons: int) -> Obstacles:
    """Return circles, boxes, stars and bent walls, overlapping as they like."""
    rounds = np.column_stack([rng.uniform(-4.0, 4.0, (circles, 2)), rng.uniform(0.1, 0.9, circles)])
    rings: list[np.ndarray] = []
    for number in range(polygons):
        if number % 3 == 0:
            rings.append(box_polygon(rng.uniform(-4, 4, 2), rng.uniform(0.2, 2, 2), rng.uniform(-3, 3)))
        elif number % 3 == 1:
            rings.append(star(rng))
        else:
            rings.extend(wall_polygons(rng.uniform(-4.0, 4.0, (3, 2)), 0.1))
    return Obstacles(rounds, tuple(rings))


def random_world(
    rng: np.random.Generator, arena: np.ndarray, situations: int
) -> tuple[WorldMap, list[Scenario | None]]:
    """Return a map and situations, the last one without obstacles of its own."""
    world = WorldMap("random", Path("random.yaml"), "", arena, random_obstacles(rng, 3, 3))
    own = [random_obstacles(rng, number % 3, number % 4) for number in range(situations - 1)]
    scenarios: list[Scenario | None] = [Scenario("", (0, 0, 0), (0, 0), obstacles) for obstacles in own]
    return world, [*scenarios, None]


def blocked_region(world: WorldMap, scenario: Scenario | None) -> tuple[shapely.Geometry, np.ndarray]:
    """Return polygons and outside of the arena as one geometry, and the circles, (K, 3)."""
    obstacles = world.obstacles + (scenario.obstacles if scenario else Obstacles())
    outside = shapely.box(-30, -30, 30, 30).difference(shapely.Polygon(world.arena))
    solid = shapely.union_all([outside, *(shapely.Polygon(ring) for ring in obstacles.polygons)])
    return solid, obstacles.circles


def expected_clearance(world: WorldMap, scenario: Scenario | None, shape: shapely.Geometry) -> float:
    """Return the distance of a shapely geometry from everything that is not free."""
    solid, circles = blocked_region(world, scenario)
    distances = shapely.distance(shape, shapely.points(circles[:, :2])) - circles[:, 2]
    return max(0.0, min(shapely.distance(shape, solid), *distances, np.inf))


def expected_ranges(
    world: WorldMap, scenario: Scenario | None, pose: np.ndarray, angles: np.ndarray, limit: float
) -> list[float]:
    """Return how far rays get; circles by their own formula, the rest by intersecting shapely lines."""
    solid, circles = blocked_region(world, scenario)
    return [_expected_range(solid, circles, pose[:2], pose[2] + angle, limit) for angle in angles]


def _expected_range(
    solid: shapely.Geometry, circles: np.ndarray, origin: np.ndarray, angle: float, limit: float
) -> float:
    direction = np.array([np.cos(angle), np.sin(angle)])
    ray = shapely.LineString([origin, origin + limit * direction])
    hits = [limit]
    met = shapely.intersection(ray, solid)
    if not met.is_empty:
        hits.append(shapely.distance(shapely.Point(origin), met))
    for x, y, radius in circles:
        along = np.dot((x - origin[0], y - origin[1]), direction)
        apart = np.hypot(x - origin[0], y - origin[1])
        if apart <= radius:
            hits.append(0.0)
        elif along > 0.0 and (across := apart**2 - along**2) <= radius**2:
            hits.append(along - np.sqrt(radius**2 - across))
    return min(hits)


LIDAR = Lidar(field_of_view=np.pi, rays=36, bins=6, maximum_range=7.0)
