"""How far another runtime's value of a folded constant may be from the one that was computed here.

Sums, products, quotients, roots and whatever moves elements are the same in every runtime, because IEEE 754 says
how they round. An exponential, a power or a long sum is not: two runtimes may differ in the last places. Such
a constant carries how many roundings it may be off, relative to each of its elements, and whoever uses it counts
them; who cannot count them refuses.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from viatool.policy.assembly import Refusal
from viatool.policy.tensors import PRECISIONS, Array, Constant

Evaluate = Callable[[Sequence[Array | None]], Sequence[Array]]

_FUNCTION_UNITS = 64.0
"""Error of a runtime's function in unit roundoffs of max(1, |x|, |f(x)|), above all that was seen."""

_MOST = 2.0**21
"""More roundings than this say nothing any more."""

# fmt: off
_MOVING = frozenset((
    "Abs", "Compress", "Concat", "DepthToSpace", "Expand", "Flatten", "Gather", "GatherElements", "GatherND",
    "Identity", "Max", "Min", "Neg", "Pad", "ReduceMax", "ReduceMin", "Relu", "Reshape", "ReverseSequence", "Slice",
    "SpaceToDepth", "Split", "Squeeze", "Tile", "Transpose", "Trilu", "Unsqueeze", "Where",
))
_ROUNDED_ONCE = frozenset(("Add", "DequantizeLinear", "Div", "LeakyRelu", "Mul", "PRelu", "Sqrt", "Sub"))
_ALWAYS_THE_SAME = frozenset((
    "ArgMax", "ArgMin", "CastLike", "Ceil", "Clip", "Dropout", "EyeLike", "Floor", "Hardmax", "Mod", "OneHot", "Range",
    "Round", "Sign", "ThresholdedRelu", "TopK",
))
_RELATIVE_FUNCTIONS = frozenset(("Exp", "Pow", "Reciprocal", "Softmax"))
"""Their error is relative to their value, however small it is."""

_FUNCTIONS = frozenset((
    "Acos", "Acosh", "Asin", "Asinh", "Atan", "Atanh", "Celu", "Cos", "Cosh", "Elu", "Erf", "Gelu", "HardSigmoid",
    "HardSwish", "Log", "LogSoftmax", "Mish", "Selu", "Sigmoid", "Sin", "Sinh", "Softplus", "Softsign", "Swish", "Tan",
    "Tanh",
))
_SUMMING = frozenset((
    "CumProd", "CumSum", "Gemm", "MatMul", "Mean", "ReduceL1", "ReduceL2", "ReduceMean", "ReduceProd", "ReduceSum",
    "ReduceSumSquare", "Sum",
))
# fmt: on


def folded_roundings(
    operator: str, inputs: Sequence[Constant | None], results: Sequence[Array], evaluate: Evaluate
) -> int:
    """Return how many roundings the results of a folded node may be off in another runtime.

    Parameters
    ----------
    operator : str
        Of the default domain.
    inputs, results : sequence
        The constants that it reads, and what it made of them.
    evaluate : callable
        Evaluates the node on other numbers.

    Raises
    ------
    Refusal
        If there is no bound.
    """
    if not any(result.dtype.kind == "f" for result in results) or not any(map(_is_float, inputs)):
        if any(constant.roundings for constant in inputs if constant is not None):
            raise _no_bound()
        return 0
    inherited = [0 if constant is None else constant.roundings for constant in inputs]
    if operator in _MOVING:
        return max(inherited)
    if not any(inherited) and operator in _ROUNDED_ONCE | _ALWAYS_THE_SAME:
        return 0
    arrays = [None if constant is None else constant.array for constant in inputs]
    if operator in ("Add", "Sub"):
        given = [(r, a) for r, a in zip(inherited, arrays, strict=True) if a is not None]
        terms = sum((r * np.abs(array.astype(np.float64)) for r, array in given), start=np.zeros(()))
        return 1 + _relative(terms, results[0])
    if operator in _ROUNDED_ONCE:
        return 1 + sum(inherited)
    if any(inherited):
        raise _no_bound()
    return _own_roundings(operator, arrays, results[0], evaluate)


def _own_roundings(operator: str, arrays: Sequence[Array | None], result: Array, evaluate: Evaluate) -> int:
    """Return the roundings of an operator that runtimes compute differently, on exact constants."""
    given = [array for array in arrays if array is not None]
    value = np.abs(result.astype(np.float64))
    with np.errstate(all="ignore"):
        if operator in _RELATIVE_FUNCTIONS:
            units = _FUNCTION_UNITS * max(1.0, float(np.abs(np.log(value[value > 0])).max(initial=0.0)))
            return math.ceil(units) + (result.size if operator == "Softmax" else 0)  # it also sums
        if operator in _FUNCTIONS:
            argument = np.abs(given[0].astype(np.float64))
            own = _FUNCTION_UNITS * np.maximum(1.0, np.maximum(argument.max(initial=0.0), value))
            if argument.shape == value.shape:
                own = np.where((argument == 0) & (value == 0), 0.0, own)
            return _relative(own, value)
        if operator in _SUMMING:
            (whole,) = evaluate(
                [None if a is None else np.abs(a) if a.dtype.kind == "f" else a for a in arrays]
            )
            longest = max(
                max(array.shape, default=1) if operator in ("MatMul", "Gemm") else array.size
                for array in given
            )
            return _relative((longest + len(given)) * np.abs(whole.astype(np.float64)), value)
    raise _no_bound()


def _is_float(constant: Constant | None) -> bool:
    return constant is not None and constant.dtype in PRECISIONS


def _relative(error: Array, value: Array) -> int:
    """Return an error in roundings of each element.

    Elements without an error may be zero; those that are not finite are refused by name where they are used.
    """
    error, size = np.broadcast_arrays(error, np.abs(np.asarray(value, dtype=np.float64)))
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where((error == 0) | ~np.isfinite(size), 0.0, error / size)
    most = float(share.max(initial=0.0))
    if not most <= _MOST:
        raise _no_bound()
    return math.ceil(most)


def _no_bound() -> Refusal:
    return Refusal(
        "makes a constant that runtimes compute differently, in a way that has no bound",
        "let the exporter fold constants, or simplify the model (onnxsim) before it is verified",
    )


def cast_roundings(constant: Constant, dtype: str) -> int:
    """Return the roundings of a constant after a cast.

    Raises
    ------
    Refusal
        If the constant is inexact, and not cast to a type with roundings that are as large.
    """
    if not constant.roundings:
        return 0
    order: Mapping[str, Any] = {"bfloat16": 0, "float16": 1, "float32": 2, "float64": 3}
    if order.get(dtype, 9) > order[constant.dtype]:
        raise _no_bound()
    return constant.roundings + 1
