"""The actions that are really attained in a box: the inner side of every bound."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from viatool.policy.network import Network
from viatool.taylor.derivatives import gradient_bounds

Floats = NDArray[np.float64]

_STEPS = 4


def climb(network: Network, lower: Floats, upper: Floats, start: Floats, seed: Floats) -> tuple[Floats, Floats]:
    """Search boxes for a large value of a combination of actions, corner by corner along the gradient.

    Parameters
    ----------
    network : Network
        n inputs, A outputs.
    lower, upper : ndarray
        ``(B, n)`` boxes.
    start : ndarray
        ``(B, n)`` first points.
    seed : ndarray
        ``(B, A)``: the combination ``seed . actions`` to maximise.

    Returns
    -------
    tuple of ndarray
        The best points found (B, n), inside the boxes, and their values (B,) in float64.

    Notes
    -----
    Each step jumps to the corner that the gradient at the present point names; a step that does not improve is retried
    half-way. **Sound:** as an inner bound, yes: every value is attained by a point of the box.
    """
    best = np.clip(start, lower, upper)
    value = (network(best) * seed).sum(axis=1)
    point = best
    for _ in range(_STEPS):
        gradient = _gradient(network, point, seed)
        corner = np.where(gradient > 0, upper, np.where(gradient < 0, lower, point))
        reached = (network(corner) * seed).sum(axis=1)
        better = reached > value
        best = np.where(better[:, None], corner, best)
        value = np.where(better, reached, value)
        point = np.where(better[:, None], corner, best / 2 + corner / 2)
    return best, value


def _gradient(network: Network, points: Floats, seed: Floats) -> Floats:
    values = network.values(points)
    low, high = gradient_bounds(network, [(value, value) for value in values], seed)
    middle = low / 2 + high / 2
    return np.where(np.isfinite(middle), middle, 0.0)
