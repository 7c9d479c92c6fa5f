"""How many states go together, so that arrays stay in the cache where they can, and small in any case."""

from __future__ import annotations

from collections.abc import Iterator
from math import comb

import numpy as np

from viatool.arrays import Indices
from viatool.policy.network import Network
from viatool.taylor.propagation import Box

CACHED_FLOATS = 400_000
"""Floats in the largest array of a pass that works in the cache."""

LARGEST_FLOATS = 4_000_000
"""Floats in the largest array of a pass over one state: some ten such arrays stay below half a gigabyte."""

_LEAST_STATES = 8
"""States of a pass through a network so wide that nothing stays in the cache: enough to share the work of Python."""

_ALIKE = 4
"""Free inputs by which the boxes of one pass of higher order may differ."""


def blocks_of_states(network: Network, count: int) -> list[slice]:
    """Cut `count` states into those that are bounded together, all their questions with them."""
    return _blocks(network, count, CACHED_FLOATS, 256)


def blocks_of_questions(network: Network, count: int) -> list[slice]:
    """Cut `count` questions, each with a box of its own, into those that one pass of order 1 takes together."""
    return _blocks(network, count, LARGEST_FLOATS // 2, 2048)


def _blocks(network: Network, count: int, floats: int, most: int) -> list[slice]:
    widest = max(node.size for node in network.nodes)
    step = int(np.clip(floats // (widest * (network.input_size + widest // 2)), _LEAST_STATES, most))
    return [slice(start, min(start + step, count)) for start in range(0, count, step)]


def blocks_of_order(network: Network, box: Box, order: int, largest: int) -> Iterator[Indices]:
    """Yield the boxes that a pass of a higher order takes together, those with about as many free inputs.

    Monomials grow with the `order`-th power of the free inputs. Boxes without any, and those of which one alone needs
    more than `largest` floats in an array, are left out.
    """
    free = (box.upper > box.lower).sum(axis=1)
    floats = np.array([_floats(network, count, order) for count in range(int(free.max(initial=0)) + 1)])
    rows = np.flatnonzero((free > 0) & (floats[free] <= largest))
    rows = rows[np.argsort(free[rows], kind="stable")]
    for some in np.split(rows, np.flatnonzero(np.diff(free[rows] // _ALIKE)) + 1):
        if some.size:
            step = max(1, CACHED_FLOATS // int(floats[free[some[-1]]]))
            yield from (some[start : start + step] for start in range(0, some.size, step))


def _floats(network: Network, free: int, order: int) -> int:
    """Return the size of the largest array over one state: monomials by neurons, or by the variables in them."""
    return (comb(free + order, order) - 1) * max(free, *(node.size for node in network.nodes))
