"""A network as a trunk and a monotone head: what happens to each action by itself at the end.

The squash, the scaling and the clip at the end of an actor act on each action alone and keep its order. So the extrema
of an action are the images of the extrema of the trunk, and no approximation of the squash is needed.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from viatool.arrays import Floats
from viatool.policy.network import Activation, Affine, Network, Node
from viatool.taylor.curve import curve_of


@lru_cache(maxsize=64)
def split_head(network: Network) -> tuple[Network, tuple[Node, ...]]:
    """Cut a network where only increasing functions of single actions follow.

    Returns
    -------
    Network
        The trunk.
    tuple of Node
        The head: the remaining nodes, each reading the one before it.
    """
    cut = len(network.nodes)
    while cut > 1 and _is_increasing(network.nodes[cut - 1]) and network.nodes[cut - 1].sources == (cut - 2,):
        cut -= 1
    return Network(network.nodes[:cut]), network.nodes[cut:]


def values_through(head: tuple[Node, ...], values: Floats) -> Floats:
    """Evaluate a head in float64 on values of the trunk's actions, (B, A)."""
    for node in head:
        if isinstance(node, Activation):
            values = node.function(values)
        else:
            assert isinstance(node, Affine)
            values = values @ node.weights[0].T + node.bias
    return values


def _is_increasing(node: Node) -> bool:
    if isinstance(node, Activation):
        return curve_of(node.function).is_increasing
    if isinstance(node, Affine) and len(node.weights) == 1:
        weight = node.weights[0]
        square = weight.shape[0] == weight.shape[1]
        return square and bool((weight == np.diag(np.diag(weight))).all() and (weight >= 0).all())
    return False
