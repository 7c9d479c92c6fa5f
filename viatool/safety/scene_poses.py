"""Where states stand: their poses, each within the obstacles of its own episode."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viatool.arrays import Floats, Indices
from viatool.world import Obstacles, Scenario, Scenes, WorldMap


@dataclass(frozen=True, eq=False)
class ScenePoses:
    """B poses, each in a scene of its own episode, or boxes of poses.

    Parameters
    ----------
    poses : ndarray
        (B, 3) x, y, theta in the map frame; metres and radians.
    scene : ndarray
        (B,) index of each pose's scene in `scenes`.
    scenes : Scenes
        Obstacles and arena of every scene.
    scale : float
        A bound of every coordinate and radius of the geometry, in metres, at least 1.
    radii : ndarray, optional
        (B, 3) half-widths of boxes of poses around the given ones; None for the poses alone.
    """

    poses: Floats
    scene: Indices
    scenes: Scenes
    scale: float
    radii: Floats | None = None

    @classmethod
    def of(
        cls,
        world_map: WorldMap,
        scenarios: Sequence[Scenario | None],
        poses: Floats,
        scene: Indices,
    ) -> ScenePoses:
        """Return poses within the map and the obstacles of their scenarios."""
        own = [scenario.obstacles for scenario in scenarios if scenario is not None]
        extents = [np.abs(world_map.arena).max(), *map(_extent, [world_map.obstacles, *own])]
        return cls(poses, scene, Scenes.of(world_map, scenarios), 1.0 + float(max(extents)))

    def __len__(self) -> int:
        """Return the number of poses."""
        return len(self.poses)

    @property
    def extent(self) -> Floats | float:
        """Return how far any place of a box is from its middle at most, (B,) metres; 0 for poses alone."""
        return 0.0 if self.radii is None else np.hypot(self.radii[:, 0], self.radii[:, 1])

    def select(self, which: NDArray[Any]) -> ScenePoses:
        """Return some of the states, by index (repeated at will) or mask."""
        radii = None if self.radii is None else self.radii[which]
        return replace(self, poses=self.poses[which], scene=self.scene[which], radii=radii)

    def moved(self, poses: Floats) -> ScenePoses:
        """Return the same states at other poses (B, 3)."""
        return replace(self, poses=poses)


def _extent(obstacles: Obstacles) -> float:
    """Return a bound of the coordinates and radii of obstacles, in metres."""
    shapes = [obstacles.circles, *obstacles.polygons]
    if obstacles.grid is not None:
        shapes.append(obstacles.grid.outline)
    return max((float(np.abs(shape).max()) for shape in shapes if shape.size), default=0.0)
