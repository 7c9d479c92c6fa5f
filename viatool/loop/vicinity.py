"""What is around the robot in one scenario: what stands, what moves as an error model says, and both.

A proof over poses of which only the free ones count has an argument of its own for what stands: a robot that is clear
of it and goes away stays clear. What moves follows the robot, so of it nothing counts but distance, and the poses have
to be clear of wherever it may be to begin with. Hence both are kept apart.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from viatool.arrays import Booleans
from viatool.channels import LidarReadings
from viatool.errors import ConfigurationError
from viatool.safety import ScenePoses
from viatool.safety.moving import moving_obstacles
from viatool.safety.scene_poses import Movers
from viatool.uncertainty import ErrorModel
from viatool.world import Obstacles, Scenario, WorldMap

_FAR = 1e4
"""Metres to the walls of the arena in which what moves is alone: beyond every map."""


@dataclass(frozen=True, eq=False)
class Vicinity:
    """What is around the robot; poses of the geometries are not used.

    Parameters
    ----------
    everything : ScenePoses
        Where the map shows it, among what moves.
    standing : ScenePoses
        Without what roams.
    moving : ScenePoses or None
        What may move or roam alone, where the map shows it, and moving.
    loose : ScenePoses or None
        What roams alone.
    """

    everything: ScenePoses
    standing: ScenePoses
    moving: ScenePoses | None = None
    loose: ScenePoses | None = None

    @classmethod
    def of(cls, world_map: WorldMap, scenario: Scenario, errors: ErrorModel) -> Vicinity:
        """Return what is around in a scenario of a map."""
        everything, terms = _placed(world_map, scenario), errors.obstacles
        capsules = moving_obstacles(world_map, [scenario], terms)
        if not len(capsules):
            return cls(everything, everything)
        free = np.array([terms.freedom(name) for name in world_map.obstacles.names]).reshape(-1, 2)
        roams = free[:, 0] > 0.0
        moves = roams | (free[:, 1] > 0.0)
        movers = Movers(capsules, np.zeros(1, np.int64))
        alone = scenario if terms.speed else replace(scenario, obstacles=Obstacles())
        found = cls(
            everything.among([movers]),
            _placed(_holding(world_map, ~roams), scenario),
            _placed(_alone(world_map, moves), alone).among([movers]),
        )
        if not roams.any():
            return found
        nothing = replace(scenario, obstacles=Obstacles())
        few = moving_obstacles(world_map, [None], terms.model_copy(update={"speed": None, "named": {}}))
        around = _placed(_alone(world_map, roams), nothing).among([Movers(few, np.zeros(1, np.int64))])
        return replace(found, loose=around)


def check_roaming(seeing: Iterable[LidarReadings], errors: ErrorModel, term: str = "obstacles.roams") -> None:
    """Refuse LiDARs of which a reading may fall when something is taken away, as a term of the model says.

    Raises
    ------
    ConfigurationError
        Names the channel.
    """
    if not any(errors.obstacles.roams.values()):
        return
    for scanner in seeing:
        lidar = scanner.fan.lidar
        if lidar.no_return is not None and lidar.no_return < lidar.maximum_range:
            raise ConfigurationError(
                f"{errors.source}: {term}: '{scanner.channel.name}' reads {lidar.no_return:g} m where nothing "
                "returns, and what is read where something may be or not is not known over a set of poses",
                f"let it read {lidar.maximum_range:g} m or more there, or leave the term out",
            )


def _placed(world_map: WorldMap, scenario: Scenario) -> ScenePoses:
    return ScenePoses.of(world_map, [scenario], np.zeros((1, 3)), np.zeros(1, np.int64))


def _holding(world_map: WorldMap, which: Booleans) -> WorldMap:
    return replace(world_map, obstacles=world_map.obstacles.select(which))


def _alone(world_map: WorldMap, which: Booleans) -> WorldMap:
    """Return a map that has some obstacles and neither walls nor a grid."""
    obstacles = replace(world_map.obstacles.select(which), grid=None)
    arena = _FAR * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    return replace(world_map, arena=arena, obstacles=obstacles)
