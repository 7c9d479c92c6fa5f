"""The course on which every reading is driven: the same scenarios, the same noise, the same robot."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from viatool.doctor.evidence import Driven
from viatool.policy import Policy, PolicySpecification
from viatool.setting.setting import Setting
from viatool.setting.wishes import Wishes
from viatool.simulate import Drive, drive
from viatool.world import Scenario, WorldMap


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
