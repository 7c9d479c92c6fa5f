"""How far a program's value of a folded constant may be from the exact one.

A folded constant is kept as the real number that the graph means, computed in float64. What a program has instead
depends on where it rounds: one that folds in float16 rounds after each operation, one without float16 arithmetic keeps
float32 numbers in between, and an exponential or a long sum differs in its last places anyway. So a constant carries
how many roundings it may be off, relative to the magnitudes that were added up before they cancelled, and whoever uses
it counts them; who cannot count them refuses.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from viatool.arrays import Floats
from viatool.policy.assembly import LARGEST_SHARE, Counted, Refusal
from viatool.policy.tensors import PRECISIONS, Array, Constant, convert
from viatool.rounding import SMALLEST_NORMAL, UNIT_ROUNDOFF

Evaluate = Callable[[Sequence[Array | None]], Sequence[Array]]

_FUNCTION_UNITS = 64
"""Error of a runtime's function in unit roundoffs of max(1, |x|, |f(x)|), above all that was seen."""

_COMPARED_EXACTLY = 4096
"""Elements of a result that is compared with the exact one; a larger result counts as rounded."""

# fmt: off
_MOVING = frozenset((
    "Abs", "Clip", "Compress", "Concat", "DepthToSpace", "Dropout", "Expand", "Flatten", "Gather", "GatherElements",
    "GatherND", "Identity", "Max", "Min", "Neg", "Pad", "ReduceMax", "ReduceMin", "Relu", "Reshape", "ReverseSequence",
    "Slice", "SpaceToDepth", "Split", "Squeeze", "Tile", "Transpose", "Trilu", "Unsqueeze", "Where",
))
_CHOOSING = frozenset(("Clip", "Max", "Min", "ReduceMax", "ReduceMin"))
"""Which element they take depends on its value, so that the error may be that of any."""

_ALWAYS_THE_SAME = frozenset((
    "ArgMax", "ArgMin", "CastLike", "Ceil", "EyeLike", "Floor", "Hardmax", "Mod", "OneHot", "Round", "Sign",
    "ThresholdedRelu", "TopK",
))
_STEPS = frozenset(("Ceil", "Floor", "Round", "Sign"))
"""Monotone and piecewise constant: what they make of both ends of an interval, if equal, they make of all of it."""

_EXACT: dict[str, Callable[..., Fraction]] = {
    "Add": lambda a, b: a + b,
    "Div": lambda a, b: a / b,
    "Mul": lambda a, b: a * b,
    "Sub": lambda a, b: a - b,
}
_SLOPES = {
    "Asinh": 1, "Atan": 1, "Cos": 1, "Erf": 2, "Gelu": 2, "HardSwish": 2, "Mish": 2, "Sigmoid": 1, "Sin": 1,
    "Softplus": 1, "Softsign": 1, "Tanh": 1,
}
"""Bounds of their slopes; the other functions take exact constants only."""

_FUNCTIONS = frozenset((
    *_SLOPES, "Acos", "Acosh", "Asin", "Atanh", "Celu", "Cosh", "Elu", "HardSigmoid", "Log", "LogSoftmax", "Selu",
    "Sinh", "Swish", "Tan",
))
_RELATIVE_FUNCTIONS = frozenset(("Exp", "Pow", "Reciprocal", "Softmax"))
"""Their error is relative to their value, however small it is."""

_SUMMING = frozenset((
    "CumProd", "CumSum", "Gemm", "MatMul", "Mean", "ReduceL1", "ReduceL2", "ReduceMean", "ReduceProd", "ReduceSum",
    "ReduceSumSquare", "Sum",
))
_MULTIPLYING = frozenset(("CumProd", "ReduceProd", "ReduceSumSquare"))
# fmt: on


