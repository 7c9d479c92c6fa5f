"""Up to which number a network tells its inputs apart: what it takes the least with before anything else."""

from __future__ import annotations

import numpy as np

from viatool.arrays import Floats, Indices
from viatool.policy.network import Activation, Affine, Cast, Input, Maximum, Minimum, Network, Node, Product
from viatool.policy.weights import dense

_MIXED = -1


def ceilings(network: Network) -> Floats:
    """Return up to which number a network tells each of its inputs apart.

    Parameters
    ----------
    network : Network
        n inputs.

    Returns
    -------
    ndarray
        (n,); an input that is larger gives what this number gives. Infinite where that is not known.

    Notes
    -----
    Sound: yes, in every precision: only inputs that are copied and clipped count, and both are exact.
    """
    found = np.full(network.input_size, -np.inf)
    copied: list[Indices] = []
    last = len(network.nodes) - 1
    for index, node in enumerate(network.nodes):
        made = _copies(node, copied, network.input_size)
        taken = _taken(node, copied, made)
        if index == last:
            taken.append((made, np.inf))
        for columns, limit in taken:
            np.maximum.at(found, columns[columns != _MIXED], limit)
        copied.append(made)
    return np.where(found == -np.inf, np.inf, found)


def _copies(node: Node, copied: list[Indices], inputs: int) -> Indices:
    """Return of which input each number of a node is a copy, (N,); `_MIXED` where it is none."""
    match node:
        case Input():
            return np.arange(inputs)
        case Affine():
            return _copied_by(node, copied)
        case Activation() | Product() | Maximum() | Minimum() | Cast():
            return np.full(node.size, _MIXED)


def _copied_by(node: Affine, copied: list[Indices]) -> Indices:
    """Return of which input each row is a copy: its only weight is 1, and nothing is added."""
    if not node.sources:
        return np.full(node.size, _MIXED)
    weights = np.concatenate([dense(weight) for weight in node.weights], axis=1)
    before = np.concatenate([copied[source] for source in node.sources])
    alone = (np.count_nonzero(weights, axis=1) == 1) & (weights.sum(axis=1) == 1.0) & (node.bias == 0.0)
    return np.where(alone, before[weights.argmax(axis=1)], _MIXED)


def _taken(node: Node, copied: list[Indices], made: Indices) -> list[tuple[Indices, float]]:
    """Return which inputs a node takes otherwise than as a copy, and up to which number it tells them apart."""
    match node:
        case Input():
            return []
        case Activation():
            clips = node.function.name == "Clip"
            return [(copied[node.source], node.function.named.get("max", np.inf) if clips else np.inf)]
        case Affine():
            mixing = made == _MIXED
            return [
                (copied[source][dense(weight)[mixing].any(axis=0)], np.inf)
                for source, weight in zip(node.sources, node.weights, strict=True)
            ]
        case Product() | Maximum() | Minimum() | Cast():
            return [(copied[source], np.inf) for source in node.sources]
