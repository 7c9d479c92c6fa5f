"""The main job: policy, map, states and uncertainty give verdicts."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal, Protocol

from viatool.errors import ConfigurationError
from viatool.loop.horizon import Horizon
from viatool.policy import Policy, PolicySpecification, load_policy
from viatool.schedule import Scheduler, open_scheduler
from viatool.setting.layout import Layout
from viatool.setting.rules import Rules
from viatool.simulate import Places, observe_places, roll_out
from viatool.taylor import Arithmetic, Refinement
from viatool.taylor.approximation import Approximation
from viatool.trajectory import BagSettings, Trajectory, load_trajectory
from viatool.verification.campaign import Campaign
from viatool.verification.clock import Clock
from viatool.verification.examination import Examination
from viatool.verification.horizon import HorizonQuestion
from viatool.verification.result import Result
from viatool.verification.states import States
from viatool.versions import result_versions
from viatool.world import Footprint, Scenario, WorldMap, load_map

StrPath = str | os.PathLike[str]


class Progress(Protocol):
    """Told how far a stage has come."""

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Note that `done` of `total` units of `stage` are finished."""


def verify(
    policy: Policy | StrPath,
    world_map: WorldMap | StrPath,
    *,
    eps: float | Mapping[str, float],
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
    horizon: Horizon | int | None = None,
    only_contested: bool = False,
    noise: float | None = None,
    seed: int = 0,
    workers: int | Literal["auto"] = 1,
    scheduler: Scheduler | str | None = None,
    chunk: int | None = None,
    checkpoint: StrPath | None = None,
    resume: bool = False,
    progress: Progress | None = None,
) -> Result:
    """Verify a policy on a map: no sensor error within bounds makes it come too close to something.

    Parameters
    ----------
    policy : Policy or path
        An ONNX policy; its network is checked against onnxruntime when it is loaded.
    world_map : WorldMap or path
        The map, its robot and clearances.
    eps : float or mapping
        Sensor error: one radius for every observation channel, or radii by channel (``""``: all others).
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
        Dead time in seconds: for so long the previous command goes on before the new one acts.
    horizon : Horizon or int, optional
        Follow the closed loop from every state over so many control intervals; see `viatool.safety.Horizon`.
    only_contested : bool
        Bound the actions only of states that geometry alone does not settle; the others have NaN bounds.
    noise, seed
        Of the simulated sensor and of the search for counterexamples.
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
    if resume and checkpoint is None:
        raise ConfigurationError("nothing is there to resume from", "give the folder with --checkpoint")
    origin, clock = _origin_of(trajectory, places, noise, seed), Clock()
    if scheduler is None or isinstance(scheduler, str):
        scheduler = open_scheduler(workers, scheduler)
    with clock.timed("load"):
        policy = policy if isinstance(policy, Policy) else load_policy(policy, spec)
        world_map = world_map if isinstance(world_map, WorldMap) else load_map(Path(world_map))
        world_map = world_map.with_clearance(clearance, danger)
        rules = Rules.of(world_map, criterion, interval=interval, footprint=footprint, delay=delay)
        layout = Layout.of(policy, eps)
        horizon = Horizon(horizon) if isinstance(horizon, int) else horizon
        _check_interval(layout.spec, world_map, interval)
    with clock.timed("trajectory"):
        if places is not None:
            goals = world_map.scenarios if scenarios is None else scenarios
            trajectory = observe_places(
                policy, world_map, goals, places, footprint=rules.footprint, seed=seed
            )
        elif trajectory is None:
            trajectory = roll_out(policy, world_map, scenarios, noise=noise, seed=seed)
        elif not isinstance(trajectory, Trajectory):
            trajectory = load_trajectory(trajectory, layout.spec, bag)
        trajectory = layout.as_received(trajectory)
        previous = layout.previous(trajectory, rules, followed=horizon is not None)
    settings = {"order": order, "approximation": approximation, "refine": refine}
    bare = replace(world_map, scenarios=(), generator=None)  # the states bring their own scenarios
    outlook = None if horizon is None else HorizonQuestion(policy, bare, layout, rules, horizon, arithmetic)
    examination = Examination(
        policy, bare, rules, layout.columns, layout.radii, {**settings, "arithmetic": arithmetic},
        only_contested, seed, outlook,
    )  # fmt: skip
    campaign = Campaign(scheduler, checkpoint, resume, chunk)
    with clock.timed("examine"):
        findings = campaign.carry_out(
            examination,
            States.of(trajectory, previous, followed=horizon is not None),
            result_versions(),
            _tell(progress, "states"),
        )
    clock.share_out("examine", findings.seconds)
    return Result(
        policy_path=policy.path,
        policy_sha256=policy.sha256,
        world_map=world_map,
        rules=rules,
        trajectory=trajectory,
        eps=eps,
        radii=layout.radii,
        arithmetic=arithmetic,
        engine=settings,
        channels=tuple(layout.spec.observation),
        actions=layout.actions,
        columns=layout.columns,
        previous=previous if rules.delay else None,
        reachable=findings.reachable,
        contested=findings.contested,
        judgement=findings.judgement,
        witnesses=findings.witnesses,
        seconds=clock.seconds,
        versions=result_versions(),
        origin=origin,
        maps=policy.maps,
        horizon=findings.over(horizon),
    )


def _check_interval(spec: PolicySpecification, world_map: WorldMap, interval: float | None) -> None:
    """Refuse to guess how long a command is held."""
    robot = world_map.robot.control_interval
    if interval is None and abs(spec.control_interval - robot) > 1e-9:
        raise ConfigurationError(
            f"the policy acts every {spec.control_interval} s, the robot of the map every {robot} s",
            "say which one counts with --interval, or correct the map",
        )


def _tell(progress: Progress | None, stage: str) -> Callable[[int, int], None]:
    return lambda done, total: progress(stage, done, total) if progress else None


def _origin_of(
    trajectory: Trajectory | StrPath | None, places: Places | None, noise: float | None, seed: int
) -> str:
    """Return in words where the states come from, and the seed."""
    if places is not None:
        if trajectory is not None:
            raise ConfigurationError("states are given and poses are to be sampled", "leave one of them out")
        if places.count is not None:
            return f"{places.count:,} random poses, seed {seed}"
        return f"a grid of {places.spacing:g} m with {places.headings} headings, seed {seed} of the search"
    if trajectory is None:
        sensor = "the map's sensor noise" if noise is None else f"sensor noise {noise:g} m"
        return f"simulated, {sensor}, seed {seed}"
    source = "given as arrays" if isinstance(trajectory, Trajectory) else f"read from {os.fspath(trajectory)}"
    return f"{source}, seed {seed} of the search"
