"""What a network allows: how many states go together, so that arrays stay small, and what is worth its time."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from math import comb

import numpy as np

from viatool.arrays import Floats, Indices
from viatool.policy.network import Activation, Affine, Network
from viatool.taylor.forms import MOST_SYMBOLS
from viatool.taylor.propagation import Box

CACHED_FLOATS = 400_000
"""Floats in the largest array of a pass that works in the cache."""

LARGEST_FLOATS = 4_000_000
"""Floats in the largest array of a pass over one state: some ten such arrays stay below half a gigabyte."""

_KEPT_FLOATS = 2.0**26
"""Floats that the nodes of a network keep together in one pass, as those of a recurrent layer with many steps do."""

_LEAST_STATES = 8
"""States of a pass through a network so wide that nothing stays in the cache: enough to share the work of Python."""

_CONDITIONS = 64
"""Conditions of one dual bound, about, each of which has a coefficient for each symbol."""

_OPERATIONS = 4e9
"""Multiplications of what refines the bounds of one state: some tenths of a second."""

_LEAST_PARTS, _MOST_PARTS = 512, 1024
"""Parts of a box that are examined for one command of a choice; the most where passes cost little."""

_SMALL = 4e6
"""Multiplications of a pass over one state up to which tighter bounds cost some milliseconds at most."""

_KEPT_IN_PASSING = 3e6
"""Coefficients that a pass over one state keeps up to which it takes less than a tenth of a second."""

_ALIKE = 4
"""Free inputs by which the boxes of one pass of higher order may differ."""


def blocks_of_states(network: Network, count: int) -> list[slice]:
    """Cut `count` states into those that are bounded together, all their questions with them."""
    return _blocks(network, count, CACHED_FLOATS, 256)


def blocks_of_questions(network: Network, count: int) -> list[slice]:
    """Cut `count` questions, each with a box of its own, into those that one pass of order 1 takes together."""
    return _blocks(network, count, LARGEST_FLOATS // 2, 2048)


def blocks_of_parts(network: Network, count: int) -> list[slice]:
    """Cut `count` parts of boxes into those that branch and bound takes together, each with all its conditions."""
    symbols = network.input_size + sum(node.size for node in network.nodes if isinstance(node, Activation))
    step = max(_LEAST_STATES, LARGEST_FLOATS // (symbols * _CONDITIONS))
    return [slice(start, min(start + step, count)) for start in range(0, count, step)]


def _blocks(network: Network, count: int, floats: int, most: int) -> list[slice]:
    step = _together(network, floats, most)
    return [slice(start, min(start + step, count)) for start in range(0, count, step)]


@lru_cache(maxsize=64)
def _together(network: Network, floats: int, most: int) -> int:
    widest = max(node.size for node in network.nodes)
    each = widest * (network.input_size + min(widest // 2, MOST_SYMBOLS))
    least = int(np.clip(2 * LARGEST_FLOATS // each, 1, _LEAST_STATES))
    step = int(np.clip(floats // each, least, most))
    return min(step, max(1, int(_KEPT_FLOATS / _floats_of_a_pass(network))))


def blocks_of_order(network: Network, box: Box, order: int, largest: int) -> Iterator[Indices]:
    """Yield the boxes that a pass of a higher order takes together, those with about as many free inputs.

    Monomials grow with the `order`-th power of the free inputs. Boxes without any, and those of which one alone needs
    more than `largest` floats in an array, are left out.
    """
    free, floats = (box.upper > box.lower).sum(axis=1), floats_of_order(network, box, order)
    rows = np.flatnonzero((free > 0) & (floats <= largest))
    rows = rows[np.argsort(free[rows], kind="stable")]
    for some in np.split(rows, np.flatnonzero(np.diff(free[rows] // _ALIKE)) + 1):
        if some.size:
            step = max(1, CACHED_FLOATS // int(floats[some[-1]]))
            yield from (some[start : start + step] for start in range(0, some.size, step))


def floats_of_order(network: Network, box: Box, order: int) -> Floats:
    """Return the size of the largest array of a pass over each box alone, (B,)."""
    free = (box.upper > box.lower).sum(axis=1)
    widest = max(node.size for node in network.nodes)
    sizes = [(comb(k + order, order) - 1) * max(k, widest) for k in range(int(free.max(initial=0)) + 1)]
    return np.asarray(np.array(sizes, dtype=np.float64)[free])


def affords_passes(network: Network, count: int) -> bool:
    """Tell whether so many passes of order 1 over single boxes are worth their time, for one state."""
    return count * _operations_of_a_pass(network) <= _OPERATIONS


def affordable_parts(network: Network) -> int:
    """Return how many parts of a box are worth their time for one command of a choice."""
    return int(np.clip(_OPERATIONS / max(_operations_of_a_pass(network), 1.0), _LEAST_PARTS, _MOST_PARTS))


def refines_at_once(network: Network) -> bool:
    """Tell whether bounds may be refined without asking first whether those of one pass do."""
    return _operations_of_a_pass(network) <= _SMALL


def bounds_in_passing(network: Network) -> bool:
    """Tell whether a pass over a state costs little enough where nothing depends on its bounds."""
    return _floats_of_a_pass(network) <= _KEPT_IN_PASSING


@lru_cache(maxsize=64)
def _floats_of_a_pass(network: Network) -> float:
    """Return about how many coefficients a pass of order 1 keeps of all nodes together, for one state."""
    symbols, kept = 0, 0.0
    for node in network.nodes:
        if not isinstance(node, Affine):
            symbols = min(symbols + node.size, MOST_SYMBOLS)
        kept += float(node.size) * (network.input_size + symbols)
    return kept


@lru_cache(maxsize=64)
def _operations_of_a_pass(network: Network) -> float:
    symbols, operations = network.input_size, 0.0
    for node in network.nodes:
        if isinstance(node, Affine):
            operations += sum(2.0 * symbols * weight.size for weight in node.weights)
        elif isinstance(node, Activation):
            symbols = min(symbols + node.size, MOST_SYMBOLS)
    return operations


def affordable_squares(symbols: int, questions: int) -> int:
    """Return the neurons whose curvature may be traded for squares in all questions of one state, see `squares`.

    A question of C squares in S symbols takes about ``2 C^2 S + 6 C^3`` multiplications.
    """
    counts = np.arange(16, 1025, 16)
    costs = questions * (2.0 * counts**2 * symbols + 6.0 * counts**3)
    affordable = int((costs <= _OPERATIONS).sum())
    return int(counts[affordable - 1]) if affordable else 0
