"""The distributional cost critic: noncrossing quantiles, quantile regression, and the tail value V_C.

Notation of the paper: M quantiles ``q_i``, midpoints ``tau_i = (2 i - 1) / (2 M)``, budget ``e``.
"""

from __future__ import annotations

from functools import lru_cache

import torch
from torch import Tensor
from torch.nn.functional import softplus


@lru_cache
def quantile_midpoints(count: int) -> Tensor:
    """Return the midpoints ``(tau_(i-1) + tau_i) / 2`` of the fractions ``tau_i = i / M``, ``(M,)``."""
    return (torch.arange(count, dtype=torch.float32) + 0.5) / count


def noncrossing_quantiles(logits: Tensor) -> Tensor:
    """Turn the outputs of the cost network into M ascending quantiles: ``q_i = k phi_i + d``.

    Parameters
    ----------
    logits : Tensor
        ``(..., M + 2)``: M logits of the increments, then the raw slope ``f_k``, then the shift ``d``.

    Returns
    -------
    Tensor
        ``(..., M)`` with ``k = softplus(f_k) > 0`` and ``phi_i`` the cumulated softmax, so that
        ``q_i <= q_(i+1)``.
    """
    increments, slope, shift = torch.split(logits, [logits.shape[-1] - 2, 1, 1], dim=-1)
    return softplus(slope) * increments.softmax(-1).cumsum(-1) + shift


def quantile_huber_gradient(predicted: Tensor, target: Tensor, kappa: float = 1.0) -> Tensor:
    """Return the gradient of the quantile Huber loss with respect to the predicted quantiles.

    The loss of one state is ``1/M^2 sum_i sum_j |tau_i - 1{d_ij < 0}| H(d_ij) / kappa`` with
    ``d_ij = target_j - predicted_i`` and Huber's ``H``, whose derivative is ``clip(d_ij, -kappa, kappa)``.

    Parameters
    ----------
    predicted, target : Tensor
        ``(S, B, M)``; the target is a constant.
    kappa : float
        Where the loss turns from quadratic to linear.

    Returns
    -------
    Tensor
        ``(S, B, M)``.

    Notes
    -----
    Written by hand since automatic differentiation would keep five ``(S, M, M, B)`` arrays. With ``c`` the
    clipped difference, ``|tau - 1{d < 0}| c = tau c + (1 - 2 tau) min(c, 0)``. The states come last in these
    arrays: long rows, whatever the number of quantiles.
    """
    count = predicted.shape[-1]
    midpoints = quantile_midpoints(count).unsqueeze(-1)
    rows, columns = predicted.mT.contiguous().unsqueeze(2), target.mT.contiguous().unsqueeze(1)
    clipped = (columns - rows).clamp_(-kappa, kappa)  # (S, M, M, B)
    both = clipped.sum(2)  # (S, M, B)
    negative = clipped.clamp_(max=0.0).sum(2)
    return (midpoints * both).addcmul_(1 - 2 * midpoints, negative).div_(-kappa * count**2).mT


def quantile_huber_loss(predicted: Tensor, target: Tensor, kappa: float = 1.0) -> Tensor:
    """Return the loss of each state, ``(..., M)`` to ``(...)``; see `quantile_huber_gradient`."""
    difference = target.unsqueeze(-2) - predicted.unsqueeze(-1)
    size = difference.abs()
    huber = torch.where(size <= kappa, 0.5 * difference.square(), kappa * (size - 0.5 * kappa))
    midpoints = quantile_midpoints(predicted.shape[-1]).unsqueeze(-1)
    weight = (midpoints - (difference < 0).to(midpoints.dtype)).abs()
    return (weight * huber / kappa).mean((-2, -1))


def tail_cost(quantiles: Tensor, budget: Tensor, alpha: float) -> Tensor:
    """Return V_C, the mean of the quantiles that reach the budget.

    Parameters
    ----------
    quantiles : Tensor
        ``(..., M)``, ascending.
    budget : Tensor
        ``(...)``, the budget ``e`` of each state.
    alpha : float
        CVaR level; it sets the fallback.

    Returns
    -------
    Tensor
        ``(...)``. Where no quantile reaches the budget the paper's ratio is 0/0; there it is the mean of the
        upper ``(1 - alpha) M`` quantiles (at least one), the CVaR of the predicted distribution itself.
    """
    count = quantiles.shape[-1]
    reached = (quantiles >= budget.unsqueeze(-1)).to(quantiles.dtype)
    none = reached[..., -1:] == 0  # ascending: the last one decides
    weight = torch.where(none, _upper_tail(count, alpha), reached)
    return (quantiles * weight).sum(-1) / weight.sum(-1)


@lru_cache
def _upper_tail(count: int, alpha: float) -> Tensor:
    """Return ``(M,)`` with 1 for the upper ``(1 - alpha) M`` quantiles (at least one) and 0 for the others."""
    tail = max(1, round((1 - alpha) * count))
    return (torch.arange(count) >= count - tail).to(torch.float32)
