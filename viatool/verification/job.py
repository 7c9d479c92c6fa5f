"""The main job: policy, map, states and uncertainty give verdicts."""

from __future__ import annotations

import logging
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np

from viatool.errors import ConfigurationError
from viatool.loop.elapsed import check_moving_on
from viatool.loop.horizon import Horizon
from viatool.loop.knowable import require_known_over_poses
from viatool.policy import Policy, PolicySpecification, as_policy
from viatool.schedule import Campaign, Progress, Scheduler, ignore, open_scheduler
from viatool.setting.error_costs import cost_of_errors
from viatool.setting.received import as_received
from viatool.setting.setting import Setting
from viatool.setting.wishes import Wishes
from viatool.simulate import Places
from viatool.taylor import Arithmetic, Refinement, engine_of
from viatool.taylor.approximation import Approximation
from viatool.trajectory import BagSettings, Trajectory
from viatool.uncertainty import ErrorModel, as_error_model
from viatool.verification.beside import examine_beside
from viatool.verification.campaign import StateWork
from viatool.verification.clock import Clock
from viatool.verification.close import CLOSE, MOST
from viatool.verification.examination import StateExamination
from viatool.verification.horizon import HorizonExamination
from viatool.verification.reasoning import find_reasons
from viatool.verification.rejudging import Rejudging
from viatool.verification.result import Result
from viatool.verification.so_far import Enough, JudgedCount, unjudged_of
from viatool.verification.source import Source
from viatool.verification.states import states_of
from viatool.versions import result_versions
from viatool.world import Footprint, Scenario, WorldMap, as_map

_log = logging.getLogger(__name__)

StrPath = str | os.PathLike[str]

_BOUNDED = 20_000
"""States whose actions are bounded in any case, about, to tell how wide they are."""


