"""VIA, the paper's method: noncrossing quantiles, V_C beyond the budget, mean cost and u for lambda."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.autograd import grad

from viatool.train.constraint import empirical_cvar
from viatool.train.methods.method import EpochCosts, Method, Metrics
from viatool.train.methods.quantiles import (
    noncrossing_quantiles,
    quantile_huber_gradient,
    quantile_huber_loss,
    tail_cost,
)
from viatool.train.networks import TrainedNetwork, Weights
from viatool.train.replay import Batch


def cost_target(target_critic: Weights, next_inputs: Tensor, batch: Batch) -> Tensor:
    """Return ``c + gamma q_j(s', a')``, ``(S, B, M)``; the discount of the batch is 0 after a termination."""
    quantiles = noncrossing_quantiles(target_critic(next_inputs))
    return batch.cost.unsqueeze(-1) + batch.discount.unsqueeze(-1) * quantiles


class Via(Method):
    """Constrains the CVaR of the episode cost."""

    budgeted = True

    @property
    def cost_outputs(self) -> int:
        """Return M + 2, see `noncrossing_quantiles`."""
        return self.options.quantiles + 2

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
        """Regress the quantiles on the target distribution with the quantile Huber loss."""
        kappa = self.options.huber_threshold
        with torch.no_grad():
            target = cost_target(critic.target, next_inputs, batch)
        predicted = noncrossing_quantiles(critic.weights(inputs))
        gradient = quantile_huber_gradient(predicted.detach(), target, kappa) / predicted.shape[1]
        critic.descend(grad(predicted, critic.weights.layers, gradient), learning_rate)
        if not measure:
            return {}
        loss = quantile_huber_loss(predicted.detach(), target, kappa).mean(-1)
        return {"cost_critic_loss": loss, "cost_value": predicted.detach().mean((1, 2))}

    def action_cost(self, outputs: Tensor, budget: Tensor) -> Tensor:
        """Return V_C."""
        return tail_cost(noncrossing_quantiles(outputs), budget, self.options.alpha)

    def slack(self, costs: EpochCosts) -> float:
        """Return ``b - u - mean C``, or by ``multiplier_rule: cvar`` the constraint's own ``b - CVaR(C)``."""
        if self.options.multiplier_rule == "cvar":
            return self.options.cost_limit - empirical_cvar(costs.episodes, self.options.alpha)
        return self.options.cost_limit - costs.var - float(costs.episodes.mean())
