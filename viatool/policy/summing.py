"""Networks that are the same but for when a program rounds a constant that it adds to a sum.

A product with a matrix and an addition after it, as exporters write them, are one affine node where a runtime joins
them: the constant is one more term of the sum. What is allowed for the rounding of a sum holds in any order of its
terms, and the program that adds the constant last, to a sum that it has rounded, is one of these orders. So bounds that
hold for what programs make of the joined nodes hold for what they make of the single ones, and need no second pass.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from viatool.policy.assembly import renumbered
from viatool.policy.identity import is_same
from viatool.policy.network import Affine, Network, Node
from viatool.policy.weights import is_scaling


@lru_cache(maxsize=64)
def without_other_orders(networks: tuple[Network, ...]) -> tuple[Network, ...]:
    """Return networks without those whose programs sum as a program of another one may.

    Parameters
    ----------
    networks : tuple of Network
        All that may run.

    Returns
    -------
    tuple of Network
        Those that are left, in their order. **Sound:** bounds of their programs, in any order of summation, hold for
        the programs of all; the exact networks are the same functions.
    """
    if len(networks) == 1:
        return networks
    joined = {network: with_constants_in_sums(network) for network in networks}
    return tuple(
        network
        for network in networks
        if not any(
            other is not network and joined[network] is not network and is_same(joined[network], other)
            for other in networks
        )
    )


def with_constants_in_sums(network: Network) -> Network:
    """Return the network in which a constant that is added to a whole sum is a term of it; itself if there is none.

    Notes
    -----
    The exact function is the same, to the bit of its numbers: only sums without a constant of their own take one, and
    only those of which nothing else is read.
    """
    readers = np.bincount([source for node in network.nodes for source in node.sources] + [0])
    nodes: list[Node] = []
    place: list[int] = []
    for node in network.nodes:
        moved = renumbered(node, place)
        if isinstance(moved, Affine) and _adds_constants(moved) and readers[node.sources[0]] == 1:
            before = nodes[moved.sources[0]]
            if isinstance(before, Affine) and before.precision == moved.precision and _is_bare_sum(before):
                nodes[moved.sources[0]] = replace(before, bias=moved.bias)
                place.append(moved.sources[0])
                continue
        nodes.append(moved)
        place.append(len(nodes) - 1)
    return network if len(nodes) == len(network.nodes) else Network(tuple(nodes))


def _adds_constants(node: Affine) -> bool:
    """Tell whether a node adds a constant to each number of its source, and does nothing else."""
    return len(node.sources) == 1 and _as_written(node) and is_scaling(node.weights[0])


def _is_bare_sum(node: Affine) -> bool:
    """Tell whether a node adds weighted numbers and no constant."""
    return bool(node.sources) and _as_written(node) and not node.bias.any()


def _as_written(node: Affine) -> bool:
    """Tell whether weights and constants are those of the program, each one term."""
    return node.roundings == 0 and node.merged_weights is None and node.merged_bias is None
