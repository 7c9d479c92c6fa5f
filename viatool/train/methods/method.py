"""What distinguishes one constraint method from another; everything else is the common TD3 backbone."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

from torch import Tensor

from viatool.arrays import Floats
from viatool.train.configuration import TrainingConfiguration
from viatool.train.networks import TrainedNetwork
from viatool.train.replay import Batch

Metrics = dict[str, Tensor]


@dataclass(frozen=True)
class EpochCosts:
    """What the constraint is judged by at the end of an epoch, for one seed.

    Parameters
    ----------
    var : float
        u with which the episodes were driven.
    episodes : ndarray
        ``(N,)`` undiscounted costs of the episodes with little exploration noise, N at least 1.
    start : float
        Mean predicted cost of the policy's action in the start states, as by `Method.action_cost`; 0 without
        a cost critic.
    """

    var: float
    episodes: Floats
    start: float


class Method(ABC):
    """How costs enter the training.

    Parameters
    ----------
    options : TrainingConfiguration
        CVaR level, limits, quantiles.
    """

    budgeted: bool = False
    """The budget channel follows the cost of the episode; without it, it stays 0."""

    constrained: bool = True
    """There is a multiplier; without one lambda is 0."""
    embedded: bool = False
    """The learner is that of TD7."""

    def __init__(self, options: TrainingConfiguration) -> None:
        self.options = options

    @property
    def cost_outputs(self) -> int:
        """Return how many outputs the cost critic has; 0 for no cost critic."""
        return 0

    def learnt_reward(self, batch: Batch, multiplier: Tensor) -> Tensor:
        """Return the reward that the task critics learn, ``(S, B)``; `multiplier` is ``(S,)``."""
        return batch.reward

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
        """Take one step of the cost critic.

        Parameters
        ----------
        critic : TrainedNetwork
            Updated in place.
        inputs, next_inputs : Tensor
            ``(S, B, f + A)`` of the transition's action and of the smoothed target action after it.
        batch : Batch
            The transitions.
        learning_rate : float
            Of this step.
        measure : bool
            Also compute metrics that the step does not need.
        """
        return {}

    def action_cost(self, outputs: Tensor, budget: Tensor) -> Tensor:
        """Return what lambda weighs in the actor's loss.

        Parameters
        ----------
        outputs : Tensor
            ``(S, B, cost_outputs)`` of the cost critic.
        budget : Tensor
            ``(S, B)``, the budget e of each state.

        Returns
        -------
        Tensor
            ``(S, B)``.
        """
        raise NotImplementedError(f"{type(self).__name__} has no cost critic")

    @abstractmethod
    def slack(self, costs: EpochCosts) -> float | None:
        """Return by how much the constraint holds (negative: is violated); None leaves lambda as it is."""
