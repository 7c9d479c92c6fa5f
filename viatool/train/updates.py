"""One function for each update of the networks; each takes one step and returns its metrics.

The networks of S seeds are updated together: losses are means over the batch and sums over the seeds, whose
weights are disjoint, so that no seed feels another. Networks are updated in place; metrics are ``(S,)``
tensors.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import torch
from torch import Tensor
from torch.autograd import grad

from viatool.train.embedding import Embedding
from viatool.train.methods import Method
from viatool.train.networks import TrainedNetwork, Weights

Metrics = dict[str, Tensor]
Penalties = dict[str, tuple[float, Tensor]]
"""Weights and ``(S,)`` metrics by name."""

SATURATION = 2.5  # tanh(2.5) = 0.987
SATURATED = 2.6467  # tanh(2.6467) = 0.99


@dataclass(frozen=True, eq=False)
class Agent:
    """The networks of S seeds.

    Parameters
    ----------
    actor : TrainedNetwork
        S perceptrons, n to A; the action is ``tanh`` of the output.
    task_critics : TrainedNetwork
        2 S perceptrons, the first critic of every seed before the second of every seed.
    cost_critic : TrainedNetwork or None
        S perceptrons with the outputs of the method; None if it has none.
    embedding : Embedding or None
        Of TD7.
    value_range : Tensor
        ``(4, S)`` of TD7: least and largest target so far, and those that clip the targets now.
    """

    actor: TrainedNetwork
    task_critics: TrainedNetwork
    cost_critic: TrainedNetwork | None
    embedding: Embedding | None = None
    value_range: Tensor = field(default_factory=lambda: torch.zeros(4, 0))

    def networks(self) -> dict[str, TrainedNetwork]:
        """Return the networks that there are, by name."""
        named = {"actor": self.actor, "task_critics": self.task_critics, "cost_critic": self.cost_critic}
        there = {name: network for name, network in named.items() if network is not None}
        return there if self.embedding is None else there | self.embedding.networks()


def act(actor: Weights, observation: Tensor) -> Tensor:
    """Return the deterministic action ``(S, B, A)`` in [-1, 1] for normalised observations ``(S, B, n)``."""
    return actor(observation).tanh()


def critic_input(features: Tensor, action: Tensor) -> Tensor:
    """Join the features of a state and an action: ``(S, B, f)`` and ``(S, B, A)`` to ``(S, B, f + A)``."""
    return torch.cat([features, action], dim=-1)


def smoothed_action(
    target_actor: Weights, observation: Tensor, noise: float, limit: float, generator: torch.Generator
) -> Tensor:
    """Return the target policy's action with clipped Gaussian noise (target policy smoothing of TD3)."""
    action = act(target_actor, observation)
    smoothing = torch.randn(action.shape, generator=generator).mul_(noise).clamp_(-limit, limit)
    return action.add_(smoothing).clamp_(-1.0, 1.0)


def task_target(target_critics: Weights, next_input: Tensor, reward: Tensor, discount: Tensor) -> Tensor:
    """Return ``y = r + gamma min_i Q_i(s', a')``, ``(S, B)``; the discount is 0 after a termination."""
    return reward + discount * twin_values(target_critics, next_input).amin(0)


def twin_values(critics: Weights, inputs: Tensor) -> Tensor:
    """Evaluate both task critics: ``(S, B, f + A)`` to ``(2, S, B)``."""
    seeds, count, _ = inputs.shape
    return critics(torch.cat([inputs, inputs])).view(2, seeds, count)


def update_task_critics(
    critics: TrainedNetwork, inputs: Tensor, target: Tensor, learning_rate: float, *, measure: bool = False
) -> Metrics:
    """Regress both critics on the target, ``sum_i E[(Q_i(s, a) - y)^2]``.

    Parameters
    ----------
    critics : TrainedNetwork
        Updated in place.
    inputs : Tensor
        ``(S, B, f + A)``.
    target : Tensor
        ``(S, B)``, see `task_target`.
    learning_rate : float
        Of this step.
    measure : bool
        Also compute metrics that the step does not need.
    """
    values = twin_values(critics.weights, inputs)
    errors = values.detach() - target  # (2, S, B)
    critics.descend(grad(values, critics.weights.layers, errors * (2 / target.shape[1])), learning_rate)
    if not measure:
        return {}
    return {"task_critic_loss": errors.square().mean(-1).sum(0), "task_value": values.detach().mean((0, 2))}


def update_actor(
    agent: Agent,
    method: Method,
    observation: Tensor,
    features: Tensor,
    budget: Tensor,
    multiplier: Tensor,
    *,
    learning_rate: float,
    saturation_penalty: float = 0.0,
    penalties: Penalties | None = None,
) -> Metrics:
    """Descend ``-E[Q_1(s, pi(s))] + lambda E[cost of pi(s)]`` and penalties.

    Parameters
    ----------
    agent : Agent
        The actor is updated in place.
    method : Method
        Says what the cost of an action is: V_C for VIA.
    observation, features : Tensor
        ``(S, B, n)`` and ``(S, B, f)``.
    budget : Tensor
        ``(S, B)``, the budget e of each state, unscaled.
    multiplier : Tensor
        ``(S,)`` lambda. If all are zero the cost critic is not evaluated.
    learning_rate : float
        Of this step.
    saturation_penalty : float
        Weight of `saturation`.
    penalties : dict, optional
        Weights and ``(S,)`` metrics by name, such as the width of the actor's reachable sets.
    """
    raw = agent.actor.weights(observation)
    inputs = critic_input(features, raw.tanh())
    value = first_value(agent.task_critics.weights, inputs).mean(-1)  # (S,)
    loss, metrics = -value, {"actor_value": value.detach(), "saturated_share": saturated_share(raw.detach())}
    if saturation_penalty:
        loss = loss + saturation_penalty * saturation(raw)
    if agent.cost_critic is not None and bool(multiplier.any()):
        cost = method.action_cost(agent.cost_critic.weights(inputs), budget).mean(-1)
        loss = loss + multiplier * cost
        metrics["action_cost"] = cost.detach()
    for name, (weight, metric) in (penalties or {}).items():
        loss = loss + weight * metric
        metrics[name] = metric.detach()
    agent.actor.descend(grad(loss.sum(), agent.actor.weights.layers), learning_rate)
    return metrics


def saturation(raw: Tensor) -> Tensor:
    """Return the mean squared excess of outputs before tanh ``(S, B, A)`` over `SATURATION`, ``(S,)``.

    A seed whose outputs saturate everywhere has no gradient left and would stay as it is, for instance at a
    standstill.
    """
    return (raw.abs() - SATURATION).clamp(min=0.0).square().mean((1, 2))


def saturated_share(raw: Tensor) -> Tensor:
    """Return the share of outputs before tanh ``(S, B, A)`` that command 99 % of the range or more, ``(S,)``."""
    return (raw.abs() > SATURATED).float().mean((1, 2))


def first_value(critics: Weights, inputs: Tensor) -> Tensor:
    """Evaluate only the first task critic, ``(S, B, f + A)`` to ``(S, B)``."""
    return critics.as_constants(inputs).squeeze(-1)


def update_targets(agent: Agent, rate: float) -> None:
    """Move every target network by `rate` towards its network."""
    for network in (agent.actor, agent.task_critics, agent.cost_critic):
        if network is not None:
            network.follow(rate)
