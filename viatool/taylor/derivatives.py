"""Bounds of the derivatives of the actions over a box, by interval arithmetic backwards through the network."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from viatool.arrays import Floats, Hull
from viatool.policy.network import Activation, Affine, Cast, Input, Maximum, Minimum, Network, Node, Product
from viatool.rounding import ENGINE_ROUNDOFF, SLIGHTLY_MORE
from viatool.taylor.curve import curve_of
from viatool.taylor.rounding import gamma


def gradient_bounds(network: Network, hulls: Sequence[Hull], seed: Floats) -> Hull:
    """Bound the gradient of a combination of the actions over boxes.

    Parameters
    ----------
    network : Network
        n inputs, A outputs.
    hulls : sequence of (lower, upper)
        For each node, bounds (B, size) of its value over the box.
    seed : ndarray
        ``(B, A)``: the combination ``seed . actions``.

    Returns
    -------
    tuple of ndarray
        Lower and upper bounds (B, n) of its partial derivatives. At a kink every generalised derivative counts; over
        a jump they are infinite.

    Notes
    -----
    **Sound:** yes; interval reverse-mode differentiation in centre-radius form, rounding counted.
    """
    last = len(network.nodes) - 1
    adjoints: dict[int, Hull] = {last: (seed, np.zeros_like(seed))}
    for index in range(last, 0, -1):
        node = network.nodes[index]
        if index not in adjoints:
            continue
        for source, contribution in _bounds_pulled_back(node, adjoints.pop(index), hulls):
            _accumulate(adjoints, source, contribution)
    shape = hulls[0][0].shape
    centre, radius = adjoints.get(0, (np.zeros(shape), np.zeros(shape)))
    return centre - radius, centre + radius


def _bounds_pulled_back(node: Node, adjoint: Hull, hulls: Sequence[Hull]) -> list[tuple[int, Hull]]:
    """Return what the adjoint of a node, as centre and radius, adds to those of its sources."""
    centre, radius = adjoint
    match node:
        case Input():
            return []
        case Affine():
            return [(source, _mapped(adjoint, node, k)) for k, source in enumerate(node.sources)]
        case Activation() if node.function.passes_on:
            return [(node.source, adjoint)]
        case Activation():
            slopes = curve_of(node.function).range(*hulls[node.source], 1)
            return [(node.source, _scaled(centre, radius, slopes.lower, slopes.upper))]
        case Product():
            return [
                (node.left, _scaled(centre, radius, *hulls[node.right])),
                (node.right, _scaled(centre, radius, *hulls[node.left])),
            ]
        case Maximum() | Minimum():
            left, right = hulls[node.left], hulls[node.right]
            if isinstance(node, Minimum):
                left, right = right, left
            wins = np.where(left[0] >= right[1], 1.0, 0.0)
            may_win = np.where(left[1] <= right[0], 0.0, 1.0)
            return [
                (node.left, _scaled(centre, radius, wins, may_win)),
                (node.right, _scaled(centre, radius, 1 - may_win, 1 - wins)),
            ]
        case Cast():
            return [(node.source, adjoint)]


def gradient(network: Network, points: Floats, seed: Floats) -> Floats:
    """Return the gradient (B, n) of ``seed . actions`` at points (B, n), one-sided at kinks. Not a bound."""
    values = network.values(points)
    adjoints: dict[int, Floats] = {len(network.nodes) - 1: seed}
    for index in range(len(network.nodes) - 1, 0, -1):
        node = network.nodes[index]
        if index not in adjoints:
            continue
        adjoint = adjoints.pop(index)
        for source, contribution in _pulled_back(node, adjoint, values):
            adjoints[source] = adjoints[source] + contribution if source in adjoints else contribution
    result = adjoints.get(0, np.zeros_like(points))
    return np.where(np.isfinite(result), result, 0.0)


def _pulled_back(node: Node, adjoint: Floats, values: Sequence[Floats]) -> list[tuple[int, Floats]]:
    match node:
        case Input():
            return []
        case Affine():
            return [
                (source, adjoint @ weight) for source, weight in zip(node.sources, node.weights, strict=True)
            ]
        case Activation():
            return [(node.source, adjoint * curve_of(node.function).value(values[node.source], 1))]
        case Product():
            return [(node.left, adjoint * values[node.right]), (node.right, adjoint * values[node.left])]
        case Maximum() | Minimum():
            left_wins = (values[node.left] >= values[node.right]) == isinstance(node, Maximum)
            return [(node.left, adjoint * left_wins), (node.right, adjoint * ~left_wins)]
        case Cast():
            return [(node.source, adjoint)]


def _accumulate(adjoints: dict[int, Hull], node: int, contribution: Hull) -> None:
    centre, radius = contribution
    if node in adjoints:
        old_centre, old_radius = adjoints[node]
        centre, radius = old_centre + centre, old_radius + radius
        radius = (radius + 2 * ENGINE_ROUNDOFF * np.abs(centre)) * SLIGHTLY_MORE
    adjoints[node] = (centre, radius)


def _mapped(adjoint: Hull, node: Affine, source: int) -> Hull:
    """Multiply an adjoint by the weights of one source; what was merged counts as large as before it cancelled."""
    (centre, radius), weight = adjoint, node.weights[source]
    absolute, merged = node.absolute_weights[source], node.magnitudes[source]
    rounding = gamma(weight.shape[0] + 2 + node.roundings, ENGINE_ROUNDOFF) * (np.abs(centre) + radius)
    spread = (radius + rounding) @ absolute if merged is absolute else radius @ absolute + rounding @ merged
    return centre @ weight, spread * SLIGHTLY_MORE + 1e-300


def _scaled(centre: Floats, radius: Floats, lower: Floats, upper: Floats) -> Hull:
    """Multiply ``centre +- radius`` by ``[lower, upper]``."""
    with np.errstate(invalid="ignore", over="ignore"):
        middle = lower / 2 + upper / 2
        half = np.maximum(upper - middle, middle - lower)
        product = centre * middle
        spread = np.abs(centre) * half + radius * (np.abs(middle) + half)
        spread = (spread + 2 * ENGINE_ROUNDOFF * np.abs(product)) * SLIGHTLY_MORE + 1e-300
    unbounded = ~np.isfinite(product) | ~np.isfinite(spread)
    zero = (centre == 0) & (radius == 0)
    product = np.where(unbounded, 0.0, product)
    return product, np.where(zero, 0.0, np.where(unbounded, np.inf, spread))
