"""Independent answers: what a network computes, exactly or in high precision.

Nothing here imports `viatool.taylor`, so that a wrong bound and a wrong answer have no common cause; the
activations are written down a second time, from their textbook definitions.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from fractions import Fraction
from typing import Any

import mpmath
import numpy as np

from viatool.policy.activations import ActivationFunction
from viatool.policy.network import Activation, Affine, Cast, Input, Maximum, Minimum, Network, Product

MP = mpmath.mp.clone()
"""High-precision arithmetic of 240 bits."""
MP.prec = 240


def _gelu_tanh(x: Any) -> Any:
    return x / (1 + MP.exp(-2 * MP.sqrt(2 / MP.pi) * (x + MP.mpf(0.044715) * x**3)))


def _softplus(x: Any) -> Any:
    return max(x, 0) + MP.log1p(MP.exp(-abs(x)))


def _mish(x: Any) -> Any:
    faded = MP.exp(-abs(x))  # x tanh(log(1 + e^x)) without overflow
    grown, one = (1 + faded) ** 2, MP.mpf(1)
    if x > 0:
        one = faded**2
        return x * (grown - one) / (grown + one)
    return x * faded * (2 + faded) / (grown + one)


DEFINITIONS: dict[str, Callable[..., Any]] = {
    "Abs": abs,
    "Celu": lambda x, alpha: x if x >= 0 else alpha * MP.expm1(x / alpha),
    "Clip": lambda x, min, max: min if x < min else max if x > max else x,
    "ClippedTan": lambda x, min, max: MP.tan(min if x < min else max if x > max else x),
    "Elu": lambda x, alpha: x if x >= 0 else alpha * MP.expm1(x),
    "Erf": lambda x: MP.erf(x),
    "ErfGate": lambda x, slope, divisor: x * MP.erfc(-slope * x / divisor),
    "Exp": lambda x: MP.exp(x),
    "Gelu": lambda x: x * MP.erfc(-x / MP.sqrt(2)) / 2,
    "GeluTanh": _gelu_tanh,
    "Guard": lambda x, min, max: x,
    "HardShrink": lambda x, lambd: x if abs(x) > lambd else 0 * x,
    "HardSigmoid": lambda x, alpha, beta: max(0, min(1, alpha * x + beta)),
    "HardSigmoidGate": lambda x, alpha, beta: x * max(0, min(1, alpha * x + beta)),
    "HardSwish": lambda x: x * max(0, min(1, (x + 3) / 6)),
    "Known": lambda x, min, max: x,
    "LeakyRelu": lambda x, alpha: x if x >= 0 else alpha * x,
    "Log": lambda x: MP.log(x),
    "LogSoftmax": lambda x, terms: -_softplus(-x),
    "Logistic": lambda x: 1 / (1 + MP.exp(-x)),
    "Mish": _mish,
    "Pow": lambda x, exponent: x ** int(exponent),
    "Reciprocal": lambda x: 1 / x,
    "Relu": lambda x: max(x, 0),
    "Selu": lambda x, alpha, gamma: gamma * (x if x >= 0 else alpha * MP.expm1(x)),
    "Sigmoid": lambda x: 1 / (1 + MP.exp(-x)),
    "RecurrentSigmoid": lambda x: 1 / (1 + MP.exp(-x)),
    "Sign": lambda x: (x > 0) - (x < 0),
    "Silu": lambda x: x / (1 + MP.exp(-x)),
    "SoftShrink": lambda x, lambd: max(x - lambd, 0) + min(x + lambd, 0),
    "Softmax": lambda x, terms: 1 / (1 + MP.exp(-x)),
    "Softplus": _softplus,
    "SoftplusThreshold": lambda x, threshold: x if x > threshold else _softplus(x),
    "Softsign": lambda x: x / (1 + abs(x)),
    "SpelledSigmoid": lambda x: 1 / (1 + MP.exp(-x)),
    "SpelledTanh": lambda x: MP.tanh(x),
    "Sqrt": lambda x: MP.sqrt(x),
    "Swish": lambda x, slope: x / (1 + MP.exp(-slope * x)),
    "Tanh": lambda x: MP.tanh(x),
    "RecurrentTanh": lambda x: MP.tanh(x),
    "TanhGate": lambda x, slope, cubic: 2 * x / (1 + MP.exp(-2 * slope * (x + cubic * x**3))),
    "Threshold": lambda x, threshold, value: x if x > threshold else value,
    "ThresholdedRelu": lambda x, alpha: x if x > alpha else 0 * x,
}
"""Every activation in high precision; those of `RATIONAL` are exact on fractions as well."""

RATIONAL = frozenset(
    {
        "Abs",
        "Clip",
        "HardShrink",
        "HardSigmoid",
        "HardSigmoidGate",
        "HardSwish",
        "LeakyRelu",
        "Pow",
        "Reciprocal",
        "Relu",
        "Sign",
        "SoftShrink",
        "Softsign",
        "Threshold",
        "ThresholdedRelu",
    }
)
"""Activations that map rationals to rationals."""


def activate(function: ActivationFunction, x: Any) -> Any:
    """Evaluate an activation at a high-precision number."""
    return DEFINITIONS[function.name](x, **{name: MP.mpf(value) for name, value in function.parameters})


def kinks(function: ActivationFunction) -> list[float]:
    """Return the points at which an activation, or one of its derivatives, is not continuous."""
    parameters = dict(function.parameters)
    match function.name:
        case "Clip" | "ClippedTan":
            return [value for value in parameters.values() if np.isfinite(value)]
        case "HardSigmoid" | "HardSigmoidGate":
            alpha, beta = parameters["alpha"], parameters["beta"]
            return [-beta / alpha, (1 - beta) / alpha]
        case "HardSwish":
            return [-3.0, 3.0]
        case "ThresholdedRelu":
            return [parameters["alpha"]]
        case "Threshold" | "SoftplusThreshold":
            return [parameters["threshold"]]
        case "HardShrink" | "SoftShrink":
            return [-parameters["lambd"], parameters["lambd"]]
        case "Abs" | "Celu" | "Elu" | "LeakyRelu" | "Relu" | "Selu" | "Sign" | "Softsign":
            return [0.0]
        case "Log" | "Reciprocal" | "Sqrt":
            return [0.0]
    return []


def derivative(function: ActivationFunction, x: Any, order: int) -> Any:
    """Differentiate an activation inside a smooth piece, to about 40 digits, by central differences."""
    with MP.workprec(900):
        x = MP.mpf(x)
        if order == 0:
            return activate(function, x)
        distance = min((abs(x - kink) for kink in kinks(function)), default=MP.mpf(1))
        step = MP.mpf(10) ** -30 * min(1, distance)
    with MP.workprec(500 + int(-(order + 1) * MP.log(step, 2))):
        total = MP.mpf(0)
        for k in range(order + 1):
            sign = (-1) ** (order - k) * MP.binomial(order, k)
            total += sign * activate(function, x + (2 * k - order) * step)
        return total / (2 * step) ** order


# --- whole networks --------------------------------------------------------------------------------------


def precise(network: Network, point: Sequence[Any]) -> list[Any]:
    """Return the actions at one point in high precision."""
    return precise_values(network, point)[-1]


def precise_values(network: Network, point: Sequence[Any]) -> list[list[Any]]:
    """Return the values of every node at one point in high precision."""
    return _values(network, point, MP.mpf, activate)


def exact(network: Network, point: Sequence[float]) -> list[Fraction]:
    """Return the actions at one point as fractions; networks of `RATIONAL` activations only."""
    return exact_values(network, point)[-1]


def exact_values(network: Network, point: Sequence[float]) -> list[list[Fraction]]:
    """Return the values of every node at one point as fractions; networks of `RATIONAL` activations only."""
    return _values(network, point, Fraction, _exactly)


def gradient(network: Network, point: Sequence[float], action: int) -> list[Any]:
    """Differentiate one action at a point away from kinks, to about 1e-40, by central differences."""
    step = MP.mpf(10) ** -24
    slopes = []
    for k in range(len(point)):
        ends = []
        for sign in (1, -1):
            moved = [MP.mpf(x) for x in point]
            moved[k] += sign * step
            ends.append(precise(network, moved)[action])
        slopes.append((ends[0] - ends[1]) / (2 * step))
    return slopes


def is_rational(network: Network) -> bool:
    """Whether `exact` can evaluate a network."""
    return all(node.function.name in RATIONAL for node in network.nodes if isinstance(node, Activation))


def _exactly(function: ActivationFunction, x: Fraction) -> Fraction:
    parameters = {name: v if np.isinf(v) else Fraction(v) for name, v in function.parameters}
    return Fraction(DEFINITIONS[function.name](x, **parameters))


def _values(
    network: Network,
    point: Sequence[Any],
    number: Callable[[Any], Any],
    activated: Callable[[ActivationFunction, Any], Any],
) -> list[list[Any]]:
    values: list[list[Any]] = []
    for node in network.nodes:
        match node:
            case Input():
                values.append([number(x) for x in point])
            case Affine():
                values.append(_affine(node, values, number))
            case Activation():
                values.append([activated(node.function, x) for x in values[node.source]])
            case Product():
                values.append([a * b for a, b in zip(values[node.left], values[node.right], strict=True)])
            case Maximum():
                values.append([max(a, b) for a, b in zip(values[node.left], values[node.right], strict=True)])
            case Minimum():
                values.append([min(a, b) for a, b in zip(values[node.left], values[node.right], strict=True)])
            case Cast():
                values.append(values[node.source])
    return values


def _affine(node: Affine, values: list[list[Any]], number: Callable[[float], Any]) -> list[Any]:
    results = []
    for row in range(node.size):
        total = number(float(node.bias[row]))
        for source, weight in zip(node.sources, node.weights, strict=True):
            for column in np.flatnonzero(weight[row]).tolist():
                total += number(float(weight[row, column])) * values[source][column]
        results.append(total)
    return results
