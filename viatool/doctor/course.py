"""The course on which every reading is driven: the same scenarios, the same noise, the same robot."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from viatool.doctor.evidence import Driven
from viatool.errors import ConfigurationError
from viatool.policy import Policy, PolicySpecification
from viatool.setting.setting import Setting
from viatool.setting.wishes import Wishes
from viatool.simulate import Drive, drive
from viatool.world import Scenario, WorldMap

_TURNS = (0.0, 2.0, -2.0, 1.0, -1.0, 3.0)
"""Radians by which starts are turned where a map draws no scenarios, so that there are more of them."""


def scenarios_of(world_map: WorldMap, count: int, seed: int) -> tuple[Scenario, ...]:
    """Return the fixed scenarios of a map, and as many drawn ones as are missing of `count`.

    A map that draws none gives its fixed ones with starts that are turned.

    Raises
    ------
    ConfigurationError
        If there are neither.
    """
    fixed = world_map.scenarios
    if world_map.generator is not None:
        return (*fixed, *world_map.generator.draw(max(count - len(fixed), 0), seed))
    if not fixed:
        raise ConfigurationError(
            f"map '{world_map.path}' has no scenarios",
            "add 'scenarios' or a 'generator' to the map, or give --trajectory",
        )
    turned = [_turned(scenario, turn) for turn in _TURNS for scenario in fixed]
    return tuple(turned[: max(count, len(fixed))])


def _turned(scenario: Scenario, turn: float) -> Scenario:
    """Return a scenario that starts with another heading."""
    x, y, theta = scenario.start
    name = f"{scenario.name}, turned {turn:g} rad" if turn else scenario.name
    return replace(scenario, name=name, start=(x, y, theta + turn))


@dataclass(frozen=True, eq=False)
class Course:
    """Drives a policy as a specification says.

    Parameters
    ----------
    policy : Policy
        Whose program decides.
    world_map : WorldMap
        Where.
    scenarios : tuple of Scenario
        N of them.
    wishes : Wishes
        What counts instead of what policy and map say.
    noise : float, optional
        Of the LiDAR, in metres; None is the map's.
    seed : int
        Of the noise.
    horizon : int, optional
        Most steps of an episode.
    """

    policy: Policy
    world_map: WorldMap
    scenarios: tuple[Scenario, ...]
    wishes: Wishes
    noise: float | None = None
    seed: int = 0
    horizon: int | None = None

    def __call__(self, spec: PolicySpecification) -> Driven:
        """Return how the policy fares if a specification is right."""
        driven = self.drive(spec)
        starts = np.array([scenario.start[:2] for scenario in self.scenarios])
        goals = np.array([scenario.goal for scenario in self.scenarios])
        before, after = np.hypot(*(goals - starts).T), np.hypot(*(goals - driven.ends[:, :2]).T)
        closed = np.clip(1.0 - after / np.maximum(before, 1e-9), 0.0, 1.0)
        return Driven(driven.trajectory.outcomes, closed)

    def drive(self, spec: PolicySpecification) -> Drive:
        """Return the drive itself."""
        policy = replace(self.policy, spec=spec)
        setting = self.setting(spec)
        return drive(policy, setting, noise=self.noise, seed=self.seed, horizon=self.horizon)

    def setting(self, spec: PolicySpecification) -> Setting:
        """Return what is asked if a specification is right."""
        policy = replace(self.policy, spec=spec)
        return Setting.of(policy, self.world_map, 0.0, self.wishes, self.scenarios)
