"""The worst program that rounding permits: every error as large as it may be, with the sign that hurts."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from viatool.policy.network import Affine, Input, Network, Node, Product
from viatool.rounding import UNIT_ROUNDOFF
from viatool.taylor.deviation import _Carried
from viatool.taylor.propagation import Box, propagate

Floats = NDArray[np.float64]

_POINTS = 21
_TURNS = 6


def escape_of_worst_program(network: Network, lower: float, upper: float, *, with_symbols: bool) -> float:
    """Return how far the worst program leaves its bounds over a box, or strays beyond the deviation allowed there.

    All inputs move together between `lower` and `upper`, which are the ends of the box of each of them.
    """
    ends = np.full((1, network.input_size), lower), np.full((1, network.input_size), upper)
    hulls = [enclosure.hull for enclosure in propagate(network, Box(*ends))]
    allowed = _Carried(network, hulls, engine=False, with_symbols=with_symbols).to_actions()
    escapes = [-np.inf]
    for x in np.linspace(lower, upper, _POINTS):
        point = np.full((1, network.input_size), x)
        exact = network(point)[0, 0]
        for sign in (-1.0, 1.0):
            program = worst_program(network, point, sign)
            escapes.append(abs(program - exact) - allowed.deviation[0, 0])
            escapes += [program - allowed.upper[0, 0], allowed.lower[0, 0] - program]
    return float(max(escapes))


def worst_program(network: Network, point: Floats, sign: float) -> float:
    """Return what a program can make of the first action at a point, (1, n), the farther in the direction of a sign.

    Errors are chosen one node after the other by what they do to the action, and again with the others in place.
    """
    noise = [np.zeros_like(value) for value in network.values(point)]
    for _ in range(_TURNS):
        for index, node in enumerate(network.nodes):
            program = network.values(point, noise)
            size = own_error(node, program)
            for neuron in range(size.size):
                trials = []
                for error in (-size[neuron], 0.0, size[neuron]):
                    noise[index][0, neuron] = error
                    trials.append((sign * network.values(point, noise)[-1][0, 0], error))
                noise[index][0, neuron] = max(trials)[1]
    return float(network.values(point, noise)[-1][0, 0])


def own_error(node: Node, program: list[Floats]) -> Floats:
    """Return how far one node can err on what the program has before it, (N,); activations are taken as exact."""
    unit = UNIT_ROUNDOFF[node.precision]
    if isinstance(node, Input):
        return unit * np.abs(program[0][0])
    if isinstance(node, Product):
        return unit * np.abs(program[node.left][0] * program[node.right][0])
    if isinstance(node, Affine):
        size = np.abs(node.bias)
        terms = (node.bias != 0).astype(float)
        for source, weight in zip(node.sources, node.weights, strict=True):
            size = size + np.abs(weight) @ np.abs(program[source][0])
            terms += (weight != 0).sum(axis=1)
        roundings = np.where(terms > 1, terms, 0.0)
        return ((1 + unit) ** roundings - 1) * size
    return np.zeros(node.size)
