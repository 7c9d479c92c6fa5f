"""The maps that a policy is trained, validated and tested on; one robot drives on all of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from viatool.errors import ConfigurationError
from viatool.setting.reconcile import with_robot
from viatool.train.configuration import TrainingConfiguration
from viatool.world import Robot, Scenario, WorldMap, load_map

_UNUSED = ("name", "track")  # of a robot that is commanded by its speeds


@dataclass(frozen=True, eq=False)
class TrainingMaps:
    """One map or several. What is counted in robots or scenarios is shared out among them evenly.

    Parameters
    ----------
    maps : tuple of WorldMap
        At least one; all for the same robot.

    Raises
    ------
    ConfigurationError
        If a map has neither scenarios nor a generator, or its robot is not that of the first one.
    """

    maps: tuple[WorldMap, ...]

    def __post_init__(self) -> None:
        for world_map in self.maps:
            if world_map.generator is None and not world_map.scenarios:
                raise ConfigurationError(
                    f"map {world_map.path} has neither scenarios nor a generator",
                    "add a generator, as maps/lab.yaml has",
                )
            different = _differences(self.robot, world_map.robot)
            if different:
                raise ConfigurationError(
                    f"the robot of map {world_map.path} is not that of {self.maps[0].path}: {', '.join(different)}",
                    "one policy is trained for one robot: state the same robot in both maps",
                )

    @property
    def robot(self) -> Robot:
        """Return the robot that drives on all of them."""
        return self.maps[0].robot

    @property
    def names(self) -> tuple[str, ...]:
        """Return what each is called, in the order of the maps: no two alike."""
        names = [world_map.name for world_map in self.maps]
        return tuple(
            name if names.count(name) == 1 else f"{name}-{place + 1}" for place, name in enumerate(names)
        )

    @property
    def sha256(self) -> str:
        """Return the digests of all files."""
        return " ".join(world_map.sha256 for world_map in self.maps)

    def each(self, change: Callable[[WorldMap], WorldMap]) -> TrainingMaps:
        """Return the maps, each changed."""
        return TrainingMaps(tuple(map(change, self.maps)))

    def shares(self, count: int) -> tuple[int, ...]:
        """Return how many of `count` robots or scenarios each map gets; the first ones get one more."""
        whole, rest = divmod(count, len(self.maps))
        return tuple(whole + (place < rest) for place in range(len(self.maps)))

    def fixed(self) -> list[tuple[WorldMap, tuple[Scenario, ...]]]:
        """Return each map with its own scenarios, of the maps that have any."""
        return [(world_map, world_map.scenarios) for world_map in self.maps if world_map.scenarios]

    def draw(self, count: int, seed: int) -> list[tuple[WorldMap, tuple[Scenario, ...]]]:
        """Return `count` scenarios: of each map its share, see `random_scenarios`."""
        shares = zip(self.maps, self.shares(count), strict=True)
        return [(world_map, random_scenarios(world_map, share, seed)) for world_map, share in shares if share]


def load_maps(configuration: TrainingConfiguration) -> TrainingMaps:
    """Read the maps of a configuration, with the robot that it names."""
    worlds = [load_map(path) for path in configuration.maps]
    if configuration.robot is not None:
        worlds = [with_robot(world_map, configuration.robot) for world_map in worlds]
    if configuration.max_linear is not None:
        worlds = [
            world_map.with_robot(replace(world_map.robot, max_linear=configuration.max_linear))
            for world_map in worlds
        ]
    return TrainingMaps(tuple(worlds))


def random_scenarios(world_map: WorldMap, count: int, seed: int) -> tuple[Scenario, ...]:
    """Return `count` scenarios of the map's generator, or its own ones over and over if it has none."""
    if world_map.generator is not None:
        return world_map.generator.draw(count, seed)
    own = world_map.scenarios
    return tuple(own[index % len(own)] for index in range(count))


def _differences(first: Robot, other: Robot) -> list[str]:
    """Return in what two robots differ, but for what no command needs."""
    with np.printoptions(precision=17, threshold=1 << 20):
        told = [{name: repr(value) for name, value in vars(robot).items()} for robot in (first, other)]
    return [name for name in told[0] if name not in _UNUSED and told[0][name] != told[1][name]]
