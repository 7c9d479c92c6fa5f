"""Choosing the policy that is exported, and testing it: three sets of scenarios that never overlap."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol, TypeVar

import numpy as np

from viatool.channels.inputs import Inputs
from viatool.policy import Policy
from viatool.policy.specified import specification_of
from viatool.simulate import navigation_channels
from viatool.train.configuration import TrainingConfiguration
from viatool.train.evaluation import (
    Evaluation,
    actor_command,
    actor_commands,
    drive,
    drive_on_maps,
    policy_command,
)
from viatool.train.maps import TrainingMaps
from viatool.train.networks import Weights
from viatool.train.observation import UnitScaling
from viatool.world import Scenario, WorldMap


@dataclass(frozen=True, eq=False)
class Candidate:
    """The policy of one seed after one epoch.

    Parameters
    ----------
    seed, epoch : int
        Where it stood.
    score : float
        See `Evaluation.score`.
    var : float
        u, to which its budget channel will be fixed.
    weights : Weights
        Of the actor, one seed.
    safety : tuple of float
        Rates by which those of about the same score are compared, see `viatool.train.scoring`; empty where
        safety does not decide.
    """

    seed: int
    epoch: int
    score: float
    var: float
    weights: Weights
    safety: tuple[float, ...] = ()


class Scored(Protocol):
    """What policies are compared by; see `Candidate`."""

    @property
    def seed(self) -> int: ...  # noqa: D102  # as of a candidate
    @property
    def epoch(self) -> int: ...  # noqa: D102
    @property
    def score(self) -> float: ...  # noqa: D102
    @property
    def safety(self) -> tuple[float, ...]: ...  # noqa: D102


Policies = TypeVar("Policies", bound=Scored)


def best_candidates(candidates: Sequence[Policies], count: int, tolerance: float) -> list[Policies]:
    """Return the best ones in order.

    Those within `tolerance` of the best score count as equally good, and then those of the next such class:
    in a class the safer one comes first, then the better score, then the later.
    """
    best = max(one.score for one in candidates)

    def rank(one: Scored) -> tuple[float, tuple[float, ...], float, int, int]:
        behind = (best - one.score) // tolerance if one.safety and tolerance else best - one.score
        return (behind, tuple(-rate for rate in one.safety), -one.score, -one.epoch, one.seed)

    return sorted(candidates, key=rank)[:count]


def choose(
    candidates: Sequence[Candidate],
    maps: TrainingMaps,
    scaling: UnitScaling,
    configuration: TrainingConfiguration,
    proved: Callable[[Candidate], float] | None = None,
) -> Candidate:
    """Compare the finalists on scenarios of their own: the best of many noisy scores flatters.

    Where the share of missions that are `proved` of a candidate is given, it decides among those about as good.
    """
    if len(candidates) == 1:
        return candidates[0]
    drawn = _choosing(maps, configuration, configuration.final_scenarios, configuration.validation_seed + 1)
    commands = [actor_command(one.weights, scaling, one.var) for one in candidates]
    outcome = drive_on_maps(commands, drawn, configuration)
    judged = [replace(one, score=score) for one, score in zip(candidates, outcome.score(), strict=True)]
    if proved is not None:
        judged = [replace(one, safety=(proved(one),)) for one in judged]
    return best_candidates(judged, 1, configuration.selection_tolerance)[0]


def _choosing(
    maps: TrainingMaps, options: TrainingConfiguration, count: int, seed: int
) -> list[tuple[WorldMap, tuple[Scenario, ...]]]:
    """Return the scenarios that choose a policy: `count` random ones, or the fixed ones of the maps."""
    return maps.fixed() if options.select_on == "fixed" else maps.draw(count, seed)


def validate(
    actor: Weights,
    budget: np.ndarray,
    maps: TrainingMaps,
    scaling: UnitScaling,
    options: TrainingConfiguration,
) -> Evaluation:
    """Drive the policies of all seeds on the validation scenarios."""
    drawn = _choosing(maps, options, options.validation_scenarios, options.validation_seed)
    commands = actor_commands(actor, scaling, budget)
    return drive_on_maps(commands, drawn, options, options.validation_seed)


@dataclass(frozen=True)
class Tested:
    """How an exported policy fared.

    Parameters
    ----------
    metrics : dict
        Rates and means on ``fixed`` scenarios and on ``held_out`` ones, see `evaluate_policy`.
    failures : list of (str, int)
        The held-out scenarios in which it does not arrive: name of the map, and number among those of its test.
    """

    metrics: dict[str, dict[str, float]]
    failures: list[tuple[str, int]]


def evaluate_policy(policy: Policy, maps: TrainingMaps, configuration: TrainingConfiguration) -> Tested:
    """Drive an exported policy on every map's ``fixed`` scenarios and on ``held_out`` random ones.

    Of several maps both are also told of each map alone, as ``NAME fixed`` and ``NAME held_out``.
    """
    specification = specification_of(policy)
    inputs = Inputs.of(navigation_channels(maps.robot.lidar))
    columns = np.concatenate([inputs.columns(channel.name) for channel in specification.observation])
    command = policy_command(policy, float(specification.channel("budget").value or 0.0), columns)
    found: dict[str, list[tuple[str, Evaluation]]] = {}
    for name, world_map in zip(maps.names, maps.maps, strict=True):
        for kind, scenarios in _tests(world_map, configuration).items():
            outcome = drive([command], world_map, scenarios, configuration, configuration.test_seed)
            found.setdefault(kind, []).append((name, outcome))
    evaluation = {kind: _told(Evaluation.joined([one for _, one in parts])) for kind, parts in found.items()}
    if len(maps.maps) > 1:
        for kind, parts in found.items():
            evaluation |= {f"{name} {kind}": _told(outcome) for name, outcome in parts}
    failures = [
        (name, int(number))
        for name, outcome in found.get("held_out", [])
        for number in np.flatnonzero(~outcome.success[0])
    ]
    return Tested(evaluation, failures)


def _tests(world_map: WorldMap, configuration: TrainingConfiguration) -> dict[str, Sequence[Scenario]]:
    """Return the scenarios on which a policy is tested on a map, by kind, those kinds that it has."""
    tests: dict[str, Sequence[Scenario]] = {"fixed": world_map.scenarios}
    if world_map.generator is not None:
        tests["held_out"] = world_map.generator.draw(configuration.test_scenarios, configuration.test_seed)
    return {kind: scenarios for kind, scenarios in tests.items() if scenarios}


def _told(outcome: Evaluation) -> dict[str, float]:
    """Return the metrics of the only policy, and in how many episodes."""
    return {"episodes": float(outcome.success.shape[1]), **outcome.metrics(0)}
