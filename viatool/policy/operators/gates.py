"""Activations that exporters write as several operators, recognised only where exactly equal.

Recognising ``x * sigmoid(x)`` as one function of x changes nothing in the program: as a product of two values
that move together it could not be bounded as closely.
"""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np

from viatool.policy.activations import ActivationFunction, activation
from viatool.policy.assembly import Assembly, Computed
from viatool.policy.network import Activation, Affine, Product
from viatool.policy.operators.variance import normalised
from viatool.policy.weights import is_scaling, scale_of


def gated(assembly: Assembly, left: Computed, right: Computed) -> Computed | None:
    """Return ``left * right`` as one activation where one operand is a function of the other, else None."""
    if left.shape != right.shape:
        return None
    for x, gate in ((left, right), (right, left)):
        for recognise in (_smooth_gate, _raised_gate):
            result = recognise(assembly, x, gate)
            if result is not None:
                return result
    return None


def _smooth_gate(assembly: Assembly, x: Computed, gate: Computed) -> Computed | None:
    """Recognise Silu, Mish and the product with a hard sigmoid."""
    node = assembly.nodes[gate.node]
    if not isinstance(node, Activation):
        return None
    if node.function.name == "Tanh":
        inner = Computed(node.source, gate.shape, gate.precision)
        argument = assembly.function_of(inner, "Softplus")
        return assembly.activation(x, "Mish") if argument is not None and argument.node == x.node else None
    if node.function.name in ("Sigmoid", "Logistic") and node.source != x.node:
        slope = _multiple(assembly, Computed(node.source, gate.shape, gate.precision), x)
        return None if slope is None else _swish(assembly, x, slope)
    if node.source != x.node:
        return None
    if node.function.name == "Sigmoid":
        return assembly.activation(x, "Silu")
    if node.function.name == "Logistic":
        return _swish(assembly, x, 1.0)
    if node.function.name == "HardSigmoid":
        return assembly.activation(x, ActivationFunction("HardSigmoidGate", node.function.parameters))
    return None


def _raised_gate(assembly: Assembly, scaled: Computed, gate: Computed) -> Computed | None:
    """Recognise ``a x * (1 + erf(b x))`` and ``a x * (1 + tanh(b (x + c x^3)))``, the two forms of Gelu."""
    raised = assembly.scaling_of(gate)
    if raised is None or raised.factor != raised.offset or raised.roundings:
        return None
    scale = assembly.scaling_of(scaled)
    candidates = [(scaled, 1.0)]
    if scale is not None and scale.offset == 0 and not scale.roundings:
        candidates.append((scale.source, scale.factor))
    for x, factor in candidates:
        for recognise in (_erf_argument, _tanh_argument):
            function = recognise(assembly, x, raised.source)
            if function is not None:
                merged = int(not is_product(factor * raised.factor, factor, raised.factor))
                bent = assembly.activation(x, function)
                return assembly.scaled(bent, factor * raised.factor, roundings=merged)
    return None


def _erf_argument(assembly: Assembly, x: Computed, bent: Computed) -> ActivationFunction | None:
    argument = assembly.function_of(bent, "Erf")
    if argument is None:
        return None
    if argument.node == x.node:
        return activation("ErfGate")
    scaling = assembly.scaling_of(argument)
    if scaling is None or scaling.offset != 0 or scaling.source.node != x.node:
        return None
    if not scaling.roundings:
        return activation("ErfGate", slope=scaling.factor)
    divisor = _stored(1.0 / scaling.factor)  # the weight stands for a division
    return activation("ErfGate", divisor=divisor) if 1.0 / divisor == scaling.factor else None


def _tanh_argument(assembly: Assembly, x: Computed, bent: Computed) -> ActivationFunction | None:
    argument = assembly.function_of(bent, "Tanh")
    scaling = None if argument is None else assembly.scaling_of(argument)
    if scaling is None or scaling.offset != 0 or scaling.roundings or not scaling.factor > 0:
        return None
    inner = assembly.nodes[scaling.source.node]
    if not isinstance(inner, Affine) or len(inner.sources) != 2 or x.node not in inner.sources:
        return None
    if inner.bias.any() or inner.roundings:
        return None
    own = inner.sources.index(x.node)
    other, factors = inner.sources[1 - own], scale_of(inner.weights[1 - own])
    if not is_scaling(inner.weights[own]) or factors is None or (factors != factors[0]).any():
        return None
    cubic = float(factors[0])
    cubed = Computed(other, x.shape, x.precision)
    scale = assembly.scaling_of(cubed)
    if scale is not None and scale.offset == 0 and not scale.roundings:
        if not is_product(cubic * scale.factor, cubic, scale.factor):
            return None
        cubed, cubic = scale.source, cubic * scale.factor
    if cubic <= 0 or not _is_cube(assembly, cubed, x):
        return None
    return activation("TanhGate", slope=scaling.factor, cubic=cubic)


