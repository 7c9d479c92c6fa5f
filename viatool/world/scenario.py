"""One start and goal, with the obstacles that only this situation has."""

from __future__ import annotations

from dataclasses import dataclass, field

from viatool.world.shapes import Obstacles


@dataclass(frozen=True, eq=False)
class Scenario:
    """A task within a map.

    Parameters
    ----------
    name : str
        Unique within its map.
    start : tuple of float
        Pose x, y, theta at time 0; metres and radians.
    goal : tuple of float
        Position x, y to be reached, in metres.
    obstacles : Obstacles
        Present besides the map's own.
    """

    name: str
    start: tuple[float, float, float]
    goal: tuple[float, float]
    obstacles: Obstacles = field(default_factory=Obstacles)
