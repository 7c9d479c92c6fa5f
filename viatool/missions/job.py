"""The job of ``viatool mission``: policy, map, starts and uncertainty give a verdict for each whole run."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace

import numpy as np

from viatool.errors import ConfigurationError
from viatool.loop.closed_loop import ClosedLoop
from viatool.loop.elapsed import check_moving_on
from viatool.loop.told import told_of_time
from viatool.missions.explaining import with_needs
from viatool.missions.follow import MissionLimits
from viatool.missions.so_far import Enough, MissionsKnown
from viatool.missions.verdicts import Mission, Missions
from viatool.missions.work import MissionExamination, MissionWork
from viatool.policy import Policy, PolicySpecification, as_policy
from viatool.schedule import NEVER, Campaign, CutShort, Deadline, Progress, digest_of, ignore
from viatool.setting.criteria import PROVING
from viatool.setting.error_costs import drop_each
from viatool.setting.rules import Rules
from viatool.setting.setting import Setting
from viatool.setting.wishes import Wishes
from viatool.simulate import NavigationTask
from viatool.taylor import Arithmetic
from viatool.uncertainty import ErrorModel, as_error_model
from viatool.versions import result_versions
from viatool.world import Footprint, Scenario, Scenes, WorldMap, as_map

StrPath = str | os.PathLike[str]

_INTERRUPTED = "the run was interrupted before it was done"
_AFTERWARDS = 0.4
"""Of a budget in seconds, that is left for examining missions again without errors, where that is asked."""


def mission(
    policy: Policy | StrPath,
    world_map: WorldMap | StrPath,
    *,
    eps: float | Mapping[str, float] | None = None,
    start_error: tuple[float, float] | tuple[float, float, float] = (0.0, 0.0),
    scenarios: Sequence[Scenario] | None = None,
    errors: ErrorModel | StrPath | None = None,
    spec: PolicySpecification | StrPath | None = None,
    criterion: str = "swept",
    arithmetic: Arithmetic = "float32",
    time_limit: float | None = None,
    goal_radius: float | None = None,
    limits: MissionLimits | None = None,
    clearance: float | None = None,
    deceleration: float | None = None,
    interval: float | None = None,
    footprint: Footprint | str | float | Sequence[Sequence[float]] | None = None,
    robot: str | None = None,
    prefer: Mapping[str, str] | None = None,
    explain_errors: bool = False,
    keep_interrupted: bool = False,
    campaign: Campaign | None = None,
    until: Deadline = NEVER,
    seed: int = 0,
    progress: Progress | None = None,
    enough: Enough | None = None,
) -> Missions:
    """Prove or refute that every run reaches its goal and keeps its clearance on the way.

    Parameters
    ----------
    policy : Policy or path
        An ONNX policy.
    world_map : WorldMap or path
        The map, its robot and clearances.
    eps : float or mapping, optional
        Sensor error, in each interval anew: one radius for every channel, or radii by channel.
    start_error : tuple of float
        By how much starts may be off: metres and radians, or metres in x, metres in y and radians.
    scenarios : sequence of Scenario, optional
        What is driven; by default the map's fixed ones.
    errors : ErrorModel or path, optional
        What else is bounded about the robot; terms that are not taken into account are refused by name.
    spec : PolicySpecification or path, optional
        Of a policy that carries none.
    criterion : str
        "swept" or "braking".
    arithmetic : str
        As in `viatool.reach`.
    time_limit : float, optional
        Seconds within which every run has to arrive; by default those of a simulated episode.
    goal_radius : float, optional
        Metres; by default as in simulation.
    limits : MissionLimits, optional
        In how many parts, and in which cells; its steps are those of the time limit.
    clearance, deceleration, interval, footprint, robot, prefer
        Instead of what map and robot say, as in `viatool.verify`.
    keep_interrupted : bool
        Whether a Ctrl-C leaves the missions that are done by then, the others unknown, instead of nothing.
    explain_errors : bool
        Also find out which errors missions take that are not proved: examine them again without all of them and, where
        that proves them, without each.
    campaign : Campaign, optional
        Who does the work, and where finished missions are kept.
    until : Deadline
        When to stop; missions that are not done then, or a tenth of the budget later, are unknown.
    seed : int
        Of the runs that are driven against the missions.
    progress : callable, optional
        Called with the stage, the units done and the units in all.
    enough : callable, optional
        Called after each mission with what is known, a `viatool.missions.so_far.MissionsKnown`; once it is true the
        missions behind are not judged, see `Missions.unjudged`.

    Returns
    -------
    Missions
        One for each scenario that was judged.

    Raises
    ------
    ConfigurationError
        If an option is out of its range, or a start collides, lies off the map, or is in the goal.
    PolicyError
        If the policy cannot be read, or what it observes is not known over sets of poses.

    Notes
    -----
    Sound: every run of a proved mission, from any pose of the box of starts at rest, with observations within eps of
    what perfect sensors read in each interval, keeps more than the collision distance at every instant until it
    arrives, and arrives by the time that the mission states, under what the report lists as assumed.
    """
    begun = time.perf_counter()
    if criterion not in PROVING:
        raise ConfigurationError(f"criterion '{criterion}' proves nothing", f"choose {' or '.join(PROVING)}")
    policy = as_policy(policy, spec)
    world_map = as_map(world_map)
    model = as_error_model(errors)
    wishes = Wishes(
        criterion, clearance, None, interval, footprint, 0.0, deceleration, robot, prefer or {}, model
    )
    setting = Setting.of(policy, world_map, eps, wishes, scenarios, job="mission")
    chosen = setting.scenarios
    if not chosen:
        raise ConfigurationError(
            f"map '{world_map.path}' has no scenarios",
            "draw some with --scenarios N, or give --start and --goal",
        )
    if time_limit is not None and any(one.deadline is not None for one in chosen):
        raise ConfigurationError(
            f"a time limit of {time_limit:g} s was given, and scenarios of map '{world_map.path}' have a deadline",
            "leave one of them out",
        )
    task = NavigationTask()
    radius = task.goal_radius if goal_radius is None else goal_radius
    if not 0.0 < radius < math.inf:
        raise ConfigurationError(f"the goal radius is {radius} m", "give a positive distance in metres")
    limits = _limits(limits or MissionLimits(task.horizon), time_limit, setting.rules, task.horizon)
    timed = any(one.deadline is not None for one in chosen)
    counted = "to the deadline of each mission" if timed else f"from the {limits.steps} of the mission"
    setting = told_of_time(setting, f"counted down {counted}")
    error = _start_error(start_error, model)
    examination = MissionExamination(policy, setting.bare(), error, radius, limits, arithmetic, seed)
    _check_names(chosen)
    _check_starts(examination, setting, chosen)
    # refuses what cannot be enclosed, before any work
    loop = ClosedLoop.of(policy, setting, chosen[0], arithmetic, episode=limits.steps)
    check_moving_on(setting, loop.sensors.quantities)
    campaign, tell = campaign or Campaign(), progress or ignore
    first = until.moved(-_AFTERWARDS) if explain_errors else until
    interrupted, why = False, {}

    def certain(judged: Sequence[Mission]) -> bool:
        return enough is not None and enough(MissionsKnown.of(judged, len(chosen)))

    work = MissionWork(examination, chosen)
    try:
        found = campaign.carry_out(
            work, tell, until=first, enough=lambda parts: certain([one for part in parts for one in part])
        )
    except CutShort as cut:
        if not (keep_interrupted and cut.found.units):
            raise
        found, interrupted, why = cut.found, True, {"reason": _INTERRUPTED}
    rest = chosen[len(found.part) :]
    unjudged = rest if found.part and certain(found.part) else ()
    missions: tuple[Mission, ...] = found.part
    if not unjudged:
        missions += tuple(Mission.not_begun(one, setting, examination.task(one), **why) for one in rest)
    if explain_errors and not interrupted:

        def ask(wished: Wishes, radii: Mapping[str, float]) -> Setting:
            other = Setting.of(policy, world_map, radii, wished, chosen, job="mission")
            return told_of_time(other, f"counted down {counted}")

        without = drop_each(setting, wishes, ask)
        missions = with_needs(missions, examination, without, campaign, tell, until=until)
    seconds = {
        "missions": sum(one.seconds for one in missions),
        "total": time.perf_counter() - begun,
    }
    return Missions(
        policy,
        setting,
        missions,
        error,
        limits,
        radius,
        arithmetic,
        seed,
        seconds,
        result_versions(),
        interrupted,
        unjudged,
    )


def _limits(limits: MissionLimits, time_limit: float | None, rules: Rules, usual: int) -> MissionLimits:
    """Return the limits with the time limit in intervals that are surely over by then."""
    if time_limit is None:
        return replace(limits, steps=limits.steps or usual)
    interval = rules.seconds_after(1)[1]
    if not interval <= time_limit <= 1000 * interval:
        raise ConfigurationError(
            f"the time limit is {time_limit} s, expected one to a thousand control intervals of {interval:g} s",
            "give the seconds of simulated time within which every run has to arrive",
        )
    return replace(limits, steps=rules.intervals_within(time_limit))


def _start_error(given: Sequence[float], model: ErrorModel) -> tuple[float, float, float]:
    """Return the half-widths of the box of starts, of the option or of the error model."""
    values = [float(value) for value in given]
    if len(values) == 2:
        values = [values[0], values[0], values[1]]
    stated = [model.start.x or 0.0, model.start.y or 0.0, model.start.theta or 0.0]
    if any(stated) and any(values) and stated != values:
        raise ConfigurationError(
            f"{model.source}: start is {stated}, the start error that was given is {values}",
            "leave one of them out",
        )
    values = stated if any(stated) else values
    if len(values) != 3 or not all(0.0 <= value < math.inf for value in values):
        raise ConfigurationError(f"the start error is {given}", "give metres and radians, such as 0.02,0.02")
    return values[0], values[1], values[2]


def _check_names(scenarios: Sequence[Scenario]) -> None:
    """Refuse different scenarios of one name: tubes, witnesses and checkpoints tell them apart by it."""
    found: dict[str, str] = {}
    for number, one in enumerate(scenarios):
        content = digest_of(tuple(getattr(one, each.name) for each in fields(Scenario)))
        if found.setdefault(one.name, content) != content:
            raise ConfigurationError(
                f"scenario {number}, counted from 0, is called '{one.name}' as another one is",
                "give every scenario its own name",
            )


def _check_starts(examination: MissionExamination, setting: Setting, scenarios: Sequence[Scenario]) -> None:
    """Refuse a start that collides, lies off the map, or has arrived."""
    scenes = Scenes.of(setting.world_map, scenarios)
    poses = np.array([scenario.start for scenario in scenarios])
    left = scenes.footprint_clearance(poses, setting.rules.footprint, np.arange(len(poses)))
    limit = setting.rules.clearance.collision
    for scenario, room in zip(scenarios, left.tolist(), strict=True):
        examination.check(scenario)
        x, y, _ = scenario.start
        if not room > limit:
            raise ConfigurationError(
                f"scenario '{scenario.name}' starts at ({x:g}, {y:g}), {room:.3f} m from an obstacle or the edge of "
                f"the map, expected more than {limit:g} m",
                "move the start, or give another --clearance",
            )
        destination, (lower, upper) = examination.destination(scenario), examination.starts(scenario)
        place = "in" if scenario.region else f"within {examination.goal_radius:g} m of"
        if not destination.deadline_only and destination.holds(0.5 * (lower + upper)):
            raise ConfigurationError(
                f"scenario '{scenario.name}' starts {place} its goal, where it has arrived",
                "move the start or the goal, or give a smaller --goal-radius",
            )