@dataclass(frozen=True, eq=False)
class _Folding:
    """An operator on constants: what it reads, what it makes in the element types of the model, and how to run it."""

    operator: str
    inputs: Sequence[Constant | None]
    results: Sequence[Constant]
    evaluate: Evaluate

    @property
    def given(self) -> list[Counted]:
        """Return the floating-point inputs."""
        return [
            numbers_of(constant) for constant in self.inputs if constant is not None and _is_float(constant)
        ]

    @property
    def inherited(self) -> int:
        """Return the most roundings of an input."""
        return max((numbers.roundings for numbers in self.given), default=0)

    def run(self, part: Callable[[Counted], Floats]) -> list[Array]:
        """Evaluate the operator in float64 on a part of its floating-point inputs."""
        return list(
            self.evaluate(
                [
                    None
                    if constant is None
                    else part(numbers_of(constant))
                    if _is_float(constant)
                    else constant.array
                    for constant in self.inputs
                ]
            )
        )

    def exact(self) -> list[Array]:
        """Return the results in float64."""
        return self.run(lambda numbers: numbers.values)


def numbers_of(constant: Constant) -> Counted:
    """Return a constant with its magnitudes."""
    values = np.asarray(constant.array, dtype=np.float64)
    magnitudes = np.abs(values) if constant.magnitude is None else constant.magnitude
    return Counted(values, magnitudes, constant.roundings, UNIT_ROUNDOFF.get(constant.dtype, 0.0))


def with_roundings(
    operator: str, inputs: Sequence[Constant | None], results: Sequence[Constant], evaluate: Evaluate
) -> list[Constant]:
    """Return the results of a folded node as real numbers, with how far those of a program may be from them.

    Parameters
    ----------
    operator : str
        Of the default domain.
    inputs, results : sequence
        The constants that it reads, and what it makes of them in their element types.
    evaluate : callable
        Evaluates the node on other numbers.

    Raises
    ------
    Refusal
        If there is no bound.
    """
    folding = _Folding(operator, inputs, results, evaluate)
    if not any(map(_is_float, results)) or not folding.given:
        return _unless_inexact(folding)
    if operator in _MOVING:
        return _moved(folding)
    if operator in _ALWAYS_THE_SAME:
        return _stepped(folding) if operator in _STEPS and folding.inherited else _unless_inexact(folding)
    (result,) = results
    (value,) = folding.exact()
    own = _own(folding, value)
    if own.roundings == 0 or not own.magnitudes.any():
        return [result]
    return [_inexact(result, own)]


def _inexact(result: Constant, own: Counted) -> Constant:
    """Return a result as the real number that it stands for; one that overflows in its element type stays as it is."""
    unit, tiny = UNIT_ROUNDOFF[result.dtype], SMALLEST_NORMAL[result.dtype]
    lost = (
        np.abs(own.values) < 2 * tiny
    )  # below the normal numbers an error is as large as the smallest of them
    magnitude = np.where(lost, np.maximum(own.magnitudes, tiny / unit), own.magnitudes)
    finite = np.isfinite(result.array)
    if own.roundings * unit > LARGEST_SHARE:
        raise no_bound()
    return Constant(
        np.where(finite, own.values, result.array),
        result.dtype,
        own.roundings,
        np.where(finite, magnitude, np.inf),
    )


def _unless_inexact(folding: _Folding) -> list[Constant]:
    if folding.inherited:
        raise no_bound()
    return list(folding.results)


def _moved(folding: _Folding) -> list[Constant]:
    """Move magnitudes as the numbers themselves."""
    if not folding.inherited:
        return list(folding.results)
    magnitudes = folding.run(lambda numbers: numbers.magnitudes)
    if folding.operator in _CHOOSING:
        most = max(float(numbers.magnitudes.max(initial=0.0)) for numbers in folding.given)
        magnitudes = [np.full(magnitude.shape, most) for magnitude in magnitudes]
    return [
        Constant(value, result.dtype, folding.inherited, np.abs(magnitude)) if _is_float(result) else result
        for result, value, magnitude in zip(folding.results, folding.exact(), magnitudes, strict=True)
    ]


