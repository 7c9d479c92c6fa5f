"""Arithmetic: sums and products by constants become affine nodes, other products stay products."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from viatool.arrays import Floats
from viatool.policy.activations import activation
from viatool.policy.assembly import Computed, Counted, Refusal, Term, broadcast_index
from viatool.policy.network import Precision
from viatool.policy.operators.elementwise import clipped
from viatool.policy.operators.exponentials import log_softmax, of_exponentials
from viatool.policy.operators.gates import gated, quotient, reciprocal
from viatool.policy.operators.registry import Call, Comparison, Result, Value, counted, finite, reads
from viatool.policy.operators.variance import difference_of_means, normalised
from viatool.policy.tensors import Constant, as_precision, dtype_name
from viatool.policy.weights import Weights, placed

Shape = tuple[int, ...]

_LARGEST_EXPONENT = 16


def operands(call: Call) -> tuple[Value, Value]:
    """Return both operands; before opset 7 they broadcast on demand, and only to the last axes here."""
    left, right = call.value(0), call.value(1)
    if call.version >= 7 or left.shape == right.shape:
        return left, right
    if not call.flag("broadcast"):
        raise Refusal(f"combines the shapes {list(left.shape)} and {list(right.shape)} without broadcasting")
    trailing = len(left.shape) - len(right.shape)
    if call.attributes.get("axis", trailing) not in (trailing, -len(right.shape)):
        raise Refusal(
            "broadcasts along an axis, as only opset 6 does", "export with opset_version 7 or newer"
        )
    return left, right


def precision_of(values: Sequence[Value | None]) -> Precision:
    """Return the element type of an operator's floating-point operands."""
    for value in values:
        if isinstance(value, Computed):
            return value.precision
    raise Refusal("has only constant operands")


def weighted_sum(
    call: Call, values: Sequence[Value], factors: Sequence[float], roundings: int = 0
) -> Computed:
    """Add ``sum_k factor_k * value_k`` with broadcasting, as one affine node."""
    shape: Shape = np.broadcast_shapes(*(value.shape for value in values))
    size = math.prod(shape)
    call.assembly.reserve(size, min(value.size for value in values if isinstance(value, Computed)))
    bias, magnitude = np.zeros(size), np.zeros(size)
    terms: list[Term] = []
    for value, factor in zip(values, factors, strict=True):
        if isinstance(value, Constant):
            constant = counted(value, "constant")
            bias = bias + factor * np.broadcast_to(constant.values, shape).ravel()
            magnitude = magnitude + abs(factor) * np.broadcast_to(constant.magnitudes, shape).ravel()
            roundings += constant.roundings
        else:
            terms.append(Term(value, scattered(call, value, shape, np.full(size, factor))))
    roundings += max(0, len(values) - len(terms) - 1)  # constants that are merged are rounded term by term
    precision = precision_of(values)
    return call.assembly.affine(terms, bias, shape, precision, roundings, bias_magnitude=magnitude)


def scattered(call: Call, x: Computed, shape: Shape, factors: Floats) -> Weights:
    """Return the matrix ``(size, x.size)`` that broadcasts x and multiplies each element by its factor."""
    index = broadcast_index(x, shape)
    return placed(np.arange(index.size), index, factors, (index.size, x.size))


@reads("Add", 6, 7, 13, 14, treatment="exact")
def read_add(call: Call) -> Sequence[Value]:
    """Read a sum of two values."""
    return [weighted_sum(call, operands(call), (1.0, 1.0))]


@reads("Sub", 6, 7, 13, 14, treatment="exact")
def read_sub(call: Call) -> Sequence[Value]:
    """Read a difference of two values; that of a mean of squares and a squared mean is a variance."""
    left, right = operands(call)
    if isinstance(left, Computed) and isinstance(right, Computed):
        known = difference_of_means(call.assembly, left, right) or log_softmax(call.assembly, left, right)
        if known is not None:
            return [known]
    return [weighted_sum(call, (left, right), (1.0, -1.0))]


@reads("Sum", 6, 8, 13, treatment="exact")
def read_sum(call: Call) -> Sequence[Value]:
    """Read a sum of any number of values."""
    values = [call.value(index) for index in range(len(call.inputs))]
    return [weighted_sum(call, values, [1.0] * len(values))]


@reads("Mean", 6, 8, 13, treatment="exact")
def read_mean(call: Call) -> Sequence[Value]:
    """Read the mean of any number of values, element by element."""
    values = [call.value(index) for index in range(len(call.inputs))]
    roundings = 2 * int(len(values) > 1)  # the division, and the share that stands for it
    return [weighted_sum(call, values, [1.0 / len(values)] * len(values), roundings)]


@reads("Neg", 6, 13, treatment="exact")
def read_neg(call: Call) -> Sequence[Value]:
    """Read a change of sign."""
    return [call.assembly.scaled(call.computed(0), -1.0)]


@reads("Mul", 6, 7, 13, 14, treatment="exact", note="enclosed between two computed values")
def read_mul(call: Call) -> Sequence[Value]:
    """Read a product by a constant or of two computed values."""
    left, right = operands(call)
    if isinstance(left, Computed) and isinstance(right, Computed):
        return [gated(call.assembly, left, right) or normalised(call.assembly, left, right)]
    x, constant = (left, right) if isinstance(left, Computed) else (right, left)
    assert isinstance(x, Computed)
    assert isinstance(constant, Constant)
    return [scaled_by(call, x, counted(constant, "factor"))]


