"""One start and goal, with the obstacles that only this scenario has."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

import numpy as np

from viatool.arrays import Floats
from viatool.errors import ConfigurationError, MapError
from viatool.world.rings import LARGEST, fit
from viatool.world.shapes import Obstacles

if TYPE_CHECKING:
    from shapely.geometry.base import BaseGeometry

STATE = ("x", "y", "theta", "v", "omega")
"""The numbers of a state of a scenario, in their order: m, m, rad, m/s and rad/s."""


@dataclass(frozen=True)
class StateRange:
    """A box of states.

    Parameters
    ----------
    lower, upper : tuple of float
        Ends of the first numbers of `STATE`; infinite where nothing is asked, as it is of those that are missing.
    outline : tuple of pairs
        Corners of a simple polygon in which x and y lie as well; none where the ends alone limit them.
    """

    lower: tuple[float, ...]
    upper: tuple[float, ...]
    outline: tuple[tuple[float, float], ...] = ()

    @property
    def middle(self) -> tuple[float, ...]:
        """Return the middle; of a half-open range its end, and 0 of one that is open to both sides.

        Of a polygon it is a place inside: its centroid, if that is one.
        """
        ends = np.array([self.lower, self.upper])
        ends = np.where(np.isfinite(ends), ends, ends[::-1])
        middle = np.where(np.isfinite(ends), ends, 0.0).mean(axis=0)
        if self.outline:
            places = self.places((-LARGEST, -LARGEST, LARGEST, LARGEST))
            inside = places.contains(places.centroid)
            at = places.centroid if inside else places.representative_point()
            middle[:2] = (at.x, at.y) if not places.is_empty else middle[:2]
        return tuple(middle.tolist())

    def places(self, bounds: tuple[float, float, float, float]) -> BaseGeometry:
        """Return where x and y may be, within least x, y and largest x, y, as a shapely geometry."""
        import shapely

        low = np.clip(self.lower[:2], bounds[:2], bounds[2:])
        high = np.clip(self.upper[:2], bounds[:2], bounds[2:])
        ends = shapely.box(*low, *high)
        return ends.intersection(shapely.Polygon(self.outline)) if self.outline else ends

    def words(self) -> str:
        """Return the ranges in words."""
        units = ("m", "m", "rad", "m/s", "rad/s")
        parts = zip(STATE, self.lower, self.upper, units, strict=False)
        outline = [f"a polygon of {len(self.outline)} corners"] if self.outline else []
        return ", ".join(
            outline
            + [
                f"{name} {low:g} to {high:g} {unit}"
                for name, low, high, unit in parts
                if low > -np.inf or high < np.inf
            ]
        )

    def ends(self, names: tuple[str, ...]) -> Floats:
        """Return the ends of named numbers, (2, K); those that are missing are free."""
        found = np.array([[-np.inf] * len(names), [np.inf] * len(names)])
        for place, name in enumerate(names):
            if name in STATE[: len(self.lower)]:
                number = STATE.index(name)
                found[:, place] = self.lower[number], self.upper[number]
        return found


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
    starts : StateRange, optional
        Any of these states instead of the start at rest, which is their middle.
    region : StateRange, optional
        Any of these states instead of a place near the goal, which is their middle.
    deadline : float, optional
        Seconds.
    arrive : str
        "within" the deadline, or "at" it.

    Raises
    ------
    MapError
        If a number of the start or the goal is not finite.
    """

    name: str
    start: tuple[float, float, float]
    goal: tuple[float, float]
    obstacles: Obstacles = field(default_factory=Obstacles)
    starts: StateRange | None = None
    region: StateRange | None = None
    deadline: float | None = None
    arrive: Literal["within", "at"] = "within"

    def __post_init__(self) -> None:
        for what in ("start", "goal"):
            given = getattr(self, what)
            if not fit(given).all():
                raise MapError(
                    f"{what} of scenario '{self.name}' is {tuple(map(float, given))}, expected finite numbers of at "
                    f"most {LARGEST:g}",
                    f"correct the {what}",
                )

    @property
    def of_missions(self) -> str:
        """Return in words what only missions follow of it; empty for a plain pose and a plain goal."""
        named = {
            "a box of starts": self.starts is not None,
            "a goal of states": self.region is not None,
            "a deadline": self.deadline is not None,
        }
        return " and ".join(name for name, has in named.items() if has)


def require_plain(scenarios: tuple[Scenario, ...]) -> None:
    """Refuse scenarios of which not everything is followed but by missions.

    Raises
    ------
    ConfigurationError
        Names the first of them.
    """
    for scenario in scenarios:
        if scenario.of_missions:
            raise ConfigurationError(
                f"scenario '{scenario.name}' has {scenario.of_missions}, which only viatool mission follows",
                "give `start` as a pose and `goal` as a point, without `deadline`",
            )
