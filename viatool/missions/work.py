"""Missions as work for the driver of long work: a unit is a scenario."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viatool.arrays import Floats
from viatool.loop.closed_loop import ClosedLoop
from viatool.missions.attack import MissionRuns, attack
from viatool.missions.follow import MissionFollower, MissionLimits
from viatool.missions.verdicts import Mission, late_run
from viatool.policy import Policy
from viatool.rounding import SPARE
from viatool.schedule import Span, Work, digest_of
from viatool.setting.setting import Setting
from viatool.taylor import Arithmetic
from viatool.versions import result_versions
from viatool.world import Scenario


@dataclass(frozen=True, eq=False)
class MissionExamination:
    """What happens to a scenario: runs are driven against it, then all runs are followed. Picklable, and pure.

    Parameters
    ----------
    policy : Policy
        The program.
    setting : Setting
        Where it drives, the meaning of its numbers, and what is to hold.
    start_error : tuple of float
        Half-widths of the box of starts: metres, metres, radians.
    goal_radius : float
        Metres.
    limits : MissionLimits
        How far, and in how many parts.
    arithmetic : str
        Contract of the bounds.
    seed : int
        Of the runs that are driven.
    """

    policy: Policy
    setting: Setting
    start_error: tuple[float, float, float]
    goal_radius: float
    limits: MissionLimits
    arithmetic: Arithmetic
    seed: int

    def __call__(self, scenarios: Sequence[Scenario]) -> tuple[Mission, ...]:
        """Return the missions of some scenarios."""
        return tuple(self.examine(scenario) for scenario in scenarios)

    def examine(self, scenario: Scenario) -> Mission:
        """Return the mission of one scenario."""
        begun = time.process_time()
        loop = ClosedLoop.of(self.policy, self.setting, scenario, self.arithmetic, episode=self.limits.steps)
        follower = MissionFollower(loop, self.goal_radius, self.limits)
        lower, upper = self.starts(scenario)
        driven = attack(follower, lower, upper, seed=self.seed)
        refuted = bool(len(driven.crashes) or len(driven.late))
        if refuted:  # whatever a proof would need to say of it
            follower = MissionFollower(loop, self.goal_radius, _NOT_FOLLOWED)
        proof = follower.prove(lower, upper)
        seconds = time.process_time() - begun
        return Mission(
            scenario,
            loop.rules.interval,
            proof,
            _paths(driven),
            driven.arrived,
            driven.crashes,
            late_run(driven),
            seconds,
        )

    def starts(self, scenario: Scenario) -> tuple[Floats, Floats]:
        """Return the ends of the states at the start, (3 + A,) each: the robot stands there."""
        axes = len(self.setting.rules.lower)
        pose, error = np.array(scenario.start), np.array(self.start_error)
        reach = error + SPARE * (np.abs(pose) + 1.0) * (error > 0.0)
        still = np.zeros(axes)
        return np.concatenate([pose - reach, still]), np.concatenate([pose + reach, still])


_NOT_FOLLOWED = MissionLimits(steps=1, finer=0)


def _paths(found: MissionRuns) -> Floats:
    """Return the places of runs until they arrive, (R, K + 1, 2); NaN afterwards."""
    runs = found.runs
    places = np.concatenate([runs.poses[:, :1, :2], runs.ends[:, :, :2]], axis=1)
    beyond = np.arange(places.shape[1]) > found.arrived[:, None]
    return np.where(beyond[:, :, None], np.nan, places)


@dataclass(frozen=True, eq=False)
class MissionWork(Work[Sequence[Scenario], tuple[Mission, ...]]):
    """The missions of some scenarios; a unit is one of them."""

    examination: MissionExamination
    scenarios: tuple[Scenario, ...]
    stage = "missions"

    def __len__(self) -> int:
        """Return the number of scenarios."""
        return len(self.scenarios)

    @property
    def function(self) -> MissionExamination:
        """Return what happens to each."""
        return self.examination

    def content(self, span: Span) -> Sequence[Scenario]:
        """Return some scenarios."""
        return self.scenarios[span.first : span.last]

    def at_once(self, workers: int) -> int:
        """Return one: a mission is long."""
        return 1

    def describe(self) -> Mapping[str, Any]:
        """Return everything that the findings depend on."""
        asked = self.examination
        policy, setting = asked.policy, asked.setting
        world_map, meaning = setting.world_map, setting.spec.model_dump_json()
        scenarios = [(one.start, one.goal, one.obstacles) for one in self.scenarios]
        return {
            "policy": policy.sha256,
            "network": digest_of((policy.network, policy.rewritten, meaning)),
            "map": digest_of((world_map.arena, world_map.obstacles)),
            "scenarios": digest_of(scenarios),
            "rules": setting.rules.to_json(),
            "radii": setting.radii.tolist(),
            "errors": dict(setting.uncertainty.premises()),
            "start error": list(asked.start_error),
            "goal radius": asked.goal_radius,
            "limits": asdict(asked.limits),
            "arithmetic": asked.arithmetic,
            "seed": asked.seed,
            **{f"version of {name}": text for name, text in result_versions().items()},
        }

    def to_arrays(self, part: tuple[Mission, ...]) -> Mapping[str, NDArray[Any]]:
        """Return missions as arrays, each with the place of its scenario."""
        places = {id(scenario): place for place, scenario in enumerate(self.scenarios)}
        names = {one.name: place for place, one in enumerate(self.scenarios)}
        found: dict[str, NDArray[Any]] = {}
        for mission in part:
            place = places.get(id(mission.scenario), names[mission.scenario.name])
            found |= {f"{place} {name}": array for name, array in mission.to_arrays().items()}
        return found

    def from_arrays(self, arrays: Mapping[str, NDArray[Any]]) -> tuple[Mission, ...]:
        """Return missions."""
        apart: dict[int, dict[str, NDArray[Any]]] = {}
        for key, array in arrays.items():
            place, _, name = key.partition(" ")
            apart.setdefault(int(place), {})[name] = array
        return tuple(Mission.from_arrays(self.scenarios[place], apart[place]) for place in sorted(apart))

    def join(self, parts: Sequence[tuple[Mission, ...]]) -> tuple[Mission, ...]:
        """Return all missions in the order of their scenarios."""
        return tuple(mission for part in parts for mission in part)
