"""A world: arena, obstacles, robot, clearances and the scenarios that are driven in it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from pathlib import Path

from viatool.arrays import Floats
from viatool.errors import ConfigurationError
from viatool.world.generator import ScenarioGenerator
from viatool.world.rings import simple_polygon
from viatool.world.robot import Robot
from viatool.world.scenario import Scenario
from viatool.world.shapes import Obstacles


@dataclass(frozen=True)
class Clearance:
    """Distances between the robot's footprint and the nearest obstacle, in metres.

    Parameters
    ----------
    collision : float
        Below it the robot counts as collided (the paper's d_col).
    danger : float
        Below it a step costs 1 (the paper's d_danger); at least `collision`.
    """

    collision: float = 0.4
    danger: float = 0.5

    def __post_init__(self) -> None:
        for name in ("collision", "danger"):
            value = getattr(self, name)
            if not 0.0 <= value < math.inf:
                raise ConfigurationError(
                    f"{name} clearance is {value} m, expected a finite distance of 0 or more",
                    "give a distance in metres",
                )
        if self.danger < self.collision:
            raise ConfigurationError(
                f"danger clearance {self.danger} m is below the collision clearance {self.collision} m",
                "raise the danger clearance, or lower the collision clearance",
            )


@dataclass(frozen=True, eq=False)
class WorldMap:
    """A closed arena with obstacles; whatever lies outside the arena counts as obstacle.

    Parameters
    ----------
    name : str
        Short name.
    path : Path
        File it came from, or the name under which it comes with viatool.
    sha256 : str
        Digest of that file.
    arena : ndarray
        (n, 2) corners of a simple polygon, in metres; kept counter-clockwise, without repeated corners.
    obstacles : Obstacles
        Present in every scenario.
    robot : Robot
        The robot that the map is meant for.
    clearance : Clearance
        The distances that count as collision and as danger.
    scenarios : tuple of Scenario
        Fixed scenarios for evaluation; may be empty.
    generator : ScenarioGenerator, optional
        Draws any number of further scenarios.
    warnings : tuple of str
        What a user should know about the file.
    stated : frozenset of str
        What the file says of the robot: ``robot`` where it speaks of one at all, ``footprint``, ``lidar.rays`` and the
        like. A LiDAR or a footprint that it does not state is a default, and binds nobody.

    Raises
    ------
    MapError
        If the arena is not a simple polygon of finite corners.
    """

    name: str
    path: Path
    sha256: str
    arena: Floats
    obstacles: Obstacles = field(default_factory=Obstacles)
    robot: Robot = field(default_factory=Robot)
    clearance: Clearance = field(default_factory=Clearance)
    scenarios: tuple[Scenario, ...] = ()
    generator: ScenarioGenerator | None = None
    warnings: tuple[str, ...] = ()
    stated: frozenset[str] = frozenset({"robot"})

    def __post_init__(self) -> None:
        object.__setattr__(self, "arena", simple_polygon(self.arena, "arena"))

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """Return the smallest x, y and the largest x, y of the arena, in metres."""
        (x_min, y_min), (x_max, y_max) = self.arena.min(axis=0), self.arena.max(axis=0)
        return float(x_min), float(y_min), float(x_max), float(y_max)

    def numbered(self, number: int) -> Scenario:
        """Return a fixed scenario by its number, counted from 0.

        Raises
        ------
        ConfigurationError
            If there is none.
        """
        if not self.scenarios:
            raise ConfigurationError(
                f"map '{self.path}' has no scenarios",
                "add 'scenarios' to the map, or give a goal with --goal X,Y",
            )
        if not 0 <= number < len(self.scenarios):
            raise ConfigurationError(
                f"map '{self.path}' has {len(self.scenarios)} scenarios, so none of number {number}",
                "count from 0, or give a goal with --goal X,Y",
            )
        return self.scenarios[number]

    def scenario(self, which: str | int) -> Scenario:
        """Return a fixed scenario by its name, or by its number, counted from 0.

        Raises
        ------
        ConfigurationError
            If there is none.
        """
        named = [scenario for scenario in self.scenarios if scenario.name == which]
        if named:
            return named[0]
        if isinstance(which, int) or which.isdecimal():
            return self.numbered(int(which))
        names = ", ".join(scenario.name for scenario in self.scenarios[:10])
        raise ConfigurationError(
            f"map '{self.path}' has no scenario '{which}'",
            f"name one of its {len(self.scenarios)}, or its number: {names}"
            if names
            else "draw some with --scenarios N",
        )

    def with_clearance(self, collision: float | None = None, danger: float | None = None) -> WorldMap:
        """Return the map with other clearances.

        Parameters
        ----------
        collision, danger : float, optional
            In metres; None keeps the map's. If only `collision` is given and it exceeds the map's danger
            clearance, the danger clearance is raised to it.

        Raises
        ------
        ConfigurationError
            If one is negative or not finite, or the given danger clearance is below the collision clearance.
        """
        inner = self.clearance.collision if collision is None else collision
        outer = danger if danger is not None else max(self.clearance.danger, inner)
        return replace(self, clearance=Clearance(inner, outer))

    def with_robot(self, robot: Robot) -> WorldMap:
        """Return the map with another robot."""
        return replace(self, robot=robot)
