"""Driving policies without exploration on given scenarios, all scenarios and seeds in parallel."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from viatool.policy import Policy
from viatool.simulate import NavigationSimulator
from viatool.train.networks import Weights
from viatool.train.observation import Scaling
from viatool.train.updates import act
from viatool.world import Scenario, WorldMap

Floats = NDArray[np.float64]
Command = Callable[[NDArray[Any]], Floats]


@dataclass(frozen=True, eq=False)
class Evaluation:
    """How S policies fared in the same N scenarios.

    Parameters
    ----------
    success, collision : ndarray
        ``(S, N)`` bool; a timeout is neither.
    cost : ndarray
        ``(S, N)`` undiscounted cost of each episode.
    steps : ndarray
        ``(S, N)`` length of each episode.
    """

    success: NDArray[np.bool_]
    collision: NDArray[np.bool_]
    cost: Floats
    steps: NDArray[np.int64]

    def metrics(self, seed: int) -> dict[str, float]:
        """Return the rates and means of one policy."""
        success, collision = float(self.success[seed].mean()), float(self.collision[seed].mean())
        timeout = float((~self.success[seed] & ~self.collision[seed]).mean())
        return {
            "success_rate": success,
            "collision_rate": collision,
            "timeout_rate": timeout,
            "average_cost": float(self.cost[seed].mean()),
            "average_steps": float(self.steps[seed].mean()),
        }

    def score(self) -> Floats:
        """Return ``(S,)`` success rate minus collision rate: a collision is worse than a timeout."""
        score: Floats = self.success.mean(axis=1) - self.collision.mean(axis=1)
        return score


def drive(
    command: Command,
    world_map: WorldMap,
    scenarios: Sequence[Scenario],
    *,
    policies: int = 1,
    horizon: int = 300,
    seed: int = 0,
) -> Evaluation:
    """Drive every scenario with every policy.

    Parameters
    ----------
    command : callable
        From ``(S * N, n - 1)`` physical observations, the policies one after the other, to m/s and rad/s.
    world_map : WorldMap
        Its own noise of the LiDAR applies.
    scenarios : sequence of Scenario
        N.
    policies : int
        S.
    horizon : int
        Steps after which an episode ends as a timeout.
    seed : int
        Of the sensor noise.

    Returns
    -------
    Evaluation
    """
    count = len(scenarios)
    simulator = NavigationSimulator(
        world_map, policies * count, scenarios=list(scenarios) * policies, horizon=horizon, seed=seed
    )
    observation = simulator.reset()
    active = np.ones(policies * count, dtype=bool)
    success, collision = np.zeros_like(active), np.zeros_like(active)
    cost, steps = np.zeros(active.shape), np.zeros(active.shape, dtype=np.int64)
    while active.any():
        step = simulator.step(command(observation))
        observation = step.observation
        cost += np.where(active, step.cost, 0.0)
        steps += active
        success |= active & step.success
        collision |= active & step.collision
        active &= ~(step.terminated | step.truncated)
    shape = (policies, count)
    return Evaluation(
        success.reshape(shape), collision.reshape(shape), cost.reshape(shape), steps.reshape(shape)
    )


def actor_command(actor: Weights, scaling: Scaling, budget: Floats) -> Command:
    """Return the policies of S seeds without noise; the budget channel is held at ``budget (S,)``."""

    def command(observation: NDArray[Any]) -> Floats:
        count = len(observation) // actor.seeds
        inputs = scaling.normalise(observation, np.repeat(budget, count)).view(actor.seeds, count, -1)
        with torch.no_grad():
            action = act(actor, inputs)
        return scaling.physical_action(action.reshape(len(observation), -1).numpy().astype(np.float64))

    return command


def policy_command(policy: Policy, budget: float) -> Command:
    """Return an exported policy as its onnxruntime program runs it, the budget channel held at `budget`."""

    def command(observation: NDArray[Any]) -> Floats:
        joined = np.concatenate([observation, np.full((len(observation), 1), budget)], axis=1)
        return np.asarray(policy.run(joined), dtype=np.float64)

    return command