def _stepped(folding: _Folding) -> list[Constant]:
    """Take a step function where both ends of what a program may have lead to the same."""
    (constant,) = (value for value in folding.inputs if value is not None and _is_float(value))
    (result,) = folding.results
    lowest, highest = (folding.evaluate([end])[0] for end in ends_of(constant))
    if not np.array_equal(lowest, highest):
        raise no_bound()
    return [Constant(convert(lowest, result.dtype), result.dtype)]


def ends_of(constant: Constant) -> tuple[Floats, Floats]:
    """Return what a program may have at least and at most, with the double of the roundings."""
    numbers = numbers_of(constant)
    reach = 2 * numbers.roundings * UNIT_ROUNDOFF[constant.dtype] * numbers.magnitudes
    return numbers.values - reach, numbers.values + reach


def _own(folding: _Folding, value: Array) -> Counted:
    """Return the exact result of an operator that rounds, with the roundings of a program."""
    operator, given = folding.operator, folding.given
    with np.errstate(all="ignore"):
        if operator in ("Add", "Sub", "Mul"):
            first, second = given
            inexact = int(not _is_exact(folding, value))
            if operator == "Mul":
                roundings = first.roundings + second.roundings + inexact
                return Counted(value, first.magnitudes * second.magnitudes, roundings)
            return Counted(value, first.magnitudes + second.magnitudes, folding.inherited + inexact)
        if operator == "Div":
            first, second = given
            roundings = first.roundings + second.relative_roundings() + int(not _is_exact(folding, value))
            return Counted(value, first.magnitudes / np.abs(second.values), roundings)
        if operator == "Sqrt":
            roundings = given[0].relative_roundings() + int(not _is_exact(folding, value))
            return Counted(value, np.abs(value), roundings)
        if operator in ("LeakyRelu", "PRelu"):
            slopes = folding.evaluate([-np.ones_like(value), *(numbers.magnitudes for numbers in given[1:])])[
                0
            ]
            steep = max(1.0, float(np.abs(slopes).max(initial=0.0)))
            roundings = 1 + sum(numbers.roundings for numbers in given)
            return Counted(value, np.maximum(steep * given[0].magnitudes, np.abs(value)), roundings)
        if operator == "DequantizeLinear":
            return Counted(value, np.abs(value), 1 + max(numbers.relative_roundings() for numbers in given))
        if operator == "Range":
            return _counted_up(folding, value)
        if operator in _RELATIVE_FUNCTIONS:
            return Counted(value, np.abs(value), _relative_units(folding, value))
        if operator in _FUNCTIONS:
            return _of_function(folding, value)
        if operator in _SUMMING:
            (whole,) = folding.run(lambda numbers: numbers.magnitudes)
            terms = _longest(folding) + len(given)
            share = 2 * terms if operator in _MULTIPLYING else 2
            return Counted(value, np.abs(whole), terms + share * folding.inherited)
    raise no_bound()


def _is_exact(folding: _Folding, value: Array) -> bool:
    """Whether the result in float64 and that in the element type are both the exact one."""
    (result,) = folding.results
    values = [numbers.values for numbers in folding.given]
    if folding.inherited or value.size > _COMPARED_EXACTLY:
        return False
    if not np.array_equal(np.asarray(result.array, dtype=np.float64), value):
        return False
    if not np.isfinite(value).all() or not all(np.isfinite(array).all() for array in values):
        return True  # is refused by name where it is used
    operands = [map(Fraction, np.broadcast_to(array, value.shape).ravel().tolist()) for array in values]
    results = map(Fraction, value.ravel().tolist())
    if folding.operator == "Sqrt":
        return all(root * root == square for root, square in zip(results, operands[0], strict=True))
    exact = _EXACT[folding.operator]
    return all(exact(*pair) == found for *pair, found in zip(*operands, results, strict=True))


