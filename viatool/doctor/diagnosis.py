"""The job of ``viatool doctor``: to tell whether a specification is right."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from viatool.channels import Extent
from viatool.doctor.course import Course
from viatool.doctor.edits import Edit, edits
from viatool.doctor.interpretation import Background
from viatool.doctor.recorded import Commander, RecordedBag, RecordedTable
from viatool.doctor.search import Examine, Examined, Ranking, Repeat, rank
from viatool.errors import PolicyError, TrajectoryError
from viatool.policy import Policy
from viatool.policy.specified import specification_of
from viatool.schedule import NEVER, Deadline, Progress, ignore, open_scheduler
from viatool.setting.asked import Asked
from viatool.setting.premises import Premise
from viatool.setting.received import as_received
from viatool.setting.setting import Setting
from viatool.setting.wishes import Wishes
from viatool.simulate import Drive
from viatool.trajectory import BagSettings, Trajectory, is_bag, load_trajectory
from viatool.world import Scenario, WorldMap

_MORE = 4
"""Times as many scenarios on which a reading that may be better is driven again, beside the specification."""

StrPath = str | os.PathLike[str]
Verdict = Literal["specified", "another", "undecided", "none"]
"""The specification does as well as any reading, and well; another one is clearly better; another one seems better; no
reading does well."""


@dataclass(frozen=True, eq=False)
class Diagnosis(Asked):
    """What was found of a specification.

    Parameters
    ----------
    policy : Policy
        With the specification that was examined.
    setting : Setting
        Where.
    ranking : Ranking
        Of all readings that were tried.
    source : str
        What they were tried on, in words.
    seed : int
        Of scenarios and noise.
    seconds : float
        Wall time.
    drives : tuple of Drive
        Those of the specification and of the best reading, to be drawn; none of a recording.
    """

    policy: Policy
    setting: Setting
    ranking: Ranking
    source: str
    seed: int
    seconds: float
    drives: tuple[Drive, ...] = ()

    @property
    def premises(self) -> tuple[Premise, ...]:
        """Return what took effect, and who said so."""
        return self.setting.driving_premises

    @property
    def verdict(self) -> Verdict:
        """Return what was found."""
        ranking = self.ranking
        if ranking.is_clear:
            return "another"
        if ranking.best is not ranking.specified:
            return "undecided"
        return "specified" if ranking.specified.evidence.is_good else "none"

    @property
    def edits(self) -> tuple[Edit, ...]:
        """Return what to change in the specification so that it says what the best reading does."""
        return self.edits_of(self.ranking.best)

    def edits_of(self, one: Examined) -> tuple[Edit, ...]:
        """Return what to change in the specification so that it says what a reading does."""
        return edits(self.setting.spec, one.interpretation.spec)


def diagnose(
    policy: Policy,
    world_map: WorldMap,
    scenarios: Sequence[Scenario] = (),
    *,
    trajectory: Trajectory | StrPath | None = None,
    bag: BagSettings | None = None,
    wishes: Wishes | None = None,
    noise: float | None = None,
    horizon: int | None = None,
    time_limit: float | None = None,
    seed: int = 0,
    workers: int | Literal["auto"] = 1,
    until: Deadline = NEVER,
    progress: Progress = ignore,
) -> Diagnosis:
    """Try other readings of a policy's specification.

    Parameters
    ----------
    policy : Policy
        With a specification.
    world_map : WorldMap
        Where it drives, or drove.
    scenarios : sequence of Scenario
        What it is driven through under each reading.
    trajectory : Trajectory or path, optional
        Recorded observations and commands that are compared instead.
    bag : BagSettings, optional
        Goal, topics and frame where that is a bag.
    wishes : Wishes, optional
        What counts instead of what policy and map say; where their LiDARs differ the policy's counts unless it is said.
    noise : float, optional
        Of the LiDAR, in metres; None is the map's.
    horizon : int, optional
        Most steps of an episode; None is the task's.
    time_limit : float, optional
        The same in seconds of simulated time.
    seed : int
        Of the noise.
    workers : int or "auto"
        Processes that share the readings; they change nothing but the time.
    until : Deadline
        After which no reading with more than one change is begun.
    progress : Progress
        Told how many readings have been examined.

    Raises
    ------
    PolicyError
        If the policy has no specification, or observes what cannot be simulated.
    ConfigurationError
        If policy and map contradict each other.
    TrajectoryError
        If a recording does not fit the policy, or has no commands.
    EmptyEvaluationError
        If there is nothing to compare.
    """
    started = time.perf_counter()
    wishes = wishes or Wishes()
    wishes = replace(wishes, prefer={"lidar": "policy", **wishes.prefer})
    course = Course(policy, world_map, tuple(scenarios), wishes, noise, seed, horizon)
    setting = course.setting(specification_of(policy))
    if time_limit is not None:
        course = replace(course, horizon=setting.rules.intervals_within(time_limit))
    around = Background(setting.robot, Extent(*setting.world_map.bounds))
    examine: Examine = course
    source = f"{len(course.scenarios):,} scenarios, seed {seed}"
    if trajectory is not None:
        examine, source = _recorded(policy, setting, trajectory, bag)
    scheduler = open_scheduler(workers)
    ranking = rank(setting.spec, examine, around, scheduler, progress, until)
    contender = ranking.contender
    draws = world_map.generator if trajectory is None and not ranking.is_clear else None
    if contender is not None and draws is not None:
        fresh = draws.draw(_MORE * len(course.scenarios), seed + 1)
        again = replace(course, scenarios=fresh)
        found = [again(one.interpretation.spec) for one in (contender, ranking.specified)]
        ranking = replace(ranking, again=Repeat(contender, *found))
    shown = dict.fromkeys([ranking.specified, ranking.best]) if trajectory is None else {}
    drives = tuple(course.drive(one.interpretation.spec) for one in shown)
    return Diagnosis(policy, setting, ranking, source, seed, time.perf_counter() - started, drives)


def _recorded(
    policy: Policy, setting: Setting, trajectory: Trajectory | StrPath, bag: BagSettings | None
) -> tuple[Examine, str]:
    """Return what compares a recording with the policy under a specification, and what it is in words."""
    if setting.spec.memory:
        raise PolicyError(
            f"the policy remembers ({', '.join(setting.spec.memory)}), and what it remembered was another under each "
            "reading of its numbers",
            "leave --trajectory out and drive it",
        )
    commander = Commander(policy, setting.rules.kinematics, setting.robot)
    told = "given as arrays"
    if isinstance(trajectory, (str, os.PathLike)):
        told, path = f"read from {os.fspath(trajectory)}", Path(trajectory)
        if is_bag(path):
            scans = RecordedBag.of(commander, setting.spec, path, bag or BagSettings())
            return scans, f"{len(scans.time):,} scans {told}"
        trajectory = load_trajectory(path, setting.spec)
    states = as_received(setting, trajectory)
    commands = commander.of_actions(setting.spec, states.actions)
    axes = commander.axes
    if commands.shape[1] != len(axes):
        raise TrajectoryError(
            f"the trajectory has {commands.shape[1]} numbers for each command, the robot takes {len(axes)} "
            f"({', '.join(axis.name for axis in axes)})",
            "record what was commanded beside what was observed, or leave --trajectory out and drive",
        )
    return RecordedTable(
        commander, setting.spec, states.observations, commands
    ), f"{len(states):,} states {told}"
