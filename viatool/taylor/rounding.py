"""The one place that knows how floating-point programs round.

Two programs are accounted for: the engine itself, in float64, and the deployed one, in the precision that each node
names. For the deployed program `runtime_deviation` bounds how far any evaluation, in any order of summation and with or
without fused multiply-add, can stray from the exact network anywhere in a box.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from viatool.arrays import Floats, Hull
from viatool.errors import EnclosureError
from viatool.policy.network import Activation, Affine, Cast, Input, Maximum, Minimum, Network, Product
from viatool.rounding import LARGEST, SLIGHTLY_MORE, SMALLEST_NORMAL, UNIT_ROUNDOFF
from viatool.sets.bounds import require_ordered
from viatool.taylor.curve import curve_of

# Error of a runtime's activation in unit roundoffs of max(1, |f(x)|, |x|), times the amplitude of its parameters, at
# least twice what was ever measured in onnxruntime; composites (Silu as x * sigmoid(x), ...) count each of their
# operations.
_RUNTIME_UNITS = {
    "Abs": 0.0,
    "Clip": 0.0,
    "Relu": 0.0,
    "ThresholdedRelu": 0.0,
    "LeakyRelu": 1.0,
    "Reciprocal": 4.0,
    "Sqrt": 4.0,
    "Elu": 8.0,
    "Celu": 8.0,
    "Sigmoid": 8.0,
    "HardSigmoid": 8.0,
    "Softsign": 8.0,
    "Erf": 12.0,
    "Tanh": 12.0,
    "Silu": 12.0,
    "HardSwish": 12.0,
    "Softplus": 24.0,
    "Gelu": 32.0,
    "GeluTanh": 32.0,
    "Selu": 48.0,
    "Mish": 96.0,
}
_DEFAULT_UNITS = 64.0


def gamma(terms: int | Floats, unit: float) -> Floats:
    """Return ``n u / (1 - n u)``: the relative error of a sum of n rounded products, in any order.

    Raises
    ------
    EnclosureError
        If ``n u >= 1``: so many terms in so low a precision have no error bound.
    """
    product = np.asarray(terms, dtype=np.float64) * unit
    if not (product < 0.5).all():
        raise EnclosureError(
            f"a sum of {np.max(terms):g} terms in a precision of unit roundoff {unit:g} has no useful error bound",
            "export the policy in float32",
        )
    return np.asarray(product / (1 - product) * SLIGHTLY_MORE)


def affine_rounding(node: Affine, unit: float) -> tuple[Floats, Floats]:
    """Return the relative error factor of each row ``(N,)`` and its number of rounded terms ``(N,)``.

    A row that copies or negates one value is exact, unless its weights stand for several operations.
    """
    terms = np.zeros(node.size)
    copies = np.ones(node.size, dtype=bool)
    for weight in node.magnitudes:
        terms += np.count_nonzero(weight, axis=1)
        copies &= np.isin(weight, (0.0, 1.0)).all(axis=1)
    has_bias = node.bias_magnitude != 0
    exact = (node.roundings == 0) & ((copies & (terms <= 1) & ~has_bias) | (terms == 0))
    rounded = np.where(exact, 0.0, terms + has_bias + 1 + node.roundings)
    return gamma(rounded, unit), rounded


def runtime_deviation(network: Network, hulls: Sequence[Hull], *, engine: bool = False) -> Floats:
    """Bound how far a floating-point evaluation strays from the exact network, anywhere in a box.

    Parameters
    ----------
    network : Network
        N nodes.
    hulls : sequence of (lower, upper)
        For each node, bounds ``(B, size)`` of its exact value over the box.
    engine : bool
        Account for `Network.__call__` in float64 on exact inputs, in place of the deployed program.

    Returns
    -------
    ndarray
        ``(B, A)``: ``|program(x) - network(x)| <= deviation`` for every x of the box, where the program first rounds x
        to its input precision.

    Raises
    ------
    EnclosureError
        If the program may overflow or divide by zero somewhere in the box.

    Notes
    -----
    **Sound:** yes, given the activation errors of `activation_error`. Forward error analysis: an affine node adds
    ``|W| E + gamma_n (|W| |x| + |b|)``, an activation ``E max|f'|`` plus its own error, a product the product rule.
    """
    deviations: list[Floats] = []
    for index, (node, hull) in enumerate(zip(network.nodes, hulls, strict=True)):
        deviation = _deviation(network, index, hulls, deviations, engine=engine) * SLIGHTLY_MORE
        _check_overflow(*hull, deviation, "float64" if engine else node.precision)
        deviations.append(deviation)
    return deviations[-1]


def _deviation(
    network: Network, index: int, hulls: Sequence[Hull], deviations: Sequence[Floats], *, engine: bool
) -> Floats:
    """Bound how far a node strays, given how far those before it do."""
    node = network.nodes[index]
    precision = "float64" if engine else node.precision
    unit = UNIT_ROUNDOFF[precision]
    match node:
        case Input():
            reach = _reach(hulls[index], np.zeros(()))
            return np.zeros_like(reach) if engine else unit * reach + SMALLEST_NORMAL[precision]
        case Affine():
            return _affine_deviation(node, hulls, deviations, precision)
        case Activation():
            return _activation_deviation(node, hulls[node.source], deviations[node.source], precision)
        case Product():
            return _product_deviation(node, hulls, deviations, unit) + SMALLEST_NORMAL[precision]
        case Maximum() | Minimum():
            return np.maximum(deviations[node.left], deviations[node.right])
        case Cast():
            deviation = deviations[node.source]
            if engine or unit <= UNIT_ROUNDOFF[network.nodes[node.source].precision]:
                return deviation
            return deviation + unit * _reach(hulls[index], deviation) + SMALLEST_NORMAL[precision]


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


def activation_error(name: str, precision: str) -> float:
    """Return the error of a runtime's activation, in units of ``amplitude * max(1, |f(x)|, |x|)``."""
    units = _RUNTIME_UNITS.get(name, _DEFAULT_UNITS)
    return units * UNIT_ROUNDOFF[precision]


