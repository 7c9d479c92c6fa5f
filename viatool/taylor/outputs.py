"""What a network can give at all, whatever it takes: the range of its squash, or of its weights behind one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from viatool.arrays import Booleans, Floats, Hull
from viatool.policy.network import Activation, Affine, Cast, Input, Maximum, Minimum, Network, Node, Product
from viatool.rounding import LARGEST
from viatool.taylor.curve import curve_of
from viatool.taylor.propagation import interval_image
from viatool.taylor.rounding import affine_size, magnitude, own_error

_UNLIMITED = 1e30
"""An activation that gives as large a number is taken for one that limits nothing."""


def output_range(networks: Sequence[Network]) -> Hull:
    """Bound the numbers of a program whose networks these are, over all of their inputs.

    Parameters
    ----------
    networks : sequence of Network
        Those that may run, of K outputs each.

    Returns
    -------
    tuple of ndarray
        (K,) ends; infinite where nothing limits a number.

    Notes
    -----
    **Sound:** yes, for the exact networks and for what programs make of them, in any order of summation. Each node is
    bounded on what the program may have before it, with what it errs by itself.
    """
    ends = [_range(network) for network in networks]
    return np.minimum.reduce([low for low, _ in ends]), np.maximum.reduce([high for _, high in ends])


def _range(network: Network) -> Hull:
    found: list[Hull] = []
    with np.errstate(invalid="ignore", over="ignore"):
        for node in network.nodes:
            sources = [found[source] for source in node.sources]
            tame = [(np.where(_wild(end), 0.0, end[0]), np.where(_wild(end), 0.0, end[1])) for end in sources]
            lower, upper = _image(node, sources, tame)
            size = affine_size(node, tame) if isinstance(node, Affine) else magnitude((lower, upper))
            own = own_error(node, node.precision, [_held(end, node) for end in sources], size)
            found.append(_known(lower - own, upper + own))
    return found[-1][0][0], found[-1][1][0]


def _known(lower: Floats, upper: Floats) -> Hull:
    """Return ends, infinite both where one of them is no number, and rounded outward."""
    lost = np.isnan(lower) | np.isnan(upper)
    return (
        np.where(lost, -np.inf, np.nextafter(lower, -np.inf)),
        np.where(lost, np.inf, np.nextafter(upper, np.inf)),
    )


def _held(ends: Hull, node: Node) -> Hull:
    """Return ends with the largest floats in the place of infinite ones: no program holds more, but for infinity."""
    largest = LARGEST[node.precision]
    return np.maximum(ends[0], -largest), np.minimum(ends[1], largest)


def _wild(ends: Hull) -> Booleans:
    """Tell which numbers have an end that is not finite."""
    return ~(np.isfinite(ends[0]) & np.isfinite(ends[1]))


def _image(node: Node, sources: Sequence[Hull], tame: Sequence[Hull]) -> Hull:
    """Bound a node (1, N) that is evaluated exactly on numbers between two ends; in `tame`, 0 for unlimited ones."""
    match node:
        case Input():
            return np.full((1, node.size), -np.inf), np.full((1, node.size), np.inf)
        case Affine():
            return _affine(node, sources, tame)
        case Activation():
            value = curve_of(node.function).range(*_held(sources[0], node))
            beyond = np.maximum(np.abs(value.lower), np.abs(value.upper)) >= _UNLIMITED
            return np.where(beyond, -np.inf, value.lower), np.where(beyond, np.inf, value.upper)
        case Product():
            corners = [left * right for left in sources[0] for right in sources[1]]
            return np.minimum.reduce(corners), np.maximum.reduce(corners)
        case Maximum():
            return np.maximum(sources[0][0], sources[1][0]), np.maximum(sources[0][1], sources[1][1])
        case Minimum():
            return np.minimum(sources[0][0], sources[1][0]), np.minimum(sources[0][1], sources[1][1])
        case Cast():
            return sources[0]


def _affine(node: Affine, sources: Sequence[Hull], tame: Sequence[Hull]) -> Hull:
    """Bound an affine node: what takes an unlimited number is unlimited, the rest does not see it."""
    if not sources:
        return node.bias[None], node.bias[None]
    unlimited = np.zeros((1, node.size))
    for ends, absolute in zip(sources, node.absolute_weights, strict=True):
        unlimited = unlimited + _wild(ends).astype(np.float64) @ absolute.T
    lower, upper = interval_image(tame, node)
    return np.where(unlimited > 0.0, -np.inf, lower), np.where(unlimited > 0.0, np.inf, upper)
