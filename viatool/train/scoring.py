"""Verification in the loop: how many of the states that a policy visits are proved safe."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path

from viatool.train.configuration import TrainingConfiguration
from viatool.train.export import export_actor
from viatool.train.networks import Weights
from viatool.train.observation import UnitScaling, make_specification
from viatool.train.selection import random_scenarios
from viatool.verification import verify
from viatool.world import WorldMap


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


def score_safety(
    actor: Weights, budget: float, world_map: WorldMap, scaling: UnitScaling, options: TrainingConfiguration
) -> Safety:
    """Export the policy of one seed and verify the states that it visits, as ``viatool verify`` does.

    Parameters
    ----------
    actor : Weights
        Of one seed.
    budget : float
        u, to which the budget channel is fixed.
    world_map, scaling : WorldMap and Scaling
        Of the training.
    options : TrainingConfiguration
        Says how many validation scenarios are driven, and the sensor error.
    """
    scenarios = random_scenarios(world_map, options.verification_scenarios, options.validation_seed)
    with tempfile.TemporaryDirectory() as directory:
        specification = make_specification(world_map.robot, budget, {}, scaling.layout)
        policy = export_actor(actor, scaling, specification, Path(directory) / "policy.onnx")
        result = verify(
            policy,
            world_map,
            eps=options.verification_eps,
            scenarios=scenarios,
            only_contested=True,
            seed=options.validation_seed,
        )
    return Safety(float(result.safety_rate), float(result.danger_rate))
