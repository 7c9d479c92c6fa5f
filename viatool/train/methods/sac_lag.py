"""SAC-Lagrangian (Ha et al., 2020) with TD3 in the place of SAC: a Lagrangian on the expected cost."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.autograd import grad

from viatool.train.methods.method import EpochCosts, Method, Metrics
from viatool.train.networks import TrainedNetwork
from viatool.train.replay import Batch


class SacLagrangian(Method):
    """A scalar cost critic by mean squared error; the actor pays ``lambda Q_C(s, pi(s))``."""

    @property
    def cost_outputs(self) -> int:
        """Return 1: the expected discounted cost."""
        return 1

    def update_cost_critic(
        self,
        critic: TrainedNetwork,
        inputs: Tensor,
        next_inputs: Tensor,
        batch: Batch,
        learning_rate: float,
        *,
        measure: bool,
    ) -> Metrics:
        """Regress ``Q_C(s, a)`` on ``c + gamma Q_C'(s', a')``."""
        with torch.no_grad():
            target = batch.cost + batch.discount * critic.target(next_inputs).squeeze(-1)
        value = critic.weights(inputs).squeeze(-1)
        loss = (value - target).square().mean(-1)  # (S,)
        critic.descend(grad(loss.sum(), critic.weights.layers), learning_rate)
        return {"cost_critic_loss": loss.detach(), "cost_value": value.detach().mean(-1)} if measure else {}

    def action_cost(self, outputs: Tensor, budget: Tensor) -> Tensor:
        """Return the expected cost."""
        return outputs.squeeze(-1)

    def slack(self, costs: EpochCosts) -> float:
        """Return ``b - mean C``."""
        return self.options.cost_limit - float(costs.episodes.mean())
