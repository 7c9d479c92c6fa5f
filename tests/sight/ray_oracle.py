"""Ranges by school formulas, one ray against every shape: shares no code with the world's casting or certify."""

from __future__ import annotations

import numpy as np

from viatool.world import Lidar, Obstacles, Scenario, WorldMap


def outlines(world: WorldMap, scenario: Scenario | None) -> tuple[np.ndarray, np.ndarray]:
    """Circles (K, 3) and segments (M, 4) of everything that is solid; every blocked cell is a square."""
    obstacles = world.obstacles + (scenario.obstacles if scenario else Obstacles())
    rings = [world.arena, *obstacles.polygons]
    if obstacles.grid is not None:
        for row, column in np.argwhere(obstacles.grid.blocked):
            square = np.array([(0, 0), (1, 0), (1, 1), (0, 1)], dtype=float) + np.array([column, row])
            rings.append(obstacles.grid.to_map(square))
    segments = np.concatenate([np.hstack([ring, np.roll(ring, -1, axis=0)]) for ring in rings])
    return obstacles.circles, segments


def ranges(
    poses: np.ndarray, angles: np.ndarray, shapes: tuple[np.ndarray, np.ndarray], limit: float
) -> np.ndarray:
    """How far the rays at angles (R,) get from poses (B, 3): (B, R)."""
    circles, segments = shapes
    bearing = poses[:, 2, None] + angles
    dx, dy = np.cos(bearing), np.sin(bearing)
    x, y = poses[:, 0, None], poses[:, 1, None]
    nearest = np.full(bearing.shape, limit)
    for cx, cy, radius in circles:
        along = (cx - x) * dx + (cy - y) * dy
        discriminant = along**2 - ((cx - x) ** 2 + (cy - y) ** 2 - radius**2)
        met = (discriminant >= 0.0) & (along > 0.0)
        nearest[met] = np.minimum(nearest[met], along[met] - np.sqrt(discriminant[met]))
    for x1, y1, x2, y2 in segments:
        ex, ey = x2 - x1, y2 - y1
        across = dx * ey - dy * ex
        with np.errstate(divide="ignore", invalid="ignore"):
            far = ((x1 - x) * ey - (y1 - y) * ex) / across
            share = ((x1 - x) * dy - (y1 - y) * dx) / across
        met = (across != 0.0) & (far >= 0.0) & (share >= 0.0) & (share <= 1.0)
        nearest = np.where(met, np.minimum(nearest, far), nearest)
    return nearest


def scan(
    poses: np.ndarray, lidar: Lidar, shapes: tuple[np.ndarray, np.ndarray], most: int = 40_000
) -> np.ndarray:
    """What a perfect LiDAR reports from poses (B, 3): (B, bins)."""
    step = max(1, most // lidar.rays)
    found = [
        ranges(poses[first : first + step], lidar.angles(), shapes, lidar.maximum_range)
        for first in range(0, len(poses), step)
    ]
    least = np.concatenate(found).reshape(len(poses), lidar.bins, -1).min(axis=2)
    return np.clip(least, lidar.minimum_range, lidar.maximum_range)
