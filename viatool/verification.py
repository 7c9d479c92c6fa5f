"""The main job: policy, map, states and uncertainty give verdicts."""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

import viatool
from viatool.errors import ConfigurationError, EmptyEvaluationError, PolicyError, TrajectoryError
from viatool.policy import Policy, PolicySpecification, load_policy
from viatool.safety import (
    ActionName,
    Case,
    Result,
    Rules,
    Situations,
    find_contested,
    judge,
    search_witnesses,
)
from viatool.simulate import roll_out
from viatool.taylor import Arithmetic, ReachableSet, Refinement, reach
from viatool.taylor.approximation import Approximation
from viatool.trajectory import Trajectory, load_trajectory
from viatool.world import Footprint, Scenario, WorldMap, load_map

Floats = NDArray[np.float64]
Booleans = NDArray[np.bool_]
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
    only_contested: bool = False,
    noise: float | None = None,
    seed: int = 0,
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
    only_contested : bool
        Bound the actions only of states that geometry alone does not settle; the others have NaN bounds.
    noise, seed
        Of the simulated sensor and of the search for counterexamples.
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

    Notes
    -----
    Sound: every state called safe is safe under the assumptions that `Result.assumptions` lists.
    """
    stages = _Stages(progress)
    with stages.timed("load"):
        policy = policy if isinstance(policy, Policy) else load_policy(policy, spec)
        world_map = world_map if isinstance(world_map, WorldMap) else load_map(Path(world_map))
        world_map = world_map.with_clearance(clearance, danger)
        rules = Rules.of(world_map, criterion, interval=interval, footprint=footprint, delay=delay)
        layout = _layout_of(policy, eps)
    with stages.timed("trajectory"):
        if trajectory is None:
            trajectory = roll_out(policy, world_map, scenarios, noise=noise, seed=seed)
        elif not isinstance(trajectory, Trajectory):
            trajectory = load_trajectory(trajectory, layout.spec)
        trajectory = _as_received(trajectory, policy, layout)
        case = _case_of(trajectory, world_map, rules, layout)
    with stages.timed("geometry"):
        contested = find_contested(case)
    with stages.timed("reach"):
        wanted = contested.either if only_contested else np.ones(len(case), dtype=bool)
        settings = {"order": order, "approximation": approximation, "refine": refine}
        reachable = _reach(
            policy, trajectory.observations, wanted, layout.radii, stages, arithmetic=arithmetic, **settings
        )
        lower, upper = reachable.lower[:, layout.columns], reachable.upper[:, layout.columns]
    with stages.timed("judge"):
        judgement = judge(case, lower, upper, contested)
    with stages.timed("search"):
        doubtful = np.flatnonzero(~judgement.safe)
        witnesses = search_witnesses(
            policy, layout.columns, case, doubtful, trajectory.observations, layout.radii, lower, upper,
            seed=seed, progress=stages.progress_of("search"),
        )  # fmt: skip
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
        actions=layout.actions,
        columns=layout.columns,
        reachable=reachable,
        contested=contested,
        judgement=judgement,
        witnesses=witnesses,
        seconds=stages.seconds,
        versions=_versions(),
    )


@dataclass(frozen=True, eq=False)
class _Layout:
    """What the numbers of the policy are, and how uncertain."""

    spec: PolicySpecification
    columns: list[int]
    radii: Floats

    @property
    def actions(self) -> tuple[ActionName, ...]:
        return tuple(ActionName(action.name, action.unit) for action in self.spec.action)


def _layout_of(policy: Policy, eps: float | Mapping[str, float]) -> _Layout:
    """Return the layout of a policy, refusing one that does not tell its commands."""
    spec = policy.spec
    if spec is None:
        raise PolicyError(
            f"policy '{policy.path}' has no specification, so its observations and commands have no meaning",
            "describe it with --spec robot.yaml",
        )
    sizes = (policy.input_size, policy.output_size)
    if sizes != (spec.observation_size, spec.action_size):
        raise PolicyError(
            f"policy '{policy.path}' takes {sizes[0]} numbers and gives {sizes[1]}, its specification names "
            f"{spec.observation_size} and {spec.action_size}",
            "correct the channels of the specification",
        )
    kinds = [channel.kind for channel in spec.action]
    for kind in ("linear", "angular"):
        if kind not in kinds:
            raise PolicyError(
                f"no action of policy '{policy.path}' is of kind '{kind}'",
                "name the kinds of the actions in the specification",
            )
    return _Layout(spec, [kinds.index("linear"), kinds.index("angular")], spec.radii(eps))


def _as_received(trajectory: Trajectory, policy: Policy, layout: _Layout) -> Trajectory:
    """Return a trajectory whose observations are the float32 numbers that the program receives.

    Channels that the specification fixes take their value, whatever was recorded (the paper's budget).
    """
    size = trajectory.observations.shape[1]
    if len(trajectory) == 0:
        raise EmptyEvaluationError("the trajectory has no states", "record or drive at least one step")
    if size != policy.input_size:
        raise TrajectoryError(
            f"the trajectory has {size} observation entries, the policy takes {policy.input_size}",
            "verify with the policy that drove, or give the trajectory the columns of this one",
        )
    fixed = layout.spec.fixed_values()
    observations = np.where(np.isnan(fixed), trajectory.observations, fixed)
    return replace(trajectory, observations=observations.astype(np.float32).astype(np.float64))


def _case_of(trajectory: Trajectory, world_map: WorldMap, rules: Rules, layout: _Layout) -> Case:
    """Return the states with the geometry of their episodes, and the command that each of them came with."""
    situations = Situations.of(world_map, trajectory.scenarios, trajectory.poses, trajectory.episode)
    if not rules.delay:
        return Case(rules, situations)
    return Case(rules, situations, rules.clip(_previous(trajectory, layout)))


def _previous(trajectory: Trajectory, layout: _Layout) -> Floats:
    """Return the command before each state, (N, 2): as observed, else as recorded; 0 before the first."""
    names = {channel.kind: channel.name for channel in layout.spec.observation}
    if {"previous_linear", "previous_angular"} <= names.keys():
        columns = [layout.spec.columns(names[kind]).start for kind in ("previous_linear", "previous_angular")]
        return trajectory.observations[:, columns]
    if trajectory.actions.shape[1] == len(layout.spec.action):
        previous = np.zeros((len(trajectory), 2))
        same = trajectory.episode[1:] == trajectory.episode[:-1]
        previous[1:][same] = trajectory.actions[:-1][same][:, layout.columns]
        return previous
    raise ConfigurationError(
        "a delay needs the previous command, which is neither observed nor recorded",
        "record the actions, or verify without --delay",
    )


def _reach(
    policy: Policy, observations: Floats, wanted: Booleans, radii: Floats, stages: _Stages, **settings: Any
) -> ReachableSet:
    """Bound the actions of the wanted states; the others get NaN."""
    tell, done, total = stages.progress_of("reach"), 0, int(wanted.sum())

    def count(states: int) -> None:
        nonlocal done
        done += states
        tell(done, total)

    found = reach(policy, observations[wanted], radii, progress=count, **settings)
    if wanted.all():
        return found
    spread = {}
    for part in fields(found):
        spread[part.name] = np.full((len(wanted), policy.output_size), np.nan)
        spread[part.name][wanted] = getattr(found, part.name)
    return ReachableSet(**spread)


class _Stages:
    """Measures stages and tells how far they have come."""

    def __init__(self, progress: Progress | None) -> None:
        self.seconds: dict[str, float] = {}
        self.progress = progress

    @contextmanager
    def timed(self, stage: str) -> Iterator[None]:
        start = time.perf_counter()
        yield
        self.seconds[stage] = time.perf_counter() - start

    def progress_of(self, stage: str) -> Callable[[int, int], None]:
        return lambda done, total: self.progress(stage, done, total) if self.progress else None


def _versions() -> dict[str, str]:
    """Return the versions that a repetition would need."""
    libraries = {name: version(name) for name in ("numpy", "onnx", "onnxruntime")}
    return {"viatool": viatool.__version__, "python": platform.python_version(), **libraries}
