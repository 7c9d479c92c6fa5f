"""WCSAC (Yang et al., 2021) with TD3 in the place of SAC: CVaR of a Gaussian cost."""

from __future__ import annotations

from statistics import NormalDist

import torch
from torch import Tensor
from torch.autograd import grad
from torch.nn.functional import softplus

from viatool.train.methods.method import EpochCosts, Method, Metrics
from viatool.train.networks import TrainedNetwork
from viatool.train.replay import Batch

LEAST_VARIANCE = 1e-4


def gaussian_cvar_factor(alpha: float) -> float:
    """Return ``phi(Phi^-1(alpha)) / (1 - alpha)``: CVaR of a Gaussian is its mean plus so many deviations."""
    normal = NormalDist()
    return normal.pdf(normal.inv_cdf(alpha)) / (1 - alpha)


def variance_target(mean: Tensor, next_mean: Tensor, next_variance: Tensor, batch: Batch) -> Tensor:
    """Return ``c^2 + 2 gamma c Q' + gamma^2 (V' + Q'^2) - Q^2``, at least `LEAST_VARIANCE`, ``(S, B)``."""
    second_moment = (
        batch.cost.square()
        + 2 * batch.discount * batch.cost * next_mean
        + batch.discount.square() * (next_variance + next_mean.square())
    )
    return (second_moment - mean.square()).clamp(min=LEAST_VARIANCE)


class Wcsac(Method):
    """A critic of the mean and the variance of the cost; the actor pays lambda times the Gaussian CVaR."""

    @property
    def cost_outputs(self) -> int:
        """Return 2: the mean, and the variance before softplus."""
        return 2

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
        """Descend the squared 2-Wasserstein distance ``(Q - T)^2 + (sqrt V - sqrt T_V)^2`` to the target."""
        with torch.no_grad():
            next_mean, next_variance = _mean_and_variance(critic.target(next_inputs))
            mean_target = batch.cost + batch.discount * next_mean
        mean, variance = _mean_and_variance(critic.weights(inputs))
        target = variance_target(mean.detach(), next_mean, next_variance, batch)
        distance = (mean - mean_target).square() + (variance.sqrt() - target.sqrt()).square()
        loss = distance.mean(-1)  # (S,)
        critic.descend(grad(loss.sum(), critic.weights.layers), learning_rate)
        return {"cost_critic_loss": loss.detach(), "cost_value": mean.detach().mean(-1)} if measure else {}

    def action_cost(self, outputs: Tensor, budget: Tensor) -> Tensor:
        """Return the Gaussian CVaR of the discounted cost."""
        mean, variance = _mean_and_variance(outputs)
        return mean + gaussian_cvar_factor(self.options.alpha) * variance.sqrt()

    def slack(self, costs: EpochCosts) -> float:
        """Return ``b`` minus the Gaussian CVaR of the episode costs."""
        factor = gaussian_cvar_factor(self.options.alpha)
        return self.options.cost_limit - float(costs.episodes.mean() + factor * costs.episodes.std())


def _mean_and_variance(outputs: Tensor) -> tuple[Tensor, Tensor]:
    return outputs[..., 0], softplus(outputs[..., 1]) + LEAST_VARIANCE
