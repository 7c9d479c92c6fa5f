"""What moves around states, as the error model says: obstacles of the map, LiDAR returns, people, what is hidden."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from viatool.arrays import Floats, Indices
from viatool.channels import LidarReadings
from viatool.safety.scene_poses import Movers
from viatool.setting.moving import scanners
from viatool.setting.setting import Setting
from viatool.uncertainty.error_model import ObstacleTerms, SensorTerms
from viatool.world import Capsules, Obstacles, Scenario, WorldMap
from viatool.world.capsules import NOWHERE
from viatool.world.seen import Unseen, things_around


def movers_around(
    setting: Setting,
    scenarios: Sequence[Scenario | None],
    poses: Floats,
    scene: Indices,
    observations: Floats,
    people: Floats,
) -> list[Movers]:
    """Return what moves around B states.

    Parameters
    ----------
    setting : Setting
        Whose error model says what moves.
    scenarios : sequence of Scenario
        S of them.
    poses, observations : ndarray
        (B, 3) and (B, n): where the robot stood, and what the network received there.
    scene : ndarray
        (B,) the scenario of each state.
    people : ndarray
        (B, P, 5) x, y, velocity along x and y, and radius of people; NaN for nobody.

    Notes
    -----
    Sound: as far as the error model says what may move. What was seen stood around the robot wherever that was: who
    keeps away from it from everywhere within the error of the pose keeps away from it from the recorded pose, too.
    """
    if not setting.moves:
        return []
    terms, every = setting.uncertainty.obstacles, np.arange(len(poses))
    found = [Movers(moving_obstacles(setting.world_map, scenarios, terms), scene)]
    if terms.people is not None:
        found.append(Movers(people_as_capsules(people, terms.people), every))
    if terms.returns is not None or terms.hidden is not None:
        unseen = Unseen(terms.returns, terms.hidden, terms.behind)
        for scanner in scanners(setting.spec, setting.robot):
            low, high = _true_ranges(setting, scanner, observations)
            turn = setting.uncertainty.sensor.get(scanner.channel.name, SensorTerms()).angle or 0.0
            found.append(Movers(things_around(scanner.fan.lidar, low, high, poses, unseen, turn), every))
    return [some for some in found if len(some.capsules)]


def _true_ranges(setting: Setting, scanner: LidarReadings, observations: Floats) -> tuple[Floats, Floats]:
    """Return the ends (B, bins) of the true ranges of which readings were made.

    A range t reads ``t (1 + s) + e + c``, with s, e and c within the sensor's relative, absolute and common error.
    """
    lidar, columns = scanner.fan.lidar, setting.spec.inputs.newest(scanner.channel.name)
    stated = setting.uncertainty.sensor.get(scanner.channel.name, SensorTerms())
    error, share = setting.radii[columns] + (stated.bias or 0.0), stated.relative or 0.0
    least, most = (end[:, columns] for end in setting.spec.inputs.readings(observations))
    low, high = (least - error) / (1.0 + share), (most + error) / (1.0 - share)
    low, high = (np.minimum(end, lidar.maximum_range) for end in (low, high))
    return np.where(low > lidar.minimum_range, low, 0.0), high  # else it may be anything nearer


def moving_obstacles(
    world_map: WorldMap, scenarios: Sequence[Scenario | None], terms: ObstacleTerms
) -> Capsules:
    """Return the obstacles of S scenes that may be elsewhere than where the map shows them."""
    parts = [_capsules_of(world_map.obstacles, terms, len(scenarios))]
    own = [Obstacles() if scenario is None else scenario.obstacles for scenario in scenarios]
    if terms.speed:
        alike = ObstacleTerms(speed=terms.speed)
        each = [_capsules_of(obstacles, alike, 1) for obstacles in own]
        longest = max(map(len, each))
        parts.append(Capsules.beside([some.filled(longest, "an obstacle of the scenario") for some in each]))
    return Capsules.stacked(parts)


def _capsules_of(obstacles: Obstacles, terms: ObstacleTerms, scenes: int) -> Capsules:
    """Return the circles and the rims of the polygons that may move or roam, the same in every scene."""
    rows: list[tuple[complex, complex, float, float]] = []
    labels = []
    count = len(obstacles.circles)
    for number, name in enumerate(obstacles.names):
        roams, speed = terms.freedom(name)
        if not roams and not speed:
            continue
        if number < count:
            x, y, radius = obstacles.circles[number].tolist()
            sides = [(complex(x, y), complex(x, y), radius)]
        else:
            ring = [complex(*corner) for corner in obstacles.polygons[number - count].tolist()]
            sides = [(a, b, 0.0) for a, b in zip(ring, [*ring[1:], ring[0]], strict=True)]
        rows += [(first, second, radius + roams, speed) for first, second, radius in sides]
        labels += [name or "an obstacle of the map"] * len(sides)
    table = np.array(rows, dtype=complex).reshape(-1, 4).T[:, :, None].repeat(scenes, axis=2)
    return Capsules(table[0], table[1], table[2].real.copy(), table[3].real.copy(), tuple(labels))


def people_as_capsules(people: Floats, least: float) -> Capsules:
    """Return people (B, P, 5) as discs that go in any direction, as fast as they are and at least so fast."""
    x, y, across, along, radius = np.moveaxis(people, 2, 0).swapaxes(1, 2)  # (P, B) each
    there = ~np.isnan(x)
    place = np.where(there, x + 1j * y, NOWHERE)
    speed = np.where(there, np.maximum(np.hypot(across, along), least), 0.0)
    labels = tuple(f"person {number}" for number in range(people.shape[1]))
    return Capsules(place, place, np.where(there, radius, 0.0), speed, labels)
