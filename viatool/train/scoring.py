"""Verification in the loop: how many states that a policy visits are proved safe, and how many missions."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from viatool.missions import MissionLimits, Missions, mission
from viatool.policy import Policy
from viatool.train.configuration import TrainingConfiguration
from viatool.train.export import export_actor
from viatool.train.maps import TrainingMaps
from viatool.train.networks import Weights
from viatool.train.observation import UnitScaling, make_specification
from viatool.verification import verify
from viatool.world import Robot, Scenario, WorldMap

START_ERROR = (0.02, 0.02)
"""Metres and radians by which missions may begin elsewhere."""


@dataclass(frozen=True, order=True)
class Safety:
    """Shares of proved states, the more important one first: that is how two policies are compared.

    Parameters
    ----------
    collision : float
        Proved to keep the collision clearance for a control interval, whatever the sensor error.
    danger : float
        Proved to keep the danger clearance.
    """

    collision: float
    danger: float

    def metrics(self) -> dict[str, float]:
        """Return the columns of ``metrics.csv``."""
        return {"verified_safety_rate": self.collision, "verified_danger_rate": self.danger}


@contextmanager
def exported(actor: Weights, budget: float, robot: Robot, scaling: UnitScaling) -> Iterator[Policy]:
    """Export the policy of one seed for a while; its budget channel is fixed to `budget`."""
    with tempfile.TemporaryDirectory() as directory:
        specification = make_specification(robot, budget, {}, scaling.layout)
        yield export_actor(actor, scaling, specification, Path(directory) / "policy.onnx")


def score_safety(
    actor: Weights, budget: float, maps: TrainingMaps, scaling: UnitScaling, options: TrainingConfiguration
) -> Safety:
    """Export the policy of one seed and verify the states that it visits, as ``viatool verify`` does.

    Parameters
    ----------
    actor : Weights
        Of one seed.
    budget : float
        u, to which the budget channel is fixed.
    maps, scaling : TrainingMaps and UnitScaling
        Of the training.
    options : TrainingConfiguration
        Says how many validation scenarios are driven, and the sensor error.
    """
    counts = np.zeros((2, 2))
    with exported(actor, budget, maps.robot, scaling) as policy:
        for world_map, scenarios in maps.draw(options.verification_scenarios, options.validation_seed):
            result = verify(
                policy,
                world_map,
                eps=options.verification_eps,
                scenarios=scenarios,
                only_contested=True,
                seed=options.validation_seed,
            )
            counts += [
                (rate.overall.safe, rate.overall.total) for rate in (result.safety_rate, result.danger_rate)
            ]
    return Safety(*(counts[:, 0] / counts[:, 1]).tolist())


def try_missions(
    policy: Policy, world_map: WorldMap, options: TrainingConfiguration, scenarios: Sequence[Scenario]
) -> Missions:
    """Try to prove missions, as ``viatool mission`` does, with cells of one size.

    Parameters
    ----------
    policy : Policy
        With its specification.
    world_map : WorldMap
        Of the training.
    options : TrainingConfiguration
        Says the sensor error, and how many parts a set may have.
    scenarios : sequence of Scenario
        What is driven.
    """
    return mission(
        policy,
        world_map,
        eps=options.verification_eps,
        start_error=START_ERROR,
        scenarios=scenarios,
        limits=MissionLimits(options.horizon, parts=options.mission_parts, finer=0),
    )


def proved_missions(policy: Policy, maps: TrainingMaps, options: TrainingConfiguration) -> float:
    """Return the share of the further random scenarios whose missions are proved, see `try_missions`."""
    proved = 0
    for world_map, scenarios in maps.draw(options.mission_scenarios, options.validation_seed + 2):
        proved += try_missions(policy, world_map, options, scenarios).counts["proved"]
    return proved / options.mission_scenarios


def score_missions(
    actor: Weights, budget: float, maps: TrainingMaps, scaling: UnitScaling, options: TrainingConfiguration
) -> float:
    """Export the policy of one seed, and return its `proved_missions`."""
    with exported(actor, budget, maps.robot, scaling) as policy:
        return proved_missions(policy, maps, options)
