"""How floating-point programs round, node by node.

Two programs are accounted for: the engine itself, in float64, and the deployed one, in the precision that each node
names. `own_error` bounds what one node adds to the errors that reach it, for any order of summation and with or without
fused multiply-add; `deviation` carries these errors to the actions. What a runtime's activations err by stands with
their declarations (`policy.activations`).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from viatool.arrays import Floats, Hull
from viatool.errors import EnclosureError
from viatool.policy.activations import ActivationFunction
from viatool.policy.network import (
    Activation,
    Affine,
    Cast,
    Input,
    Maximum,
    Minimum,
    Network,
    Node,
    Precision,
    Product,
)
from viatool.policy.weights import copies as copies_of
from viatool.policy.weights import positive_in
from viatool.policy.weights import terms as terms_of
from viatool.rounding import SLIGHTLY_MORE, SMALLEST_NORMAL, UNIT_ROUNDOFF
from viatool.sets.bounds import require_ordered


def gamma(terms: int | Floats, unit: float) -> Floats:
    """Return ``n u / (1 - n u)``: the relative error of a sum of n rounded products, in any order.

    Raises
    ------
    EnclosureError
        If ``n u >= 1``: so many terms in so low a precision have no error bound.
    """
    return _gamma(terms, unit) if isinstance(terms, np.ndarray) else _gamma_of_number(terms, unit)


@lru_cache(maxsize=1024)
def _gamma_of_number(terms: int, unit: float) -> Floats:
    return _gamma(terms, unit)


def _gamma(terms: int | Floats, unit: float) -> Floats:
    product = np.asarray(terms, dtype=np.float64) * unit
    if not (product < 0.5).all():
        raise EnclosureError(
            f"a sum of {np.max(terms):g} terms in a precision of unit roundoff {unit:g} has no useful error bound",
            "export the policy in float32",
        )
    return np.asarray(product / (1 - product) * SLIGHTLY_MORE)


@lru_cache(maxsize=1024)
def affine_rounding(node: Affine, unit: float) -> tuple[Floats, Floats]:
    """Return the relative error factor of each row ``(N,)`` and its number of rounded terms ``(N,)``.

    A row that copies or negates one value is exact, unless its weights stand for several operations.
    """
    terms = np.zeros(node.size)
    copies = np.ones(node.size, dtype=bool)
    for weight in node.magnitudes:
        terms += terms_of(weight)
        copies &= copies_of(weight)
    has_bias = node.bias_magnitude != 0
    exact = (node.roundings == 0) & ((copies & (terms <= 1) & ~has_bias) | (terms == 0))
    rounded = np.where(exact, 0.0, terms + has_bias + 1 + node.roundings)
    return gamma(rounded, unit), rounded


def own_error(node: Node, precision: Precision, sources: Sequence[Hull], value: Floats) -> Floats:
    """Bound what a program errs by itself in one node, on top of the errors of what it reads.

    Parameters
    ----------
    node : Node
        Of size N.
    precision : str
        In which it is evaluated.
    sources : sequence of (lower, upper)
        For each source, bounds ``(B, N_k)`` of what the program has there.
    value : ndarray
        ``(B, N)``: a bound on the absolute value of the node, evaluated exactly on what the program has there; of an
        affine node on that of every partial sum.

    Returns
    -------
    ndarray
        ``(B, N)``.

    Notes
    -----
    **Sound:** yes, given the units of `activation_error`. An affine node adds ``gamma_n (|W| |x| + |b|)``, a product
    one rounding, each with what is lost where numbers below the smallest normal one are flushed to zero.
    """
    unit, tiny = UNIT_ROUNDOFF[precision], SMALLEST_NORMAL[precision]
    match node:
        case Input():
            return unit * value + tiny
        case Affine():
            factor, terms = affine_rounding(node, unit)
            return np.asarray(factor * value + 2 * terms * tiny)
        case Activation():
            return activation_error(node.function, precision, sources[0], value)
        case Product():
            return unit * value + tiny
        case Maximum() | Minimum():
            return np.zeros_like(value)
        case Cast():
            return unit * value + tiny


_NEVER_NEGATIVE = ("Abs", "Exp", "Relu")


@lru_cache(maxsize=64)
def floors_of(network: Network, precision: Precision | None = None) -> tuple[Floats, ...]:
    """Return `floor_of` every node, evaluated in the precision of each or in a given one."""
    floors: list[Floats] = []
    for node in network.nodes:
        floors.append(floor_of(node, precision or node.precision, floors))
    return tuple(floors)


def floor_of(node: Node, precision: Precision, floors: Sequence[Floats]) -> Floats:
    """Return what no program has less of at a node (N,), whatever the observation is: -inf where nothing is known.

    Parameters
    ----------
    node : Node
        Of size N.
    precision : str
        In which it is evaluated.
    floors : sequence of ndarray
        Those of the nodes before it, (N_k,) each.

    Notes
    -----
    **Sound:** a square is not negative, and a sum of terms that are not never gets less by a further one, as rounding
    is monotone; so it is at least its constant, as it is stored. What is flushed to zero is not negative either. What
    may be added up otherwise than it stands there (`merged_weights`, as in a variance of one pass) may be anything.
    """
    unit, tiny = UNIT_ROUNDOFF[precision], SMALLEST_NORMAL[precision]
    match node:
        case Input():
            floor = np.full(node.size, -np.inf)
        case Affine():
            floor = _floor_of_sum(node, unit, floors)
        case Activation():
            square = node.function.name == "Pow" and node.function.named["exponent"] % 2 == 0
            positive = square or node.function.name in _NEVER_NEGATIVE
            floor = np.full(node.size, 0.0 if positive else -np.inf)
        case Product():
            both = (floors[node.left] >= 0) & (floors[node.right] >= 0)
            floor = np.where(both, 0.0, -np.inf)
        case Maximum():
            floor = np.maximum(floors[node.left], floors[node.right])
        case Minimum():
            floor = np.minimum(floors[node.left], floors[node.right])
        case Cast():
            floor = floors[node.source]
            floor = np.where(floor >= 0, floor * (1 - 2 * unit), -np.inf)
    return np.where((floor >= 0) & (floor < 2 * tiny), 0.0, floor)


def _floor_of_sum(node: Affine, unit: float, floors: Sequence[Floats]) -> Floats:
    if node.merged_weights is not None or node.merged_bias is not None:
        return np.full(node.size, -np.inf)
    positive = node.bias >= 0
    for source, weight in zip(node.sources, node.weights, strict=True):
        positive &= positive_in(weight, floors[source] >= 0)
    return np.where(positive, node.bias * (1 - gamma(3 + node.roundings, unit)), -np.inf)


def affine_size(node: Affine, sources: Sequence[Hull]) -> Floats:
    """Bound the absolute value (B, N) of every partial sum of an affine node, given what its sources may be."""
    size = node.bias_magnitude
    for source, merged in zip(sources, node.magnitudes, strict=True):
        size = size + magnitude(source) @ merged.T
    return np.asarray(size)


def widen(lower: Floats, upper: Floats, deviation: Floats) -> Hull:
    """Turn bounds of the exact network into bounds of what is at most `deviation` away, all (B, A).

    Raises
    ------
    BoundsError
        If a lower bound is above its upper one.

    Notes
    -----
    **Sound:** yes, rounded outward. A bound that is not a number becomes infinite: nothing is known.
    """
    lower, upper = np.where(np.isnan(lower), -np.inf, lower), np.where(np.isnan(upper), np.inf, upper)
    require_ordered("actions", lower, upper)
    lower, upper = np.nextafter(lower - deviation, -np.inf), np.nextafter(upper + deviation, np.inf)
    return np.where(np.isnan(lower), -np.inf, lower), np.where(np.isnan(upper), np.inf, upper)


def magnitude(hull: Hull) -> Floats:
    """Return the largest absolute value between two bounds."""
    return np.maximum(np.abs(hull[0]), np.abs(hull[1]))


def activation_error(
    function: ActivationFunction, precision: Precision, argument: Hull, value: Floats
) -> Floats:
    """Bound the error of a runtime's activation (B, N), given its argument and a bound on its absolute value."""
    error, parameters = function.error, function.named
    units = error.roundings(parameters) * UNIT_ROUNDOFF[precision]
    own = units * error.scale(parameters, magnitude(argument), value)
    return np.asarray(own + error.lost(parameters, argument, SMALLEST_NORMAL[precision]))
