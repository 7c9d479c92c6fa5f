"""Whether two networks are one: the same operations on the same numbers."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np

from viatool.policy.network import Activation, Affine, Cast, Input, Maximum, Minimum, Network, Node, Product
from viatool.policy.weights import digest


def is_same(first: Network, second: Network) -> bool:
    """Whether two networks are one: the same operations on the same numbers, bit for bit.

    Returns
    -------
    bool
        True only if both outputs come from the same kinds of nodes with the same numbers in all fields (weights,
        parameters, precisions, counts of roundings), applied to the same sources. In what order nodes stand, and in
        what order a sum, product, minimum or maximum names its sources, makes no difference: neither does it in
        the bounds.
    """
    numbers: dict[object, int] = {}
    return _number_of(first, numbers) == _number_of(second, numbers)


def _number_of(network: Network, numbers: dict[object, int]) -> int:
    """Return the number of the output, where equal nodes of whatever network have one number."""
    own: list[int] = []
    for node in network.nodes:
        own.append(numbers.setdefault(_identity(node, own), len(numbers)))
    return own[-1]


_WIRING = frozenset(("source", "sources", "left", "right", "weights", "merged_weights"))
"""Fields that name sources, or have an entry for each."""


def _identity(node: Node, own: list[int]) -> object:
    """Return all that makes a node what it is, given the numbers of those before it.

    Every field counts that does not name sources, whatever fields a kind of node may be given one day.
    """
    parameters = tuple(
        _plain(getattr(node, entry.name)) for entry in fields(node) if entry.name not in _WIRING
    )
    wiring: tuple[object, ...]
    match node:
        case Affine():
            terms = zip(node.sources, node.weights, node.magnitudes, strict=True)
            wiring = tuple(
                sorted((own[source], digest(weight), digest(size)) for source, weight, size in terms)
            )
        case Product() | Maximum() | Minimum():
            wiring = tuple(sorted((own[node.left], own[node.right])))
        case Input() | Activation() | Cast():
            wiring = tuple(own[source] for source in node.sources)
    return type(node), parameters, wiring


def _plain(value: Any) -> Any:
    """Return a value that compares equal to another if both are the same, bit for bit."""
    if isinstance(value, np.ndarray):
        return digest(value)
    return value
