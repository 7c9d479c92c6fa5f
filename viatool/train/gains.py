"""How strongly actions answer to errors of the sensors, and a limit to that which a projection keeps."""

from __future__ import annotations

import torch
from torch import Tensor

from viatool.train.networks import HiddenActivation, Weights

_STEEPEST: dict[HiddenActivation, float] = {
    "relu": 1.0,
    "elu": 1.0,
    "tanh": 1.0,
    "sigmoid": 0.25,
    "softplus": 1.0,
    "silu": 1.1,  # 1.09984 at 2.3994
    "gelu": 1.13,  # 1.12890 at the square root of 2
}
"""No slope of these functions is larger."""

_SPARE = 1e-6  # of the limit, for the rounding of weights to float32


def action_gain(actor: Weights, error: Tensor) -> Tensor:
    """Bound how far an error of the inputs moves each action.

    Parameters
    ----------
    actor : Weights
        S perceptrons, n to A; the action is tanh of the output.
    error : Tensor
        ``(n,)`` how far each input may be off, normalised.

    Returns
    -------
    Tensor
        ``(S, A)`` float64; an error of t times `error` moves no action, in [-1, 1], by more than t times this.

    Notes
    -----
    Sound: in real arithmetic. Neither what the view does to an input nor tanh is steeper than 1, and a hidden
    activation no steeper than L, so that the bound is ``|W_1| ... |W_K| L^(K - 1)`` from the error's side: a sum over
    all paths through the network, which never exceeds the product of the layers' norms.
    """
    with torch.no_grad():
        seen = error if actor.view is None else error.index_select(0, actor.view.columns)
        moved = seen.double().expand(actor.seeds, 1, -1)
        steepest = _STEEPEST[actor.activation]
        for index in range(0, len(actor.layers), 2):
            slope = 1.0 if index == 0 else steepest
            moved = slope * (moved @ actor.layers[index].abs().double())
        return moved.squeeze(1)


def limit_gain(actor: Weights, error: Tensor, limit: float) -> None:
    """Make the last layer's weights of every action smaller whose `action_gain` exceeds a limit; the bias stays."""
    gain = action_gain(actor, error)
    factor = (limit * (1.0 - _SPARE) / gain.clamp(min=1e-300)).clamp(max=1.0)
    with torch.no_grad():
        actor.layers[-2].mul_(factor.unsqueeze(1).to(torch.float32))
