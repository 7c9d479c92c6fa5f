"""How far the command changes where readings jump: a penalty on restless policies."""

from __future__ import annotations

import torch
from torch import Tensor

from viatool.train.networks import Weights
from viatool.train.updates import act


def jumped(observation: Tensor, bins: int, generator: torch.Generator) -> Tensor:
    """Return observations in each of which one LiDAR bin reads what one of its neighbours does.

    That is what a small step or turn does to a scan at the edge of an obstacle: a ray of the one bin has passed it.

    Parameters
    ----------
    observation : Tensor
        ``(S, B, n)``, its first entries the bins in the order of their directions; normalised or not.
    bins : int
        Two at least.
    generator : torch.Generator
        Draws the bins, the same for all seeds.

    Returns
    -------
    Tensor
        ``(S, B, n)``.
    """
    count = observation.shape[1]
    first = torch.randint(0, bins - 1, (count,), generator=generator)
    either = torch.randint(0, 2, (count,), generator=generator)
    changed, copied, states = first + either, first + 1 - either, torch.arange(count)
    found = observation.clone()
    found[:, states, changed] = observation[:, states, copied]
    return found


def restlessness(actor: Weights, observation: Tensor, other: Tensor) -> Tensor:
    """Return the mean absolute difference of two actions in [-1, 1] of S seeds, ``(S,)``; differentiable."""
    return (act(actor, observation) - act(actor, other)).abs().mean((1, 2))
