"""Driving policies without exploration on given scenarios, all scenarios and seeds in parallel."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from viatool.arrays import Booleans, Floats, Indices
from viatool.policy import Policy
from viatool.simulate import Simulator, make_simulator
from viatool.simulate.engines import largest_batch
from viatool.train.configuration import TrainingConfiguration
from viatool.train.networks import Weights
from viatool.train.observation import UnitScaling
from viatool.train.updates import act
from viatool.world import Scenario, WorldMap

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

    success: Booleans
    collision: Booleans
    cost: Floats
    steps: Indices

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

    @staticmethod
    def joined(parts: Sequence[Evaluation]) -> Evaluation:
        """Return how the same policies fared in the scenarios of all parts."""
        every = zip(*(vars(part).values() for part in parts), strict=True)
        return Evaluation(*(np.concatenate(arrays, axis=1) for arrays in every))


def drive(
    commands: Sequence[Command],
    world_map: WorldMap,
    scenarios: Sequence[Scenario],
    options: TrainingConfiguration,
    seed: int = 0,
) -> Evaluation:
    """Drive every scenario with every policy.

    Parameters
    ----------
    commands : sequence of callable
        S policies, from ``(N, n - 1)`` physical observations to m/s and rad/s.
    world_map : WorldMap
        Its own noise of the LiDAR applies.
    scenarios : sequence of Scenario
        N.
    options : TrainingConfiguration
        The engine, and the horizon after which an episode ends as a timeout.
    seed : int
        Of the sensor noise.

    Returns
    -------
    Evaluation
    """
    shape = len(commands), len(scenarios)
    outcome = Evaluation(
        success=np.zeros(shape, dtype=bool),
        collision=np.zeros(shape, dtype=bool),
        cost=np.zeros(shape),
        steps=np.zeros(shape, dtype=np.int64),
    )
    together = largest_batch(options.engine)
    for policy, command in enumerate(commands):
        for first in range(0, len(scenarios), together):
            some = np.arange(first, min(first + together, len(scenarios)))
            simulator = make_simulator(
                options.engine,
                world_map,
                len(some),
                workers=options.engine_workers,
                scenarios=scenarios[first : first + together],
                horizon=options.horizon,
                seed=seed + first,
            )
            with closing(simulator):
                _drive(command, simulator, outcome, policy, some)
    return outcome


def drive_on_maps(
    commands: Sequence[Command],
    drawn: Iterable[tuple[WorldMap, Sequence[Scenario]]],
    options: TrainingConfiguration,
    seed: int = 0,
) -> Evaluation:
    """Drive the scenarios of several maps, see `drive` and `TrainingMaps.draw`."""
    return Evaluation.joined(
        [drive(commands, world_map, scenarios, options, seed) for world_map, scenarios in drawn]
    )


def _drive(command: Command, simulator: Simulator, outcome: Evaluation, policy: int, active: Indices) -> None:
    """Drive until every robot has arrived, collided or run out of time; fill in the outcome."""
    observation = simulator.reset()
    while len(active):
        step = simulator.step(command(observation))
        outcome.cost[policy, active] += step.cost
        outcome.steps[policy, active] += 1
        outcome.success[policy, active] = step.success
        outcome.collision[policy, active] = step.collision
        simulator.keep(~step.done)
        active, observation = active[~step.done], step.observation[~step.done]


def actor_command(actor: Weights, scaling: UnitScaling, budget: float) -> Command:
    """Return the policy of one seed without noise; the budget channel is held at `budget`."""

    def command(observation: NDArray[Any]) -> Floats:
        inputs = scaling.normalise(observation, np.full(len(observation), budget))
        with torch.no_grad():
            action = act(actor, inputs.unsqueeze(0))[0]
        return scaling.physical_action(action.numpy().astype(np.float64))

    return command


def actor_commands(actor: Weights, scaling: UnitScaling, budget: Floats) -> list[Command]:
    """Return the policies of S seeds, see `actor_command`; budget is ``(S,)``."""
    return [actor_command(actor.one(seed), scaling, float(budget[seed])) for seed in range(actor.seeds)]


def policy_command(policy: Policy, budget: float, columns: Indices) -> Command:
    """Return an exported policy as its onnxruntime program runs it, on some columns, the budget held at `budget`."""

    def command(observation: NDArray[Any]) -> Floats:
        joined = np.concatenate([observation[:, columns], np.full((len(observation), 1), budget)], axis=1)
        return np.asarray(policy.run(joined), dtype=np.float64)

    return command