def _reach(hull: Hull, deviation: Floats) -> Floats:
    return np.maximum(np.abs(hull[0]), np.abs(hull[1])) + deviation


def _affine_deviation(
    node: Affine,
    hulls: Sequence[Hull],
    deviations: Sequence[Floats],
    precision: str,
) -> Floats:
    factor, terms = affine_rounding(node, UNIT_ROUNDOFF[precision])
    tiny = SMALLEST_NORMAL[precision]
    inherited = np.zeros((hulls[0][0].shape[0], node.size))
    size = inherited + node.bias_magnitude
    for source, absolute, merged in zip(node.sources, node.absolute_weights, node.magnitudes, strict=True):
        inherited = inherited + deviations[source] @ absolute.T
        size = size + _reach(hulls[source], deviations[source]) @ merged.T
    _check_overflow(-size, size, np.zeros(()), precision)  # a partial sum may be larger than the result
    return inherited + factor * size + 2 * terms * tiny


def _activation_deviation(node: Activation, hull: Hull, inherited: Floats, precision: str) -> Floats:
    curve = curve_of(node.function)
    lower, upper = hull[0] - inherited, hull[1] + inherited
    slope = curve.range(lower, upper, 1)
    value = curve.range(lower, upper)
    with np.errstate(invalid="ignore"):
        moved = inherited * np.maximum(np.abs(slope.lower), np.abs(slope.upper))
    moved = np.where(inherited == 0, 0.0, moved)
    moved = np.fmin(moved, value.upper - value.lower)  # over a jump only the range helps
    size = node.function.amplitude * np.maximum(
        1.0, np.maximum(np.maximum(np.abs(value.lower), np.abs(value.upper)), _reach(hull, inherited))
    )
    return moved + activation_error(node.function.name, precision) * size


def _product_deviation(
    node: Product, hulls: Sequence[Hull], deviations: Sequence[Floats], unit: float
) -> Floats:
    left, right = (
        _reach(hulls[node.left], deviations[node.left]),
        _reach(hulls[node.right], deviations[node.right]),
    )
    return left * deviations[node.right] + right * deviations[node.left] + unit * left * right


def _check_overflow(lower: Floats, upper: Floats, deviation: Floats, precision: str) -> None:
    size = np.maximum(np.abs(lower), np.abs(upper)) + deviation
    if not (size < LARGEST[precision]).all():
        raise EnclosureError(
            f"an intermediate value may leave the range of {precision} (up to {float(np.max(size)):.3g})",
            "make eps smaller, or check the weights and the units of the observation",
        )
