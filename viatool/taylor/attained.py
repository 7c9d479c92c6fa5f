"""The actions that are really attained in a box: the inner side of every bound, and a search for extreme ones."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from viatool.arrays import Floats
from viatool.policy.network import Network
from viatool.taylor.derivatives import gradient
from viatool.taylor.propagation import Box
from viatool.taylor.refinement import Extrema


class Searchable(Protocol):
    """P sets of observations, of which a search needs points that are in them."""

    def nearest(self, points: Floats) -> Floats:
        """Return points of the sets near given ones, (P, n)."""

    def corner(self, slope: Floats, point: Floats) -> Floats:
        """Return where linear functions of slopes (P, n) are large, (P, n), seen from points (P, n)."""


def climb(
    network: Network, box: Searchable, seed: Floats, start: Floats, *, steps: int = 4
) -> tuple[Floats, Floats]:
    """Go from corner to corner of boxes along the gradient of a combination of the actions.

    Parameters
    ----------
    network : Network
        n inputs, A outputs.
    box : Box
        P boxes, or other sets that can be searched.
    seed : ndarray
        ``(P, A)``: the combination ``seed . actions`` that shall grow.
    start : ndarray
        ``(P, n)``: where the search begins; what lies outside of its box is moved to the nearest point of it.
    steps : int
        Corners that are tried.

    Returns
    -------
    ndarray
        ``(P, n)``: the best points that were found in the boxes.
    ndarray
        ``(P,)``: ``seed . actions`` there, in float64.

    Notes
    -----
    Each step jumps to the corner that the gradient at the present point names; after a step that does not improve, the
    next starts half-way. **Sound:** as an inner bound, yes.
    """
    best = point = box.nearest(start)
    value = (network(best) * seed).sum(axis=1)
    for _ in range(steps):
        slope = gradient(network, point, seed)
        corner = box.corner(slope, point)
        reached = (network(corner) * seed).sum(axis=1)
        better = reached > value
        best = np.where(better[:, None], corner, best)
        value = np.where(better, reached, value)
        point = np.where(better[:, None], corner, best / 2 + corner / 2)
    return best, np.asarray(value)


def attained_actions(
    network: Network, box: Box, extrema: Extrema, *, steps: int = 4
) -> tuple[Floats, Floats]:
    """Search B boxes for extreme actions.

    Parameters
    ----------
    network : Network
        n inputs, A outputs.
    box : Box
        B boxes.
    extrema : Extrema
        ``2 A B`` questions about them; the search starts from the middle of each question's face.
    steps : int
        As for `climb`.

    Returns
    -------
    ndarray
        ``(2 A B, n)``: points of the boxes.
    ndarray
        ``(2 A B,)``: values of ``seed . actions`` there, in float64.
    """
    copies = extrema.bound.size // box.lower.shape[0] if extrema.bound.size else 0
    boxes = Box(np.tile(box.lower, (copies, 1)), np.tile(box.upper, (copies, 1)))
    return climb(network, boxes, extrema.seed, extrema.box.centre, steps=steps)
