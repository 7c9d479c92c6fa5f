"""The one place that knows how floating-point programs round.

Two programs are accounted for: the engine itself, in float64, and the deployed one, in the precision that each node
names. `own_error` bounds what one node adds to the errors that reach it, for any order of summation and with or without
fused multiply-add; `deviation` carries these errors to the actions.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from viatool.arrays import Floats, Hull
from viatool.errors import EnclosureError
from viatool.policy.activations import ActivationFunction
from viatool.policy.network import Activation, Affine, Cast, Input, Maximum, Minimum, Node, Precision, Product
from viatool.rounding import SLIGHTLY_MORE, SMALLEST_NORMAL, UNIT_ROUNDOFF
from viatool.sets.bounds import require_ordered

# Error of a runtime's activation in unit roundoffs of `error_scale`, at least twice what was ever measured in
# onnxruntime; composites (Silu as x * sigmoid(x), ...) count each of their operations.
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
    "Guard": 0.0,
    "Known": 0.0,
    "SpelledSigmoid": 32.0,
    "SpelledTanh": 32.0,
    "Exp": 16.0,
    "Logistic": 24.0,
    "LogSoftmax": 1.0,
    "Sigmoid": 8.0,
    "Softmax": 1.0,
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

_RELATIVE_TO_VALUE = frozenset(("Logistic", "Pow", "Reciprocal", "Sqrt"))
"""IEEE 754 rounds these correctly, or they are a few products: they err relative to their value, however small.

So does a logistic that is spelled out, up to what its exponential errs by: ``1 / (1 + e (1 + d))`` is off by at most d
of itself.
"""

_SOFTMAX_UNITS = 48.0
"""Roundings of two exponentials, a quotient and a logarithm."""


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


def runtime_units(function: ActivationFunction) -> float:
    """Return the largest error of a runtime's activation in unit roundoffs of `error_scale`.

    A power with a small exponent is a few products, or the function of a library that is as good as two of them.
    """
    if function.name == "Pow":
        return max(4.0, 2.0 * function.parameters[0][1])
    return _RUNTIME_UNITS.get(function.name, _DEFAULT_UNITS)


def magnitude(hull: Hull) -> Floats:
    """Return the largest absolute value between two bounds."""
    return np.maximum(np.abs(hull[0]), np.abs(hull[1]))


def activation_error(
    function: ActivationFunction, precision: Precision, argument: Hull, value: Floats
) -> Floats:
    """Bound the error of a runtime's activation (B, N), given its argument and a bound on its absolute value."""
    units = runtime_units(function) * UNIT_ROUNDOFF[precision]
    own = units * error_scale(function, magnitude(argument), value)
    if function.name == "Guard":
        limits = dict(function.parameters)
        return np.where((argument[0] >= limits["min"]) & (argument[1] <= limits["max"]), 0.0, np.inf)
    if function.name == "Exp" or function.name in _RELATIVE_TO_VALUE:
        return own + _flushed(function.name, argument, SMALLEST_NORMAL[precision])
    if function.name in ("LogSoftmax", "Softmax"):  # every exponential may be flushed to zero
        own = own + 2 * dict(function.parameters)["terms"] * SMALLEST_NORMAL[precision]
    return np.asarray(own)


def _flushed(name: str, argument: Hull, tiny: float) -> Floats:
    """Bound what is lost where a program takes arguments and results below the smallest normal number for zero."""
    at_zero = {"Sqrt": np.sqrt(tiny), "Reciprocal": np.inf}.get(name, tiny)
    return np.where((argument[0] < tiny) & (argument[1] > -tiny), at_zero, tiny)


def error_scale(function: ActivationFunction, argument: Floats, value: Floats) -> Floats:
    """Return what the error of a runtime's activation is proportional to, given absolute values."""
    if function.name == "Logistic":  # errs by 16 max(1, |x|) y (1 - y), where y (1 - y) |x| <= 0.28
        return np.asarray(np.minimum(value * np.maximum(1.0, argument), value + 0.3))
    if function.name in _RELATIVE_TO_VALUE:
        return value
    if function.name == "Exp":
        return np.asarray(value * np.maximum(1.0, argument))
    if function.name in ("SpelledSigmoid", "SpelledTanh"):
        return np.maximum(1.0, value)
    if function.name == "Softmax":
        return np.asarray(value * _softmax_units(function) + np.minimum(value * argument, 1.0))
    if function.name == "LogSoftmax":
        return np.asarray(_softmax_units(function) + 2 * value)
    return np.asarray(function.amplitude * np.maximum(1.0, np.maximum(value, argument)))


def _softmax_units(function: ActivationFunction) -> float:
    """Return how many roundings a softmax of K values errs by, beside those of its logits' differences.

    Notes
    -----
    The program's ``exp(x_j - m)``, m the largest, errs by ``|x_j - m|`` roundings of itself for the difference, and by
    those of the exponential. Their mean over the softmax p errs by ``sum_j p_j |x_j - m| <= log K`` roundings, the sum
    by K more. The one in the numerator has ``|x_i - m|`` roundings, at most the magnitude of the log-odds, but never
    more than one of 1, since it is ``exp(-|x_i - m|)`` itself.
    """
    return _SOFTMAX_UNITS + 2 * dict(function.parameters)["terms"]
