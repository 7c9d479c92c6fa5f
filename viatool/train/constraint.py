"""The CVaR constraint outside the networks: budget recursion, value at risk, Lagrange multiplier.

All functions are pure and work on S seeds at once.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from viatool.arrays import Floats

VarRule = Literal["adaptive", "empirical"]
MultiplierRule = Literal["mean", "cvar"]


def next_budget(budget: Floats, cost: Floats, discount: float, limit: float) -> Floats:
    """Advance the budget by one step: ``e <- clip((e - c) / gamma, -limit, limit)``.

    Parameters
    ----------
    budget, cost : ndarray
        Of the same shape.
    discount : float
        gamma in (0, 1].
    limit : float
        The literal recursion grows by 1/gamma per step, twenty-fold over an episode of 300; it is clipped
        here.
    """
    return np.clip((budget - cost) / discount, -limit, limit)


def initial_var(costs: Floats, alpha: float) -> Floats:
    """Return ``(S,)`` u0, the empirical alpha-quantile of warm-up episode costs ``(S, N)``."""
    return np.asarray(np.quantile(costs, alpha, axis=1, method="inverted_cdf"), dtype=np.float64)


def update_var(
    var: float, costs: Floats, *, alpha: float, step: float, ceiling: float, rule: VarRule = "adaptive"
) -> tuple[float, dict[str, float]]:
    """Update the value at risk u of one seed from the episode costs of an epoch.

    Parameters
    ----------
    var : float
        u.
    costs : ndarray
        ``(N,)`` undiscounted episode costs; with none u stays.
    alpha : float
        CVaR level.
    step : float
        beta_u.
    ceiling : float
        u stays in ``[0, ceiling]``: above b the multiplier rule could only grow the multiplier.
    rule : str
        "adaptive" is the paper's ``u + beta_u (P(C >= u) - (1 - alpha))``; "empirical" is the quantile.

    Returns
    -------
    tuple
        The new u, and the metrics ``exceedance`` (P(C >= u) before the update) and ``cvar`` (empirical).

    Notes
    -----
    An episode without any cost never counts as an exceedance. Literally it would at u = 0, where P(C >= 0) =
    1: u could never rest at 0, the alpha-quantile of every policy that is safe in a share alpha of its
    episodes.
    """
    if costs.size == 0:
        return var, {"exceedance": float("nan"), "cvar": float("nan")}
    exceedance = float(np.mean((costs >= var) & (costs > 0.0)))
    if rule == "adaptive":
        updated = var + step * (exceedance - (1 - alpha))
    else:
        updated = float(np.quantile(costs, alpha, method="inverted_cdf"))
    return float(np.clip(updated, 0.0, ceiling)), {
        "exceedance": exceedance,
        "cvar": empirical_cvar(costs, alpha),
    }


def update_multiplier(multiplier: float, slack: float | None, *, step: float, maximum: float) -> float:
    """Update the Lagrange multiplier of one seed: ``Proj_[0, max] (lambda - beta_lambda slack)``.

    Parameters
    ----------
    multiplier : float
        lambda.
    slack : float or None
        By how much the constraint holds; ``b - u - mean C`` for VIA. None leaves lambda as it is.
    step, maximum : float
        beta_lambda and lambda_max.
    """
    if slack is None:
        return multiplier
    return float(np.clip(multiplier - step * slack, 0.0, maximum))


def empirical_cvar(costs: Floats, alpha: float) -> float:
    """Return CVaR of costs ``(N,)``: ``u + E[(C - u)+] / (1 - alpha)`` at its minimum, the alpha-quantile."""
    var = float(np.quantile(costs, alpha, method="inverted_cdf"))
    return var + float(np.mean(np.maximum(costs - var, 0.0))) / (1 - alpha)
