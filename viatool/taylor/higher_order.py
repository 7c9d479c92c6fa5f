"""Passes of higher order: never worse than those of lower order, and only where their polynomials fit in memory."""

from __future__ import annotations

from collections.abc import Sequence

from viatool.arrays import Hull
from viatool.policy.network import Network
from viatool.taylor.approximation import Approximation
from viatool.taylor.memory import LARGEST_FLOATS, blocks_of_order
from viatool.taylor.propagation import Box, is_curved, propagate


def higher_hulls(
    network: Network,
    box: Box,
    hulls: Sequence[Hull],
    *,
    order: int,
    rule: Approximation,
    largest: int = LARGEST_FLOATS,
) -> list[Hull]:
    """Tighten the hulls of every node by passes of order 2 to `order`, each met with those before it.

    Parameters
    ----------
    network : Network
        n inputs, A outputs.
    box : Box
        B boxes.
    hulls : sequence of (lower, upper)
        For each node, bounds ``(B, size)`` from a pass of order 1.
    order : int
        The highest order.
    rule : str
        How activations are approximated.
    largest : int
        Floats in the largest array of a pass over one box; a box that needs more does without the pass.

    Returns
    -------
    list of (lower, upper)
        Bounds at most as wide; those given where the network is piecewise linear, of which a higher order sees nothing.

    Raises
    ------
    EnclosureError
        If an activation has no finite enclosure.

    Notes
    -----
    **Sound:** yes.
    """
    met = [(lower.copy(), upper.copy()) for lower, upper in hulls]
    for degree in range(2, order + 1) if is_curved(network) else ():
        for rows in blocks_of_order(network, box, degree, largest):
            known = [(lower[rows], upper[rows]) for lower, upper in met]
            passes = propagate(network, box.rows(rows), order=degree, rule=rule, known=known)
            for (lower, upper), enclosure in zip(met, passes, strict=True):
                lower[rows], upper[rows] = enclosure.hull
    return met
