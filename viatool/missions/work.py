"""Missions as work for the driver of long work: a unit is a scenario."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viatool.arrays import Floats
from viatool.errors import ConfigurationError
from viatool.loop.closed_loop import ClosedLoop
from viatool.loop.destination import Destination
from viatool.missions.arrival import destination_of, names_of_state
from viatool.missions.attack import MissionRuns, attack, attack_again
from viatool.missions.carried import CarriedFollower
from viatool.missions.follow import MissionFollower, MissionLimits, MissionProof, best
from viatool.missions.verdicts import Mission, late_run
from viatool.policy import Policy
from viatool.rounding import SPARE
from viatool.safety.nearest import describe_nearest
from viatool.schedule import Span, Work, digest_of
from viatool.sets.states import POSE
from viatool.setting.setting import Setting
from viatool.taylor import Arithmetic
from viatool.taylor.propagation import analyse
from viatool.versions import result_versions
from viatool.world import Scenario
from viatool.world.scenario import STATE

_log = logging.getLogger(__name__)


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
        """Return the mission of one scenario; its seconds begin when the program and its functions are known."""
        analyse(self.policy.network)
        begun = time.process_time()
        steps = self.steps(scenario)
        loop = ClosedLoop.of(self.policy, self.setting, scenario, self.arithmetic, episode=steps)
        follower = self.follower(loop, scenario)
        lower, upper = self.starts(scenario)
        driven = attack(follower, lower, upper, seed=self.seed)
        _log.info(
            "mission %s: %s",
            scenario.name,
            _next(driven, loop.rules.clearance.collision, refuted=driven.refuting),
        )
        if driven.refuting:  # whatever a proof would need to say of it
            follower = replace(follower, limits=replace(follower.limits, parts=1, finer=0), refuted=True)
        elif driven.disproves(loop.rules.clearance.collision):
            follower = replace(follower, limits=replace(follower.limits, finer=0))
        proof, driven = self._followed(follower, lower, upper, driven)
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
            self.task(scenario),
            (
                self.setting.rules.seconds_after(proof.earliest)[0],
                self.setting.rules.seconds_after(proof.steps)[1],
            ),
            driven.driven_arrival,
            self._nearest(scenario, driven),
            driven.flawless,
        )

    def _followed(
        self, follower: MissionFollower, lower: Floats, upper: Floats, driven: MissionRuns
    ) -> tuple[MissionProof, MissionRuns]:
        """Follow every run, and attack once more before what is not proved is tried in finer cells."""
        attempts = replace(follower, attained=driven.attained).attempts(lower, upper)
        proof = next(attempts)
        if proof.proved or driven.refuting:
            return best(chain([proof], attempts)), driven
        driven = attack_again(follower, lower, upper, driven, seed=self.seed)
        return (proof if driven.refuting else best(chain([proof], attempts))), driven

    def _nearest(self, scenario: Scenario, driven: MissionRuns) -> str:
        """Return what the run comes near to that collides, in words; nothing without one."""
        if not len(driven.crashes):
            return ""
        setting = self.setting
        return describe_nearest(setting.world_map, scenario, driven.crashes.place[0], setting.rules.footprint)

    def follower(self, loop: ClosedLoop, scenario: Scenario) -> MissionFollower:
        """Return who follows the runs of a scenario: of robots whose motion has a state, in forms of their starts."""
        kind = CarriedFollower if loop.rules.kinematics.state else MissionFollower
        limits = replace(self.limits, steps=self.steps(scenario))
        return kind(loop, self.goal_radius, limits, self.destination(scenario))

    def steps(self, scenario: Scenario) -> int:
        """Return within how many intervals, or after how many, every run has to arrive."""
        if scenario.deadline is None:
            return self.limits.steps
        return self.setting.rules.intervals_within(scenario.deadline)

    def destination(self, scenario: Scenario) -> Destination:
        """Return where every run has to arrive."""
        return destination_of(scenario, self.setting, self.goal_radius)

    def starts(self, scenario: Scenario) -> tuple[Floats, Floats]:
        """Return the ends of the states at the start, (3 + K,) each: where nothing else is said, the robot stands."""
        move, behind = self.setting.rules.kinematics, len(self.setting.rules.carried)
        least, most = move.state_range if move.state else (np.zeros(behind),) * 2
        still = np.clip(0.0, least, most)
        if scenario.starts is not None:
            ends = scenario.starts.ends(names_of_state(self.setting))
            rest = np.concatenate([scenario.start, still])
            lower, upper = (np.where(np.isfinite(end), end, rest) for end in ends)
            return lower, upper
        pose, error = np.array(scenario.start), np.array(self.start_error)
        reach = error + SPARE * (np.abs(pose) + 1.0) * (error > 0.0)
        return np.concatenate([pose - reach, still]), np.concatenate([pose + reach, still])

    def task(self, scenario: Scenario) -> str:
        """Return in words where runs arrive, and when."""
        place = f"nearer to the goal than {self.goal_radius:g} m"
        if scenario.region is not None:
            place = scenario.region.words()
        seconds = self.setting.rules.seconds_after(self.steps(scenario))[1]
        return f"{place} at the end of an interval, {scenario.arrive} {seconds:g} s"

    def check(self, scenario: Scenario) -> None:
        """Refuse a scenario that asks for what the robot's sets do not hold, or for no whole intervals.

        Raises
        ------
        ConfigurationError
            Names it.
        """
        interval, names = self.setting.rules.interval, names_of_state(self.setting)
        for what, box in (("start", scenario.starts), ("goal", scenario.region)):
            asked = [] if box is None else [(name, *box.ends((name,))[:, 0].tolist()) for name in STATE]
            for name, low, high in asked:
                at_rest = what == "start" and low == high == 0.0
                if name in names[3:] and (low, high) != (-math.inf, math.inf):
                    self._require_followed(scenario, what, name, low, high)
                if name in names or (low, high) == (-math.inf, math.inf) or at_rest:
                    continue
                raise ConfigurationError(
                    f"the {what} of scenario '{scenario.name}' limits {name}, which the state of a "
                    f"{self.setting.rules.kinematics.description} does not hold ({', '.join(names)})",
                    "leave it out, or null",
                )
        if scenario.starts is not None and any(self.start_error):
            raise ConfigurationError(
                f"scenario '{scenario.name}' has a box of starts, and a start error was given as well",
                "leave --start-error out",
            )
        if scenario.deadline is None:
            return
        whole = scenario.deadline / interval
        least, most = self.setting.rules.seconds_after(1)
        if scenario.arrive == "at" and least < most:
            raise ConfigurationError(
                f"scenario '{scenario.name}' is to be arrived at after {scenario.deadline:g} s, and intervals of "
                f"{least:g} to {most:g} s need not end then",
                "let it arrive within the deadline, or leave out the section timing",
            )
        late = scenario.arrive == "at" and abs(whole - round(whole)) > 1e-6
        if late or not 1 <= self.steps(scenario) <= 1000:
            raise ConfigurationError(
                f"the deadline of scenario '{scenario.name}' is {scenario.deadline:g} s, expected a whole number of "
                f"control intervals of {interval:g} s, at most a thousand of them",
                "correct the deadline, or give another --interval",
            )

    def _require_followed(self, scenario: Scenario, what: str, name: str, low: float, high: float) -> None:
        """Refuse speeds that are not followed where robots do not have the one that they are told to have.

        Goals limit none of them, and runs begin with one that the robot may be told to have.
        """
        rules = self.setting.rules
        if rules.over_time is None:
            return
        place = names_of_state(self.setting).index(name) - len(POSE)
        if what == "start" and not rules.lower[place] <= low <= high <= rules.upper[place]:
            raise ConfigurationError(
                f"the start of scenario '{scenario.name}' has {name} from {low:g} to {high:g}, and the robot is told "
                f"{rules.lower[place]:g} to {rules.upper[place]:g}",
                "let it begin within these",
            )
        if what == "goal":
            raise ConfigurationError(
                f"the goal of scenario '{scenario.name}' limits {name}, which is not what was commanded where motors "
                "and timing are those of an error model",
                "leave it out, or null, or leave out the sections actuation and timing",
            )


def _next(driven: MissionRuns, distance: float, *, refuted: bool) -> str:
    """Return what was found by driving, and what is tried for that reason."""
    runs = f"{len(driven.arrived)} runs driven"
    if refuted:
        return f"{runs}, one fails: no proof is tried"
    if driven.disproves(distance):
        return f"{runs}, one comes too near between its instants: a proof is tried once"
    return f"{runs}, none fails: a proof is tried"


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
        scenarios = [
            (
                one.start,
                one.goal,
                one.region,
                one.obstacles,
                asked.task(one),
                [end.tolist() for end in asked.starts(one)],
            )
            for one in self.scenarios
        ]
        return {
            "policy": policy.sha256,
            "network": digest_of((policy.network, policy.rewritten, meaning)),
            "map": digest_of((world_map.arena, world_map.obstacles)),
            "scenarios": digest_of(scenarios),
            "rules": setting.rules.to_json(),
            "radii": setting.radii.tolist(),
            "errors": setting.uncertainty.exactly(),
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