def scaled_by(call: Call, x: Computed, factors: Counted) -> Computed:
    """Add the elementwise product of x and an array, with broadcasting."""
    shape = np.broadcast_shapes(x.shape, factors.values.shape)
    call.assembly.reserve(math.prod(shape), x.size)
    call.assembly.expect_folding(x, 1 + factors.roundings)

    def spread(numbers: Floats) -> Weights:
        return scattered(call, x, shape, np.broadcast_to(numbers, shape).ravel())

    term = Term(x, spread(factors.values), spread(factors.magnitudes) if factors.roundings else None)
    return call.assembly.affine([term], np.zeros(math.prod(shape)), shape, x.precision, factors.roundings)


@reads(
    "Div",
    6,
    7,
    13,
    14,
    treatment="exact",
    note="enclosed where the divisor is computed; it must keep its sign",
)
def read_div(call: Call) -> Sequence[Value]:
    """Read a quotient: by a constant it scales, by a computed value it is a product with its reciprocal."""
    numerator, divisor = operands(call)
    if isinstance(divisor, Constant):
        assert isinstance(numerator, Computed)
        return [divided_by(call, numerator, counted(divisor, "divisor"))]
    if isinstance(numerator, Constant):
        return [scaled_by(call, reciprocal(call.assembly, divisor), counted(numerator, "numerator"))]
    bounded = of_exponentials(call.assembly, numerator, divisor)
    return [bounded or quotient(call.assembly, numerator, divisor)]


def divided_by(call: Call, x: Computed, divisors: Counted) -> Computed:
    """Add the elementwise quotient of x by an array; a division by a power of two is exact."""
    if not divisors.values.all():
        raise Refusal("divides by zero", "export the policy again with a normaliser that has no zero spread")
    mantissas, _ = np.frexp(divisors.values)
    inexact = bool((np.abs(mantissas) != 0.5).any())
    factors = 1.0 / divisors.values
    roundings = divisors.relative_roundings() + int(inexact)
    return scaled_by(call, x, Counted(factors, np.abs(factors), roundings))


@reads("Pow", 1, 7, 12, 13, 15, treatment="enclosed", note="constant exponent: an integer, 0.5 or -0.5")
def read_pow(call: Call) -> Sequence[Value]:
    """Read a power with one constant exponent."""
    if isinstance(call.value(0), Constant):
        raise Refusal("has a computed exponent")
    base, exponents = operands(call)
    assert isinstance(base, Computed)
    if not isinstance(exponents, Constant):
        raise Refusal("has a computed exponent")
    values = finite(exponents, "exponent")
    if values.size == 0 or (values != values.flat[0]).any():
        raise Refusal("has several different exponents")
    shape = np.broadcast_shapes(base.shape, values.shape)
    return [power(call, call.assembly.broadcast(base, shape), float(values.flat[0]))]


def power(call: Call, x: Computed, exponent: float) -> Computed:
    """Add ``x ** exponent``."""
    assembly = call.assembly
    if exponent == 0.0:
        return assembly.constant(1.0, x.shape, x.precision)
    if exponent < 0:
        return reciprocal(assembly, power(call, x, -exponent))
    if exponent == 1.0:
        return x
    if exponent == 0.5:
        return assembly.activation(x, "Sqrt")
    if exponent.is_integer() and exponent <= _LARGEST_EXPONENT:
        return assembly.activation(x, activation("Pow", exponent=exponent))
    raise Refusal(
        f"has exponent {exponent:g}; integers up to {_LARGEST_EXPONENT}, 0.5 and their negatives are read"
    )


@reads("Max", 6, 8, 12, 13, treatment="enclosed")
def read_max(call: Call) -> Sequence[Value]:
    """Read the largest of any number of values, element by element."""
    return [_extreme(call, call.assembly.maximum, lambda x, bound: clipped(call, x, bound, np.inf))]


@reads("Min", 6, 8, 12, 13, treatment="enclosed")
def read_min(call: Call) -> Sequence[Value]:
    """Read the smallest of any number of values, element by element."""
    return [_extreme(call, call.assembly.minimum, lambda x, bound: clipped(call, x, -np.inf, bound))]


def _extreme(
    call: Call,
    combine: Callable[[Computed, Computed], Computed],
    limit: Callable[[Computed, float], Computed],
) -> Computed:
    values = [call.value(index) for index in range(len(call.inputs))]
    shape: Shape = np.broadcast_shapes(*(value.shape for value in values))
    computed = [value for value in values if isinstance(value, Computed)]
    call.assembly.reserve(math.prod(shape), computed[0].size)
    result = computed[0]
    for other in computed[1:]:
        result = combine(result, other)
    for value in values:
        if isinstance(value, Constant):  # bounds come last, so that equal ones become a clip
            bounds = counted(value, "constant")
            if bounds.values.size and not bounds.roundings and (bounds.values == bounds.values.flat[0]).all():
                result = limit(result, float(bounds.values.flat[0]))
            else:
                result = combine(result, call.assembly.inexact(bounds, result.precision))
    return call.assembly.broadcast(result, shape)


@reads("Cast", 6, 9, 13, 19, 21, 23, 24, 25, 28, treatment="exact", note="between floating-point types")
def read_cast(call: Call) -> Sequence[Result]:
    """Read a change between floating-point types; a comparison that is cast to a boolean stays one."""
    call.flag("saturate")  # means nothing here, but onnxruntime makes zeros of other numbers
    dtype = dtype_name(call.integer("to"))
    if dtype == "bool" and isinstance(call.inputs[0], Comparison):
        return [call.inputs[0]]
    precision = as_precision(dtype) if dtype else None
    if precision is None:
        raise Refusal(
            f"casts a computed value to {dtype or 'a type that is not a number'}, which is a step function",
            "export the policy before its actions are made discrete",
        )
    return [call.assembly.cast(call.computed(0), precision)]