def _is_cube(assembly: Assembly, value: Computed, x: Computed) -> bool:
    node = assembly.nodes[value.node]
    if isinstance(node, Activation):
        return node.source == x.node and node.function == activation("Pow", exponent=3.0)
    if not isinstance(node, Product) or x.node not in (node.left, node.right):
        return False
    other = assembly.nodes[node.right if node.left == x.node else node.left]
    square = activation("Pow", exponent=2.0)
    return isinstance(other, Activation) and other.source == x.node and other.function == square


def reciprocal(assembly: Assembly, divisor: Computed) -> Computed:
    """Return ``1 / divisor``, as a logistic where the divisor is ``1 + exp(m)``.

    An exponential that overflows there makes the quotient 0, which is no more than a flush to zero of the exact one.
    """
    argument = _exponent(assembly, divisor)
    if argument is None:
        return assembly.activation(divisor, "Reciprocal")
    return assembly.activation(_negated(assembly, argument), "Logistic")


def quotient(assembly: Assembly, numerator: Computed, divisor: Computed) -> Computed:
    """Return ``numerator / divisor`` as one activation of a known form, else as a product with the reciprocal."""
    same = numerator.shape == divisor.shape
    ratio = softsign(assembly, numerator, divisor) if same else None
    if ratio is not None:
        return ratio
    factor = reciprocal(assembly, divisor)
    return (gated(assembly, numerator, factor) if same and _is_logistic(assembly, factor) else None) or (
        normalised(assembly, numerator, factor)
    )


def _is_logistic(assembly: Assembly, x: Computed) -> bool:
    return assembly.function_of(x, "Logistic") is not None


def _exponent(assembly: Assembly, divisor: Computed) -> Computed | None:
    """Return m where a divisor is ``1 + exp(m)``, else None."""
    raised = assembly.scaling_of(divisor)
    if raised is None or (raised.factor, raised.offset, raised.roundings) != (1.0, 1.0, 0):
        return None
    return assembly.function_of(raised.source, "Exp")


def _negated(assembly: Assembly, x: Computed) -> Computed:
    scaling = assembly.scaling_of(x)
    if scaling is not None and (scaling.factor, scaling.offset, scaling.roundings) == (-1.0, 0.0, 0):
        return scaling.source
    return assembly.scaled(x, -1.0)


def _multiple(assembly: Assembly, value: Computed, x: Computed) -> float | None:
    """Return by which number x was multiplied to make a value, None where it was not."""
    factor = 1.0
    while value.node != x.node:
        scaling = assembly.scaling_of(value)
        if scaling is None or scaling.offset != 0 or scaling.roundings or abs(factor) != 1.0:
            return None
        factor, value = factor * scaling.factor, scaling.source
    return factor


def _swish(assembly: Assembly, x: Computed, slope: float) -> Computed | None:
    return assembly.activation(x, activation("Swish", slope=slope)) if slope > 0 else None


def softsign(assembly: Assembly, x: Computed, divisor: Computed) -> Computed | None:
    """Return ``x / (1 + |x|)`` as one activation, None where the divisor is another."""
    raised = assembly.scaling_of(divisor)
    if raised is None or (raised.factor, raised.offset, raised.roundings) != (1.0, 1.0, 0):
        return None
    argument = assembly.function_of(raised.source, "Abs")
    return assembly.activation(x, "Softsign") if argument is not None and argument.node == x.node else None


def is_product(value: float, left: float, right: float) -> bool:
    """Whether a number is exactly the product of two others."""
    numbers = (value, left, right)
    return all(map(math.isfinite, numbers)) and Fraction(value) == Fraction(left) * Fraction(right)


def _stored(value: float) -> float:
    """Return the float32 number that a value stands for."""
    return float(np.float32(value))
