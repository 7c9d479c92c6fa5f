"""Where the robots of a simulator get their next scenario from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from viatool.arrays import Booleans, Floats, Indices
from viatool.errors import ConfigurationError
from viatool.world import (
    Footprint,
    Obstacles,
    Scenario,
    ScenarioBatch,
    ScenarioGenerator,
    Scenes,
    WorldMap,
)
from viatool.world.scenario import require_plain

Taken = tuple[Indices, Floats, Floats]  # scene (W,), starts (W, 3), goals (W, 2)

_DRAWN_AHEAD = 512  # random scenarios that are drawn together


class FixedScenarios:
    """Given scenarios, one after the other, again from the first when they are used up.

    Parameters
    ----------
    world_map : WorldMap
        What all scenarios share.
    scenarios : sequence of Scenario
        At least one.
    """

    generator: ScenarioGenerator | None = None

    def __init__(self, world_map: WorldMap, scenarios: Sequence[Scenario]) -> None:
        if not scenarios:
            raise ConfigurationError(
                f"map '{world_map.name}' gives no scenario to drive",
                "add `scenarios` or a `generator` to the map",
            )
        require_plain(tuple(scenarios))
        self.scenes = Scenes.of(world_map, scenarios)
        self.scenarios = tuple(scenarios)
        self._starts = np.array([scenario.start for scenario in scenarios])
        self._goals = np.array([scenario.goal for scenario in scenarios])
        self._next = 0
        self._check_room(world_map.robot.footprint)

    def _check_room(self, footprint: Footprint) -> None:
        """Refuse a start or a goal that no robot can be at."""
        every = np.arange(len(self.scenarios))
        inside = self.scenes.footprint_clearance(self._starts, footprint, every) <= 0.0
        for what, places, wrong in (
            ("start", self._starts, inside),
            ("goal", self._goals, self.scenes.blocked(self._goals, every)),
        ):
            for index in np.flatnonzero(wrong)[:1]:
                x, y = places[index, :2]
                raise ConfigurationError(
                    f"the {what} ({x:g}, {y:g}) of scenario '{self.scenarios[index].name}' lies in an obstacle "
                    "or off the map",
                    f"move the {what} into free space",
                )

    def reseed(self, seed: np.random.SeedSequence) -> None:
        """Begin again with the first scenario."""
        self._next = 0

    def own(self, scene: int) -> Obstacles:
        """Return the obstacles that one scenario has besides the map's."""
        return self.scenarios[scene].obstacles

    def take(self, slots: Indices) -> Taken:
        """Return the next scenario for each of W robots."""
        scene = (self._next + np.arange(len(slots))) % len(self.scenes)
        self._next = int(self._next + len(slots)) % len(self.scenes)
        return scene, self._starts[scene], self._goals[scene]


@dataclass(frozen=True, eq=False)
class Repeats:
    """Scenarios that robots drive again instead of new ones.

    Parameters
    ----------
    share : float
        Of the episodes of robots that have some.
    batch : ScenarioBatch
        With as many obstacles as the map's generator places.
    first, count : ndarray
        (E,) each robot draws from `count` scenarios of the batch, beginning with `first`.
    """

    share: float
    batch: ScenarioBatch
    first: Indices
    count: Indices

    def draw(
        self, slots: Indices, fresh: ScenarioBatch, rng: np.random.Generator
    ) -> tuple[Booleans, ScenarioBatch]:
        """Return which of W robots drive again, (W,), and the scenarios of all, of which the others are `fresh`."""
        again, place = rng.random((2, len(slots)))
        which = (again < self.share) & (self.count[slots] > 0)
        row = (self.first[slots] + place * self.count[slots]).astype(np.int64)[which]
        return which, fresh.with_rows(which, self.batch[row])


class RandomScenarios:
    """Scenarios that are drawn when they are needed; every robot has a scene of its own.

    Parameters
    ----------
    world_map : WorldMap
        A map with a generator.
    robots : int
        E.
    seed : numpy.random.SeedSequence
        Of the scenarios.

    Attributes
    ----------
    repeats : Repeats, optional
        What is driven again.
    repeated : ndarray
        (E,) which robots drive such a scenario at present.
    """

    def __init__(self, world_map: WorldMap, robots: int, seed: np.random.SeedSequence) -> None:
        if world_map.generator is None:
            raise ConfigurationError(
                f"map '{world_map.name}' has no scenario generator",
                "add a `generator` to the map, or give scenarios",
            )
        self._generator = world_map.generator
        self._latest: dict[int, tuple[ScenarioBatch, int]] = {}
        self.repeats: Repeats | None = None
        self.repeated = np.zeros(robots, dtype=bool)
        self._ahead = max(_DRAWN_AHEAD, robots)
        self.reseed(seed)
        first = self._drawn[:robots]
        self.scenes = Scenes(world_map.arena, world_map.obstacles, first.circles, first.edges())

    def reseed(self, seed: np.random.SeedSequence) -> None:
        """Draw later scenarios from a new source."""
        self._rng = np.random.default_rng(seed)
        self._drawn = self._generator.draw_arrays(self._ahead, self._rng)
        self._used = 0

    @property
    def generator(self) -> ScenarioGenerator:
        """What draws the scenarios; may be set to one with as many obstacles."""
        return self._generator

    @generator.setter
    def generator(self, generator: ScenarioGenerator) -> None:
        self._generator = generator
        self._used = len(self._drawn)

    def take(self, slots: Indices) -> Taken:
        """Draw a scenario for each of W robots and build it into their scenes."""
        batch = self._next(len(slots))
        if self.repeats is not None:
            self.repeated[slots], batch = self.repeats.draw(slots, batch, self._rng)
        self.scenes.replace(slots, batch.circles, batch.edges())
        self._latest.update((slot, (batch, row)) for row, slot in enumerate(slots.tolist()))
        return slots, batch.starts, batch.goals

    def own(self, scene: int) -> Obstacles:
        """Return the obstacles that one scenario has besides the map's."""
        batch, row = self._latest[scene]
        return batch.scenario(row, "").obstacles

    def _next(self, count: int) -> ScenarioBatch:
        if self._used + count > len(self._drawn):
            left = self._drawn[self._used :]
            self._drawn = left + self._generator.draw_arrays(max(_DRAWN_AHEAD, count), self._rng)
            self._used = 0
        batch = self._drawn[self._used : self._used + count]
        self._used += count
        return batch
