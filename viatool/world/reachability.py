"""Which goals no robot could reach, whatever its policy."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from viatool.arrays import Booleans, Floats
from viatool.world.scenes import NO_CIRCLES, NO_EDGES, Scenes
from viatool.world.world_map import WorldMap

_MOST_POINTS = 250_000
_NEAR_ENOUGH = 0.5  # metres from the goal at which an episode succeeds


def unreachable_scenarios(world_map: WorldMap) -> NDArray[np.int64]:
    """Return the fixed scenarios in which no path leads to the goal at the collision clearance.

    Parameters
    ----------
    world_map : WorldMap
        Its footprint counts as a point, which may only make more goals reachable.

    Returns
    -------
    ndarray
        Indices of the scenarios.

    Notes
    -----
    Sound: yes, a goal that is called out of reach is. On a lattice of spacing h, every point of a path that
    keeps the clearance c has a lattice point within h / sqrt(2), whose clearance is at least c - h / sqrt(2);
    and the lattice points along a path are neighbours. The converse does not hold.
    """
    if not world_map.scenarios:
        return np.zeros(0, np.int64)
    points, spacing = _lattice(world_map)
    least = world_map.clearance.collision - math.sqrt(0.5) * spacing
    flat, index = points.reshape(-1, 2), np.zeros(points.shape[0] * points.shape[1], np.int64)
    shared = Scenes.of(world_map, [None]).clearance(flat, index)
    lost = []
    for number, scenario in enumerate(world_map.scenarios):
        own = Scenes(world_map.arena, scenario.obstacles, NO_CIRCLES, NO_EDGES).clearance(flat, index)
        free = (np.minimum(shared, own) >= max(least, 0.0)).reshape(points.shape[:2])
        if not _joined(free, points, spacing, scenario.start[:2], scenario.goal):
            lost.append(number)
    return np.array(lost, dtype=np.int64)


def _lattice(world_map: WorldMap) -> tuple[Floats, float]:
    """Return points (R, C, 2) all over the map, and how far apart they are, in metres."""
    x_min, y_min, x_max, y_max = world_map.bounds
    coarsest = math.sqrt((x_max - x_min) * (y_max - y_min) / _MOST_POINTS)
    spacing = max(coarsest, 0.1 * max(world_map.clearance.collision, 0.1))
    x, y = np.arange(x_min, x_max + spacing, spacing), np.arange(y_min, y_max + spacing, spacing)
    return np.stack(np.meshgrid(x, y), axis=-1), spacing


def _joined(
    free: Booleans, points: Floats, spacing: float, start: tuple[float, float], goal: tuple[float, float]
) -> bool:
    """Tell whether a free point beside the start is joined to one that is near enough to the goal."""
    from scipy.ndimage import label

    pieces, _ = label(free, structure=np.ones((3, 3)))
    beside = math.sqrt(0.5) * spacing + 1e-9
    from_start = np.hypot(*(points - start).transpose(2, 0, 1)) <= beside
    to_goal = np.hypot(*(points - goal).transpose(2, 0, 1)) <= _NEAR_ENOUGH + beside
    begun = np.setdiff1d(pieces[from_start], 0)
    return bool(np.isin(pieces[to_goal], begun).any())
