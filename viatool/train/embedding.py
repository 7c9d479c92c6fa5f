"""State-action embeddings of TD7 (SALE): an encoder that learns to predict the next state's code."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor
from torch.autograd import grad

from viatool.train.networks import TrainedNetwork, Weights


def normalise_code(code: Tensor) -> Tensor:
    """Divide by the mean absolute value of the last axis (AvgL1Norm), so that codes keep their size."""
    return code / code.abs().mean(-1, keepdim=True).clamp(min=1e-8)


class Embedding:
    """``z_s = f(s)`` and ``z_sa = g(z_s, a)`` of S seeds, trained so that ``z_sa`` predicts ``f(s')``.

    Parameters
    ----------
    sizes : sequence of int
        Width of the observation, of the hidden layer and of a code.
    actions, seeds : int
        A and S.
    generator : torch.Generator
        Source of the weights.

    Notes
    -----
    Three generations: the newest is trained; the fixed one feeds the critics; the one before feeds the target
    critics. `renew` moves them up, together with the hard update of the targets, so that a critic always sees
    the codes that it was trained on.
    """

    def __init__(self, sizes: Sequence[int], actions: int, seeds: int, generator: torch.Generator) -> None:
        inputs, hidden, code = sizes
        self.code = code
        self.state_encoder = TrainedNetwork(Weights((inputs, hidden, code), seeds).draw(generator))
        self.action_encoder = TrainedNetwork(Weights((code + actions, hidden, code), seeds).draw(generator))
        self.older_state = TrainedNetwork(self.state_encoder.target.copy())
        self.older_action = TrainedNetwork(self.action_encoder.target.copy())

    def networks(self) -> dict[str, TrainedNetwork]:
        """Return what a checkpoint keeps; of the older generation only the weights are used."""
        return {
            "state_encoder": self.state_encoder,
            "action_encoder": self.action_encoder,
            "older_state_encoder": self.older_state,
            "older_action_encoder": self.older_action,
        }

    def codes(self, observation: Tensor, action: Tensor, *, older: bool = False) -> Tensor:
        """Return ``(z_s, z_sa)`` joined, ``(S, B, 2 code)``, of the fixed or the older generation."""
        state = self.older_state.weights if older else self.state_encoder.target
        pair = self.older_action.weights if older else self.action_encoder.target
        with torch.no_grad():
            state_code = normalise_code(state(observation))
        pair_code = pair.as_constants(torch.cat([state_code, action], dim=-1))
        return torch.cat([state_code, pair_code], dim=-1)

    def update(
        self, observation: Tensor, action: Tensor, next_observation: Tensor, learning_rate: float
    ) -> Tensor:
        """Descend ``E[(g(f(s), a) - f(s'))^2]``, the next code held constant; return the ``(S,)`` loss."""
        state, pair = self.state_encoder.weights, self.action_encoder.weights
        with torch.no_grad():
            target = normalise_code(state(next_observation))
        predicted = pair(torch.cat([normalise_code(state(observation)), action], dim=-1))
        loss = (predicted - target).square().mean((1, 2))
        gradients = grad(loss.sum(), [*state.layers, *pair.layers])
        self.state_encoder.descend(gradients[: len(state.layers)], learning_rate)
        self.action_encoder.descend(gradients[len(state.layers) :], learning_rate)
        return loss.detach()

    def renew(self) -> None:
        """Let the fixed generation become the older one and the newest the fixed one."""
        self.older_state.weights.flat.copy_(self.state_encoder.target.flat)
        self.older_action.weights.flat.copy_(self.action_encoder.target.flat)
        self.state_encoder.follow(1.0)
        self.action_encoder.follow(1.0)
