"""One start and goal, with the obstacles that only this scenario has."""

from __future__ import annotations

from dataclasses import dataclass, field

from viatool.errors import MapError
from viatool.world.rings import LARGEST, fit
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

    Raises
    ------
    MapError
        If a number of the start or the goal is not finite.
    """

    name: str
    start: tuple[float, float, float]
    goal: tuple[float, float]
    obstacles: Obstacles = field(default_factory=Obstacles)

    def __post_init__(self) -> None:
        for what in ("start", "goal"):
            given = getattr(self, what)
            if not fit(given).all():
                raise MapError(
                    f"{what} of scenario '{self.name}' is {tuple(map(float, given))}, expected finite numbers of at "
                    f"most {LARGEST:g}",
                    f"correct the {what}",
                )
