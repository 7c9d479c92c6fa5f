"""RCPO (Tessler, Mankowitz and Mannor, 2019) on TD3: the cost is subtracted from the reward."""

from __future__ import annotations

from torch import Tensor

from viatool.train.methods.method import EpochCosts, Method
from viatool.train.replay import Batch


class Rcpo(Method):
    """The task critics learn ``r - lambda c``; lambda follows the expected episode cost.

    The reward of a replayed transition is penalised with the lambda of now, not with that of its recording.
    """

    def learnt_reward(self, batch: Batch, multiplier: Tensor) -> Tensor:
        """Return ``r - lambda c``."""
        return batch.reward - multiplier.unsqueeze(-1) * batch.cost

    def slack(self, costs: EpochCosts) -> float:
        """Return ``b - mean C``."""
        return self.options.cost_limit - float(costs.episodes.mean())
