"""A network as a trunk and a monotone head: what happens to each action by itself at the end.

The squash, the scaling and the clip at the end of an actor act on each action alone and keep its order. So the extrema
of an action are the images of the extrema of the trunk, and no approximation of the squash is needed.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

from viatool.arrays import Floats, Hull
from viatool.policy.network import (
    Activation,
    Affine,
    Cast,
    Input,
    Maximum,
    Minimum,
    Network,
    Node,
    Product,
)
from viatool.policy.weights import dense
from viatool.taylor.curve import curve_of
from viatool.taylor.propagation import interval_image

HeadNode = Affine | Activation
"""What a head is made of."""


@lru_cache(maxsize=64)
def split_head(network: Network) -> tuple[Network, tuple[HeadNode, ...]]:
    """Cut a network where only increasing functions of single actions follow.

    Returns
    -------
    Network
        The trunk.
    tuple of HeadNode
        The head: the remaining nodes, each reading the one before it.
    """
    cut, head = len(network.nodes), list[HeadNode]()
    while (node := _increasing(network.nodes[cut - 1])) and node.sources == (cut - 2,):
        cut -= 1
        head.insert(0, node)
    return Network(network.nodes[:cut], network.calls[:cut]), tuple(head)


def values_through(head: Sequence[HeadNode], values: Floats) -> Floats:
    """Evaluate a head in float64 on values of the trunk's actions, (B, A)."""
    for node in head:
        values = _value(node, values)
    return values


def hulls_through(head: Sequence[HeadNode], hulls: Sequence[Hull]) -> list[Hull]:
    """Continue the hulls of a trunk's nodes through its head by interval arithmetic. **Sound:** yes."""
    hulls = list(hulls)
    for node in head:
        hulls.append(_hull(node, hulls))
    return hulls


def _value(node: HeadNode, value: Floats) -> Floats:
    match node:
        case Affine():
            return value @ node.weights[0].T + node.bias
        case Activation():
            return node.function(value)


def _hull(node: HeadNode, hulls: Sequence[Hull]) -> Hull:
    match node:
        case Affine():
            return interval_image([hulls[source] for source in node.sources], node)
        case Activation():
            value = curve_of(node.function).range(*hulls[node.source])
            return value.lower, value.upper


def _increasing(node: Node) -> HeadNode | None:
    """Return the node if it keeps the order of every action by itself, else None."""
    match node:
        case Activation():
            return node if curve_of(node.function).is_increasing else None
        case Affine():
            return node if node.is_elementwise and bool((dense(node.weights[0]) >= 0).all()) else None
        case Input() | Product() | Maximum() | Minimum() | Cast():
            return None
