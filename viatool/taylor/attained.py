"""The actions that are really attained in a box: the inner side of every bound."""

from __future__ import annotations

import numpy as np

from viatool.arrays import Floats
from viatool.policy.network import Network
from viatool.taylor.derivatives import gradient
from viatool.taylor.propagation import Box
from viatool.taylor.refinement import Extrema


def climb(network: Network, box: Box, extrema: Extrema, *, steps: int = 4) -> Floats:
    """Search boxes for extreme actions, corner by corner along the gradient.

    Parameters
    ----------
    network : Network
        n inputs, A outputs.
    box : Box
        B boxes.
    extrema : Extrema
        ``2 A B`` questions about them; the search starts from the middle of each question's face.
    steps : int
        Corners that are tried.

    Returns
    -------
    ndarray
        ``(2 A B,)``: values of ``seed . actions`` in float64, each attained at a point of its box.

    Notes
    -----
    Each step jumps to the corner that the gradient at the present point names; after a step that does not improve, the
    next starts half-way. **Sound:** as an inner bound, yes.
    """
    copies = extrema.bound.size // box.lower.shape[0] if extrema.bound.size else 0
    lower, upper = np.tile(box.lower, (copies, 1)), np.tile(box.upper, (copies, 1))
    seed = extrema.seed
    best = np.clip(extrema.box.centre, lower, upper)
    value = (network(best) * seed).sum(axis=1)
    point = best
    for _ in range(steps):
        slope = gradient(network, point, seed)
        corner = np.where(slope > 0, upper, np.where(slope < 0, lower, point))
        reached = (network(corner) * seed).sum(axis=1)
        better = reached > value
        best = np.where(better[:, None], corner, best)
        value = np.where(better, reached, value)
        point = np.where(better[:, None], corner, best / 2 + corner / 2)
    return np.asarray(value)
