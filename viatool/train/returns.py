"""n-step returns: what an action earned and cost over n steps, and from where to bootstrap."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import torch
from torch import Tensor

from viatool.train.replay import Batch


class Transition(NamedTuple):
    """One step of S times E robots; observations are normalised."""

    observation: Tensor  # (S, E, n)
    next_observation: Tensor  # (S, E, n), of a finished episode its last
    action: Tensor  # (S, E, A) in [-1, 1]
    reward: Tensor  # (S, E)
    cost: Tensor  # (S, E)
    terminated: Tensor  # (S, E) bool: ended by goal or collision
    truncated: Tensor  # (S, E) bool: ended by the horizon alone


class NStepReturns:
    """Turns transitions into n-step ones; an episode's end cuts the sum short.

    Parameters
    ----------
    steps : int
        n; 1 gives the transitions themselves.
    discount : float
        gamma.

    Notes
    -----
    Transition t leaves with ``sum_(i<k) gamma^i r_(t+i)``, the same sum of costs, the observation ``s_(t+k)``
    and the factor of its bootstrap: ``gamma^k``, but 0 if the episode terminated within the k steps. k is n,
    or less if the episode ended earlier. A truncated episode keeps its factor: the state after it had a
    future.
    """

    def __init__(self, steps: int, discount: float) -> None:
        self.steps = steps
        self.discount = discount
        self._pending: deque[tuple[Batch, Tensor]] = deque()  # with (S, E): 1 while the episode goes on

    def push(self, transition: Transition) -> Batch | None:
        """Take the newest transition; return the one of n - 1 steps ago, complete, or None at first."""
        fresh = Batch(
            transition.observation,
            transition.next_observation,
            transition.action,
            torch.zeros_like(transition.reward),
            torch.zeros_like(transition.cost),
            torch.ones_like(transition.reward),
        )
        self._pending.append((fresh, torch.ones_like(transition.reward)))
        self._pending = deque(
            _extend(batch, alive, transition, self.discount) for batch, alive in self._pending
        )
        return self._pending.popleft()[0] if len(self._pending) == self.steps else None


def _extend(batch: Batch, alive: Tensor, step: Transition, discount: float) -> tuple[Batch, Tensor]:
    """Add one step to the sums of the robots whose episode still goes on."""
    going = alive > 0
    factor = batch.discount * alive
    extended = Batch(
        observation=batch.observation,
        next_observation=torch.where(going.unsqueeze(-1), step.next_observation, batch.next_observation),
        action=batch.action,
        reward=batch.reward + factor * step.reward,
        cost=batch.cost + factor * step.cost,
        discount=torch.where(going, batch.discount * discount * ~step.terminated, batch.discount),
    )
    return extended, alive * ~(step.terminated | step.truncated)