def _counted_up(folding: _Folding, value: Array) -> Counted:
    """Return a range: a program may add up its steps one by one."""
    (result,) = folding.results
    start, _, step = (float(numbers.values) for numbers in folding.given)
    exact = np.array_equal(np.asarray(result.array, dtype=np.float64), value) and all(
        Fraction(start) + index * Fraction(step) == Fraction(found)
        for index, found in enumerate(value.tolist())
    )
    if folding.inherited:
        raise no_bound()
    return Counted(value, abs(start) + value.size * abs(step) + 0 * value, 0 if exact else value.size + 2)


def _relative_units(folding: _Folding, value: Array) -> int:
    """Return the roundings of a function whose error is relative to its value."""
    magnitude = np.abs(value)
    units = _FUNCTION_UNITS * max(1.0, float(np.abs(np.log(magnitude[magnitude > 0])).max(initial=0.0)))
    argument = folding.given[0]
    most = argument.roundings * float(argument.magnitudes.max(initial=0.0))
    if folding.operator == "Softmax":
        return math.ceil(units + 2 * most) + value.size  # it also sums
    if folding.operator == "Exp":
        return math.ceil(units + most)
    if folding.operator == "Reciprocal":
        return math.ceil(units) + argument.relative_roundings()
    exponent = folding.given[1] if len(folding.given) > 1 else None
    if exponent is None or exponent.roundings:
        if folding.inherited:
            raise no_bound()
        return math.ceil(units)
    power = max(1.0, float(exponent.magnitudes.max(initial=0.0)))
    return math.ceil(units + power * argument.relative_roundings())


def _of_function(folding: _Folding, value: Array) -> Counted:
    """Return a function's values, each with the error of its own place."""
    argument = folding.given[0]
    slope = _SLOPES.get(folding.operator)
    if folding.inherited and (slope is None or len(folding.given) > 1):
        raise no_bound()
    magnitude = np.maximum(1.0, np.maximum(argument.magnitudes.max(initial=0.0), np.abs(value)))
    if argument.values.shape == value.shape:
        magnitude = np.where((argument.magnitudes == 0) & (value == 0), 0.0, magnitude)
    return Counted(value, magnitude, _FUNCTION_UNITS + (slope or 0) * folding.inherited)


def _longest(folding: _Folding) -> int:
    """Return a bound on the number of terms of each sum."""
    if folding.operator in ("MatMul", "Gemm"):
        return max(max(numbers.values.shape, default=1) for numbers in folding.given)
    return max(numbers.values.size for numbers in folding.given)


def _is_float(constant: Constant | None) -> bool:
    return constant is not None and constant.dtype in PRECISIONS


def no_bound() -> Refusal:
    """Return the refusal of a constant that may be anything."""
    return Refusal(
        "makes a constant that runtimes compute differently, in a way that has no bound",
        "let the exporter fold constants, or simplify the model (onnxsim) before it is verified",
    )


def cast_constant(constant: Constant, dtype: str) -> Constant:
    """Return a constant in another element type.

    Between floating-point types it stays the same real number, since a program may leave the cast out; a narrower
    type rounds it once more.

    Raises
    ------
    Refusal
        If the constant is inexact, and programs may make different integers of it.
    """
    converted = Constant(convert(constant.array, dtype), dtype)
    if not _is_float(constant):
        return converted
    if dtype not in PRECISIONS:
        if not constant.roundings:
            return converted
        lowest, highest = (convert(end, dtype) for end in ends_of(constant))
        if not np.array_equal(lowest, highest):
            raise no_bound()
        return Constant(lowest, dtype)
    numbers = numbers_of(constant)
    same = np.array_equal(converted.array.astype(np.float64), numbers.values)
    if same and not constant.roundings:
        return converted
    roundings = constant.roundings * UNIT_ROUNDOFF[constant.dtype] / UNIT_ROUNDOFF[dtype] + int(not same)
    return _inexact(converted, Counted(numbers.values, numbers.magnitudes, math.ceil(roundings)))
