"""Differentiable bounds of the actors' actions over boxes of observations: a penalty on wide reachable sets."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from viatool.train.networks import HiddenActivation, Weights


def action_width(actor: Weights, observation: Tensor, radius: Tensor) -> Tensor:
    """Bound how far the actions of S seeds spread over boxes around observations.

    Parameters
    ----------
    actor : Weights
        S perceptrons, n to A; the action is tanh of the output.
    observation : Tensor
        ``(S, B, n)``, normalised.
    radius : Tensor
        ``(n,)`` half widths of the box, normalised; 0 for a channel without error.

    Returns
    -------
    Tensor
        ``(S, B, A)`` upper minus lower bound, actions in [-1, 1]; differentiable by the weights.

    Notes
    -----
    Sound: in real arithmetic; float32 rounding is not counted, a penalty needs no proof. A value is
    ``c + G z + r [-1, 1]`` with ``z`` in ``[-1, 1]^n``, one generator for each uncertain input: exact through
    an affine layer, and through an activation a line of one slope and the largest distance from it (Singh et
    al., *Fast and Effective Robustness Certification*, 2018). Cost: B n rows through every layer, against B.
    """
    seeds, count, _ = observation.shape
    centre, reach = (observation, radius) if actor.view is None else actor.view.box(observation, radius)
    reach = reach.expand_as(centre)
    uncertain = reach.amax((0, 1)).nonzero().squeeze(-1)
    generators = torch.diag_embed(reach)[:, :, uncertain]  # (S, B, G, n)
    rest = torch.zeros_like(centre)
    for index in range(0, len(actor.layers), 2):
        matrix, bias = actor.layers[index : index + 2]
        centre = torch.baddbmm(bias, centre, matrix)
        generators = (generators.reshape(seeds, -1, matrix.shape[1]) @ matrix).view(
            seeds, count, len(uncertain), matrix.shape[2]
        )
        rest = rest @ matrix.abs()
        spread = generators.abs().sum(2) + rest
        if index == len(actor.layers) - 2:
            return (centre + spread).tanh() - (centre - spread).tanh()
        slope, offset, error = _ENCLOSE[actor.activation](centre - spread, centre + spread)
        centre = slope * centre + offset
        generators = slope.unsqueeze(2) * generators
        rest = slope * rest + error
    raise ValueError("an actor has at least one layer")


def _enclose_relu(lower: Tensor, upper: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return slope, offset and error of the chord's band: ``|relu(x) - slope x - offset| <= error``."""
    above, below = upper.clamp(min=0.0), lower.clamp(max=0.0)
    slope = (above / (above - below).clamp(min=1e-12)).clamp(max=1.0)
    half = -0.5 * slope * below
    return slope, half, half


def _enclose_tanh(lower: Tensor, upper: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return slope, offset and error of the band with the least slope on the interval, that of its worse end."""
    low, high = lower.tanh(), upper.tanh()
    slope = 1.0 - torch.maximum(low.square(), high.square())
    first, last = low - slope * lower, high - slope * upper  # tanh(x) - slope x grows with x
    return slope, 0.5 * (last + first), 0.5 * (last - first)


_ENCLOSE: dict[HiddenActivation, Callable[[Tensor, Tensor], tuple[Tensor, Tensor, Tensor]]] = {
    "relu": _enclose_relu,
    "tanh": _enclose_tanh,
}

ENCLOSED = tuple(_ENCLOSE)
"""Activations of actors whose width can be bounded."""