def verify(
    policy: Policy | StrPath,
    world_map: WorldMap | StrPath,
    *,
    eps: float | Mapping[str, float] | None = None,
    errors: ErrorModel | StrPath | None = None,
    trajectory: Trajectory | StrPath | None = None,
    bag: BagSettings | None = None,
    places: Places | None = None,
    scenarios: Sequence[Scenario] | None = None,
    spec: PolicySpecification | StrPath | None = None,
    criterion: str = "swept",
    order: int = 1,
    approximation: Approximation = "chebyshev",
    refine: Refinement = "monotone",
    arithmetic: Arithmetic = "float32",
    clearance: float | None = None,
    danger: float | None = None,
    interval: float | None = None,
    footprint: Footprint | str | float | Sequence[Sequence[float]] | None = None,
    delay: float = 0.0,
    robot: str | None = None,
    prefer: Mapping[str, str] | None = None,
    horizon: Horizon | int | None = None,
    only_contested: bool = False,
    widths: bool = False,
    explain_errors: bool = False,
    noise: float | None = None,
    seed: int = 0,
    close: int = CLOSE,
    workers: int | Literal["auto"] = 1,
    scheduler: Scheduler | str | None = None,
    chunk: int | None = None,
    checkpoint: StrPath | None = None,
    resume: bool = False,
    progress: Progress | None = None,
    enough: Enough | None = None,
) -> Result:
    """Verify a policy on a map: no sensor error within bounds makes it come too close to something.

    Parameters
    ----------
    policy : Policy or path
        An ONNX policy; its network is checked against onnxruntime when it is loaded.
    world_map : WorldMap or path
        The map, its robot and clearances.
    eps : float or mapping, optional
        Sensor error: one radius for every observation channel, or radii by channel (``""``: all others); channels that
        are given none take the specification's.
    errors : ErrorModel or path, optional
        What else is bounded about the robot; terms that are not taken into account are refused by name.
    trajectory : Trajectory or path, optional
        Recorded states; by default the policy is driven through `scenarios`.
    bag : BagSettings, optional
        Goal, topics and frame when `trajectory` is the path of a ROS bag.
    places : Places, optional
        Verify poses spread over the free space, with the goals of `scenarios`, instead of driven states.
    scenarios : sequence of Scenario, optional
        What to drive; by default the map's fixed scenarios.
    spec : PolicySpecification or path, optional
        Specification of a policy that carries none.
    criterion : str
        "swept", "sampled" or "braking".
    order, approximation, refine, arithmetic
        Settings of `viatool.reach`.
    clearance, danger : float, optional
        d_col and d_danger in metres instead of the map's.
    interval : float, optional
        Control interval in seconds instead of the robot's.
    footprint : optional
        "point", a radius in metres or the corners of a polygon, instead of the robot's.
    delay : float
        Dead time in seconds: the previous commands go on for this long before the new one acts.
    robot : str, optional
        A robot that is known by name, with its limits, instead of the map's.
    prefer : mapping, optional
        Which counts, "policy" or "map", where they contradict each other in "interval", "limits" or "lidar" (``""``: in
        anything); without it they must agree.
    horizon : Horizon or int, optional
        Follow the closed loop from every state over so many control intervals; see `viatool.safety.Horizon`.
    only_contested : bool
        Bound the actions only of states that geometry alone does not settle; the others have NaN bounds. Of a very
        large network in any case (`bounded` in `Result.engine`); bounds of a large one are `refined` only where a
        verdict depends on it.
    widths : bool
        Bound the actions of every state, however many there are. Of more than 20,000 those of contested ones are
        bounded, and of an even sample, of which widths are reported; the others have NaN bounds.
    explain_errors : bool
        Judge the states that are not proved again without each error in turn, to tell what it costs.
    noise, seed
        Of the simulated sensor; the seed is that of close places and of the search for counterexamples, too.
    close : int
        So many places beside the driven path are examined as well, see `Result.close`; 0 for none.
    workers : int or "auto"
        Processes that work on the states; "auto" takes one for each core.
    scheduler : Scheduler or str, optional
        The address of a Dask scheduler instead, such as ``tcp://host:8786``.
    chunk : int, optional
        States that a worker gets at once. The result does not depend on it, nor on the workers.
    checkpoint : path, optional
        Folder that keeps finished chunks.
    resume : bool
        Continue from the finished chunks in `checkpoint`.
    progress : callable, optional
        Called with the stage, the units done and the units in all.
    enough : callable, optional
        Called after each block of states with what is known, a `viatool.verification.so_far.SoFar`; once it is true the
        states behind are not judged, and the result is of those before, see `Result.unjudged`.

    Returns
    -------
    Result
        Verdicts and rates.

    Raises
    ------
    PolicyError
        If the policy cannot be read, or has no specification with a linear and an angular action.
    MapError, TrajectoryError
        If the map or the trajectory cannot be read, or the trajectory does not fit the policy.
    ConfigurationError
        If an option is out of its range.
    EmptyEvaluationError
        If there is no state to evaluate.
    WorkError
        If workers died over a chunk, or the cluster was lost.

    Notes
    -----
    Sound: every state called safe is safe under the assumptions that `Result.assumptions` lists.
    """
    if not 0 <= close <= MOST:
        raise ConfigurationError(f"{close} close places", f"ask for 0 to {MOST:,}")
    if resume and checkpoint is None:
        raise ConfigurationError("nothing is there to resume from", "give the folder with --checkpoint")
    wishes = Wishes(
        criterion,
        clearance,
        danger,
        interval,
        footprint,
        delay,
        robot=robot,
        prefer=prefer or {},
        errors=as_error_model(errors),
    )
    source = Source(trajectory, bag, places, noise, seed)
    clock = Clock()
    if scheduler is None or isinstance(scheduler, str):
        scheduler = open_scheduler(workers, scheduler)
    with clock.timed("load"):
        policy = as_policy(policy, spec)
        world_map = as_map(world_map)
        job = "verify" if horizon is None else "verify with a horizon"
        setting = Setting.of(policy, world_map, eps, wishes, scenarios, job=job)
        if horizon is not None:
            horizon = Horizon(horizon) if isinstance(horizon, int) else horizon
            horizon = horizon.beginning(setting.uncertainty)
            check_moving_on(setting, require_known_over_poses(setting))
    with clock.timed("trajectory"):
        trajectory = as_received(setting, source.states(policy, setting))
        if setting.pose_radii.any() and "goal" in setting.quantities.needs:
            setting.goals(trajectory.scenarios)  # refuses episodes without one
        asked = states_of(setting, trajectory, followed=horizon is not None)
        recording = source.compared(setting, trajectory)
    engine: dict[str, Any] = {"order": order, "approximation": approximation, "refine": refine}
    commanding = setting.commanding(policy)
    beyond = None if horizon is None else HorizonExamination(commanding, setting.bare(), horizon, arithmetic)
    examination = StateExamination.of(
        commanding,
        setting,
        {**engine, "arithmetic": arithmetic},
        only_contested=only_contested,
        seed=seed,
        horizon=beyond,
        bounded_every=1 if widths else max(1, len(asked) // _BOUNDED),
    )
    if len(examination.efforts) > 1:
        engine["refined"] = "where a verdict depends on it"
    engine["passes"] = engine_of(commanding.network)
    if examination.bounded_every > 1:
        engine["bounded"] = (
            f"contested states, and of all one in {examination.bounded_every:,} for the widths"
        )
    elif not examination.bounded_every:
        engine["bounded"] = "contested states alone"
    _log.info("engine: %s", ", ".join(f"{name} {value}" for name, value in engine.items()))
    _log.info("states: %d from %s", len(asked), source.words(setting))
    outcome = trajectory.outcomes[trajectory.episode]
    campaign = Campaign(scheduler, checkpoint, resume, chunk if enough is None else 1)
    with clock.timed("examine"):
        work = StateWork(examination, asked, result_versions())
        watch = None if enough is None else JudgedCount(outcome, enough)
        findings = campaign.carry_out(work, progress or ignore, enough=watch).part
    clock.share_out("examine", findings.seconds)
    judged = len(findings.judgement.safe)
    again = Rejudging(policy, world_map, scenarios, setting, wishes, job, trajectory, examination)
    costs = None
    if explain_errors:
        with clock.timed("explain"):
            costs = cost_of_errors(setting, wishes, findings.judgement.safe, again.ask, again.proved)
    with clock.timed("reasons"):
        reasons = find_reasons(again, asked, findings)
    result = Result(
        policy_path=policy.path,
        policy_sha256=policy.sha256,
        setting=setting,
        trajectory=trajectory if judged == len(asked) else trajectory.select(np.arange(judged)),
        arithmetic=arithmetic,
        engine=engine,
        under_way=asked.under_way[:judged],
        velocity=None if asked.velocity is None else asked.velocity[:judged],
        begun=asked.begun[:judged],
        reachable=findings.reachable,
        bounded_every=examination.bounded_every,
        contested=findings.contested,
        judgement=findings.judgement,
        witnesses=findings.witnesses,
        seconds=clock.seconds,
        versions=result_versions(),
        origin=source.words(setting),
        maps=policy.maps,
        horizon=findings.over(horizon),
        recording=recording,
        error_costs=costs,
        reasons=reasons,
        unjudged={} if judged == len(asked) else unjudged_of(outcome[judged:]),
    )
    with clock.timed("close"):
        result = examine_beside(result, again, close, campaign, progress or ignore)
    return replace(result, seconds=clock.seconds)
