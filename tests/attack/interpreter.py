"""What the graph in an ONNX file computes, exactly or in 240 bits: an interpreter of the file itself.

Nothing here imports `viatool`, so that a wrong reader, a wrong bound and a wrong answer have no common cause. Steps
between constants, such as rounding to integers, are taken by the reference implementation of ONNX in the element types
of the model; moving elements about is left to onnxruntime, which moves their numbers.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property
from typing import Any

import mpmath
import numpy as np
import onnx
from onnx import numpy_helper

Array = np.ndarray[Any, Any]

MP = mpmath.mp.clone()
"""High-precision arithmetic of 240 bits."""
MP.prec = 240

MOVING = frozenset(
    (
        "Compress", "Concat", "DepthToSpace", "Expand", "Flatten", "Gather", "GatherElements", "GatherND", "Pad",
        "Reshape", "ReverseSequence", "Slice", "SpaceToDepth", "Split", "Squeeze", "Tile", "Transpose", "Trilu",
        "Unsqueeze",
    )
)  # fmt: skip
"""Operators that copy elements."""

RATIONAL = MOVING | frozenset(
    (
        "Abs", "Add", "And", "AveragePool", "Cast", "Clip", "Conv", "CumProd", "CumSum", "DequantizeLinear", "Div",
        "Dropout", "Gemm", "GlobalAveragePool",
        "GlobalMaxPool", "Greater", "GreaterOrEqual", "HardSigmoid", "HardSwish", "Identity", "LeakyRelu", "Less",
        "LessOrEqual", "MatMul", "Max", "MaxPool", "Mean", "Min", "Mul", "Neg", "Not", "Or", "PRelu", "Reciprocal",
        "ReduceL1", "ReduceMax", "ReduceMean", "ReduceMin", "ReduceProd", "ReduceSum", "ReduceSumSquare", "Relu",
        "Shape", "Sign", "Size", "Softsign", "Sub", "Sum", "ThresholdedRelu", "Where",
    )
)  # fmt: skip
"""Operators that make rationals of rationals."""


STEPS = frozenset(
    (
        "ArgMax", "ArgMin", "BitShift", "BitwiseAnd", "BitwiseNot", "BitwiseOr", "BitwiseXor", "CastLike", "Ceil",
        "Constant", "ConstantOfShape", "Equal", "EyeLike", "Floor", "Hardmax", "IsInf", "IsNaN", "Mod", "NonZero",
        "OneHot", "QuantizeLinear", "Range", "Round", "TopK", "Xor",
    )
)  # fmt: skip
"""Operators on constants that are evaluated in the element types of the model."""


class Floating:
    """The functions of `MP` in float64, with infinities instead of exceptions."""

    pi = math.pi
    erf, erfc, log1p, tanh = map(staticmethod, (math.erf, math.erfc, math.log1p, math.tanh))

    @staticmethod
    def mpf(x: Any) -> float:
        return float(x)

    @staticmethod
    def exp(x: float) -> float:
        return math.exp(x) if x < 709.0 else math.inf

    @staticmethod
    def expm1(x: float) -> float:
        return math.expm1(x) if x < 709.0 else math.inf

    @staticmethod
    def log(x: float) -> float:
        return math.log(x) if x > 0 else -math.inf if x == 0 else math.nan

    @staticmethod
    def sqrt(x: float) -> float:
        return math.sqrt(x) if x >= 0 else math.nan


_SLOPE, _LEAK = float(np.float32(0.2)), float(np.float32(0.01))
_ALPHA, _GAMMA = float(np.float32(1.67326319217681884765625)), float(np.float32(1.05070102214813232421875))
"""Defaults of the standard, as float32 numbers."""

# --- functions of one number -----------------------------------------------------------------------------


def _softplus(m: Any, x: Any) -> Any:
    return max(x, 0) + m.log1p(m.exp(-abs(x)))


def _sigmoid(m: Any, x: Any) -> Any:
    faded = m.exp(-abs(x))
    return 1 / (1 + faded) if x >= 0 else faded / (1 + faded)


def _gelu(m: Any, x: Any, approximate: Any = "none") -> Any:
    if approximate in ("tanh", b"tanh"):
        return x * _sigmoid(m, 2 * m.sqrt(2 / m.pi) * (x + m.mpf(44715) / 1000000 * x * x * x))
    return x * m.erfc(-x / m.sqrt(m.mpf(2))) / 2


def _hard_sigmoid(m: Any, x: Any, alpha: Any, beta: Any) -> Any:
    return max(0 * x, min(1 + 0 * x, alpha * x + beta))


ELEMENTWISE: dict[str, Callable[..., Any]] = {
    "Abs": lambda m, x: abs(x),
    "Celu": lambda m, x, alpha=1.0: x if x >= 0 else alpha * m.expm1(x / alpha),
    "Elu": lambda m, x, alpha=1.0: x if x >= 0 else alpha * m.expm1(x),
    "Erf": lambda m, x: m.erf(x),
    "Exp": lambda m, x: m.exp(x),
    "Gelu": _gelu,
    "HardSigmoid": lambda m, x, alpha=_SLOPE, beta=0.5: _hard_sigmoid(m, x, alpha, beta),
    "HardSwish": lambda m, x: x * max(0 * x, min(1 + 0 * x, (x + 3) / 6)),
    "LeakyRelu": lambda m, x, alpha=_LEAK: x if x >= 0 else alpha * x,
    "Log": lambda m, x: m.log(x),
    "Mish": lambda m, x: x * m.tanh(_softplus(m, x)),
    "Relu": lambda m, x: max(x, 0 * x),
    "Selu": lambda m, x, alpha=_ALPHA, gamma=_GAMMA: gamma * (x if x >= 0 else alpha * m.expm1(x)),
    "Sigmoid": _sigmoid,
    "Sign": lambda m, x: 0 * x + ((x > 0) - (x < 0)),
    "Softplus": _softplus,
    "Softsign": lambda m, x: x / (1 + abs(x)),
    "Sqrt": lambda m, x: m.sqrt(x),
    "Swish": lambda m, x, alpha=1.0: x * _sigmoid(m, alpha * x),
    "Tanh": lambda m, x: m.tanh(x),
    "ThresholdedRelu": lambda m, x, alpha=1.0: x if x > alpha else 0 * x,
}
"""Each with its attributes and their defaults, as float32 numbers."""


@dataclass(frozen=True)
class Arithmetic:
    """In which numbers a graph is evaluated."""

    functions: Any
    convert: Callable[[float], Any] | None
    """From float64; None for float64 arrays."""

    def lift(self, array: Array) -> Array:
        """Turn an array of numbers into one of this arithmetic; booleans and integers stay."""
        if array.dtype.kind in "biu":
            return array
        numbers = np.asarray(array, dtype=np.float64)
        if self.convert is None:
            return numbers
        lifted = np.empty(numbers.shape, dtype=object)
        lifted.ravel()[:] = [self.convert(x) for x in numbers.ravel().tolist()]
        return lifted

    def map(self, function: Callable[..., Any], *arrays: Array) -> Array:
        """Apply a function of numbers to each element."""
        result = np.frompyfunc(function, len(arrays), 1)(*arrays)
        return np.asarray(result, dtype=np.float64 if self.convert is None else object)

    def parameter(self, value: Any) -> Any:
        """Turn a float attribute into a number."""
        if isinstance(value, float) and self.convert is not None:
            return self.convert(value)
        return value


def _exactly(x: float) -> Any:
    return Fraction(x) if math.isfinite(x) else x


FLOATING = Arithmetic(Floating, None)
PRECISE = Arithmetic(MP, MP.mpf)
EXACT = Arithmetic(None, _exactly)
"""Fractions; for graphs of `RATIONAL` operators only."""


# --- operators -------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Application:
    """One node with its inputs: lifted arrays, None where one is left out."""

    node: onnx.NodeProto
    opset: int
    inputs: Sequence[Array | None]
    arithmetic: Arithmetic

    @cached_property
    def attributes(self) -> dict[str, Any]:
        return attributes_of(self.node)

    def array(self, index: int) -> Array:
        value = self.inputs[index]
        assert value is not None
        return value

    def has(self, index: int) -> bool:
        return index < len(self.inputs) and self.inputs[index] is not None

    def number(self, name: str, default: float) -> Any:
        return self.arithmetic.parameter(float(self.attributes.get(name, default)))

    def sqrt(self, x: Array) -> Array:
        return self.arithmetic.map(self.arithmetic.functions.sqrt, x)

    def exp(self, x: Array) -> Array:
        return self.arithmetic.map(self.arithmetic.functions.exp, x)


def attributes_of(node: onnx.NodeProto) -> dict[str, Any]:
    """Return the attributes of a node by name."""
    return {attribute.name: onnx.helper.get_attribute_value(attribute) for attribute in node.attribute}


OPERATORS: dict[str, Callable[[Application], Sequence[Array]]] = {}


def _computes(*names: str) -> Callable[[Callable[[Application], Any]], Callable[[Application], Any]]:
    def register(function: Callable[[Application], Any]) -> Callable[[Application], Any]:
        def several(call: Application) -> Sequence[Array]:
            result = function(call)
            return result if isinstance(result, tuple) else (result,)

        OPERATORS.update(dict.fromkeys(names, several))
        return function

    return register


@_computes(*ELEMENTWISE)
def _elementwise(call: Application) -> Array:
    arithmetic = call.arithmetic
    given = {name: arithmetic.parameter(value) for name, value in call.attributes.items()}
    function = ELEMENTWISE[call.node.op_type]
    if arithmetic.convert is not None:  # defaults are numbers of this arithmetic as well
        defaults = function.__defaults__ or ()
        names = (
            function.__code__.co_varnames[: function.__code__.co_argcount][-len(defaults) :]
            if defaults
            else ()
        )
        given = {**{n: arithmetic.parameter(v) for n, v in zip(names, defaults, strict=True)}, **given}
    return arithmetic.map(lambda x: function(arithmetic.functions, x, **given), call.array(0))


@_computes("Identity", "Dropout", "Cast", "CastLike")
def _same(call: Application) -> Array:
    return call.array(0)


@_computes("Neg")
def _neg(call: Application) -> Array:
    return -call.array(0)


@_computes("Add", "Sub", "Mul", "Div", "Greater", "GreaterOrEqual", "Less", "LessOrEqual", "And", "Or")
def _binary(call: Application) -> Array:
    a, b = call.array(0), call.array(1)
    match call.node.op_type:
        case "Add":
            return a + b
        case "Sub":
            return a - b
        case "Mul":
            return a * b
        case "Div":
            return a / b
        case "Greater":
            return np.asarray(a > b, dtype=bool)
        case "GreaterOrEqual":
            return np.asarray(a >= b, dtype=bool)
        case "Less":
            return np.asarray(a < b, dtype=bool)
        case "LessOrEqual":
            return np.asarray(a <= b, dtype=bool)
        case "And":
            return a & b
        case _:
            return a | b


@_computes("Not")
def _not(call: Application) -> Array:
    return ~call.array(0)


@_computes("Sin", "Cos", "Tan", "Atan", "Asin", "Acos", "Sinh", "Cosh", "Asinh", "Acosh", "Atanh")
def _trigonometric(call: Application) -> Array:
    """Evaluate functions that only constants may have; never in float64."""
    return call.arithmetic.map(getattr(MP, call.node.op_type.lower()), call.array(0))


@_computes("CumSum", "CumProd")
def _cumulated(call: Application) -> Array:
    assert not call.attributes
    accumulate = np.cumsum if call.node.op_type == "CumSum" else np.cumprod
    return np.asarray(accumulate(call.array(0), axis=int(call.array(1))))


@_computes("DequantizeLinear")
def _dequantised(call: Application) -> Array:
    stored, scale = call.array(0).astype(np.int64), call.array(1)
    zero = call.array(2).astype(np.int64) if call.has(2) else np.zeros(scale.shape, dtype=np.int64)
    if scale.ndim:  # along one axis
        shape = [1] * stored.ndim
        shape[call.attributes.get("axis", 1)] = -1
        scale, zero = scale.reshape(shape), zero.reshape(shape)
    return (stored - zero) * scale


@_computes("Where")
def _where(call: Application) -> Array:
    return np.where(call.array(0), call.array(1), call.array(2))


@_computes("Reciprocal")
def _reciprocal(call: Application) -> Array:
    return 1 / call.array(0)


@_computes("Max", "Min", "Sum", "Mean")
def _variadic(call: Application) -> Array:
    combine = {"Max": np.maximum, "Min": np.minimum}.get(call.node.op_type, np.add)
    result = call.array(0)
    for index in range(1, len(call.inputs)):
        result = combine(result, call.array(index))
    return result / len(call.inputs) if call.node.op_type == "Mean" else result


@_computes("Clip")
def _clip(call: Application) -> Array:
    result = call.array(0)
    if call.has(1):
        result = np.maximum(result, call.array(1))
    if call.has(2):
        result = np.minimum(result, call.array(2))
    return result


@_computes("PRelu")
def _prelu(call: Application) -> Array:
    x, slope = call.array(0), call.array(1)
    return np.where(np.asarray(x < 0, dtype=bool), slope * x, x)


@_computes("Pow")
def _pow(call: Application) -> Array:
    (exponent,) = {float(e) for e in np.asarray(call.array(1)).ravel().tolist()}
    x, whole = call.array(0), int(exponent)
    if (2 * exponent) % 1:  # of constants
        return call.arithmetic.map(lambda base: base ** MP.mpf(exponent), x)
    if whole == exponent:
        return 1 / x**-whole if whole < 0 else x**whole
    root = call.sqrt(x) ** int(2 * abs(exponent))
    return 1 / root if exponent < 0 else root


@_computes("MatMul")
def _matmul(call: Application) -> Array:
    return np.asarray(np.matmul(call.array(0), call.array(1)))


@_computes("Gemm")
def _gemm(call: Application) -> Array:
    a, b = call.array(0), call.array(1)
    a = a.T if call.attributes.get("transA", 0) else a
    b = b.T if call.attributes.get("transB", 0) else b
    result = call.number("alpha", 1.0) * (a @ b)
    return result + call.number("beta", 1.0) * call.array(2) if call.has(2) else result


@_computes(
    "ReduceSum",
    "ReduceMean",
    "ReduceSumSquare",
    "ReduceL1",
    "ReduceL2",
    "ReduceMax",
    "ReduceMin",
    "ReduceProd",
    "ReduceLogSumExp",
)
def _reduce(call: Application) -> Array:
    x = call.array(0)
    axes = call.attributes.get("axes")
    if call.has(1):
        axes = call.array(1).tolist()
    if not axes:
        if call.attributes.get("noop_with_empty_axes", 0):
            return x
        axes = range(x.ndim)
    axes, keep = tuple(axes), bool(call.attributes.get("keepdims", 1))
    match call.node.op_type:
        case "ReduceMax":
            return np.asarray(np.max(x, axis=axes, keepdims=keep))
        case "ReduceMin":
            return np.asarray(np.min(x, axis=axes, keepdims=keep))
        case "ReduceProd":
            return np.asarray(np.prod(x, axis=axes, keepdims=keep))
        case "ReduceLogSumExp":
            most = np.max(x, axis=axes, keepdims=True)
            total = np.asarray(np.sum(call.exp(x - most), axis=axes, keepdims=keep))
            logarithm = call.arithmetic.map(call.arithmetic.functions.log, total)
            return np.asarray(logarithm + np.max(x, axis=axes, keepdims=keep))
        case "ReduceL1":
            return np.asarray(np.sum(abs(x), axis=axes, keepdims=keep))
        case "ReduceSumSquare":
            return np.asarray(np.sum(x * x, axis=axes, keepdims=keep))
        case "ReduceL2":
            return call.sqrt(np.asarray(np.sum(x * x, axis=axes, keepdims=keep)))
    total = np.asarray(np.sum(x, axis=axes, keepdims=keep))
    return total / math.prod(x.shape[axis] for axis in axes) if call.node.op_type == "ReduceMean" else total


@_computes("Softmax", "LogSoftmax")
def _softmax(call: Application) -> Array:
    x, axis = call.array(0), call.attributes.get("axis", -1)
    lowered = x - np.max(x, axis=axis, keepdims=True)
    powers = call.exp(lowered)
    total = np.sum(powers, axis=axis, keepdims=True)
    if call.node.op_type == "Softmax":
        return powers / total
    return lowered - call.arithmetic.map(call.arithmetic.functions.log, np.asarray(total))


def _by_channel(x: Array, parameter: Array) -> Array:
    return parameter.reshape(-1, *(1 for _ in x.shape[2:]))


@_computes("BatchNormalization")
def _batch_normalization(call: Application) -> Array:
    x = call.array(0)
    scale, shift, mean, variance = (_by_channel(x, call.array(index)) for index in range(1, 5))
    return (x - mean) / call.sqrt(variance + call.number("epsilon", float(np.float32(1e-5)))) * scale + shift


def _standardised(
    call: Application, x: Array, axes: tuple[int, ...], *, centre: bool = True
) -> tuple[Array, ...]:
    count = math.prod(x.shape[axis] for axis in axes)
    mean = np.sum(x, axis=axes, keepdims=True) / count
    deviation = x - mean if centre else x
    variance = np.sum(deviation * deviation, axis=axes, keepdims=True) / count
    spread = call.sqrt(variance + call.number("epsilon", float(np.float32(1e-5))))
    return deviation / spread, mean, 1 / spread


@_computes("LayerNormalization", "RMSNormalization")
def _layer_normalization(call: Application) -> tuple[Array, ...]:
    x = call.array(0)
    axes = tuple(range(call.attributes.get("axis", -1) % x.ndim, x.ndim))
    result, mean, reciprocal = _standardised(call, x, axes, centre=call.node.op_type == "LayerNormalization")
    result = result * call.array(1)
    return (result + call.array(2) if call.has(2) else result), mean, reciprocal


@_computes("InstanceNormalization", "GroupNormalization")
def _channel_normalization(call: Application) -> Array:
    x = call.array(0)
    groups = call.attributes.get("num_groups", x.shape[1])
    grouped = x.reshape(x.shape[0], groups, -1)
    result, _, _ = _standardised(call, grouped, (2,))
    return result.reshape(x.shape) * _by_channel(x, call.array(1)) + _by_channel(x, call.array(2))


# --- windows ---------------------------------------------------------------------------------------------


def _windows(
    call: Application, kernel: Sequence[int], spatial: Sequence[int]
) -> tuple[list[list[list[int]]], list[int]]:
    """Return along each axis the positions of every window, outside ones negative or too large, and the lengths."""
    rank = len(spatial)
    strides = call.attributes.get("strides", [1] * rank)
    dilations = call.attributes.get("dilations", [1] * rank)
    pads = list(call.attributes.get("pads", [0] * 2 * rank))
    automatic = call.attributes.get("auto_pad", b"NOTSET")
    along, lengths = [], []
    for axis in range(rank):
        extent = dilations[axis] * (kernel[axis] - 1) + 1
        before, after = pads[axis], pads[axis + rank]
        if automatic in (b"SAME_UPPER", b"SAME_LOWER"):
            count = -(-spatial[axis] // strides[axis])
            total = max(0, (count - 1) * strides[axis] + extent - spatial[axis])
            before = total // 2 if automatic == b"SAME_UPPER" else total - total // 2
            after = total - before
        elif automatic == b"VALID":
            before = after = 0
        count = (spatial[axis] + before + after - extent) // strides[axis] + 1
        lengths.append(count)
        along.append(
            [
                [i * strides[axis] - before + k * dilations[axis] for k in range(kernel[axis])]
                for i in range(count)
            ]
        )
    return along, lengths


def _positions(along: list[list[list[int]]], place: tuple[int, ...]) -> list[tuple[int, ...]]:
    from itertools import product

    return list(product(*(along[axis][i] for axis, i in enumerate(place))))


def _inside(position: tuple[int, ...], spatial: Sequence[int]) -> bool:
    return all(0 <= p < size for p, size in zip(position, spatial, strict=True))


@_computes("Conv")
def _conv(call: Application) -> Array:
    x, weight = call.array(0), call.array(1)
    spatial, kernel = x.shape[2:], weight.shape[2:]
    along, lengths = _windows(call, kernel, spatial)
    groups = call.attributes.get("group", 1)
    result = np.empty((x.shape[0], weight.shape[0], *lengths), dtype=x.dtype)
    per_group, inputs = weight.shape[0] // groups, weight.shape[1]
    offsets = list(np.ndindex(*kernel))
    for place in np.ndindex(*lengths):
        positions = _positions(along, place)
        for row in range(weight.shape[0]):
            first = row // per_group * inputs
            total = call.array(2)[row] if call.has(2) else 0 * weight.ravel()[0]
            for position, offset in zip(positions, offsets, strict=True):
                if _inside(position, spatial):
                    for channel in range(inputs):
                        total = total + weight[(row, channel, *offset)] * x[(0, first + channel, *position)]
            result[(0, row, *place)] = total
    return result


@_computes("AveragePool", "MaxPool")
def _pool(call: Application) -> Array:
    x, kernel = call.array(0), call.attributes["kernel_shape"]
    spatial = x.shape[2:]
    along, lengths = _windows(call, kernel, spatial)
    result = np.empty((x.shape[0], x.shape[1], *lengths), dtype=x.dtype)
    for place in np.ndindex(*lengths):
        positions = [p for p in _positions(along, place) if _inside(p, spatial)]
        for channel in range(x.shape[1]):
            taken = [x[(0, channel, *position)] for position in positions]
            if call.node.op_type == "MaxPool":
                result[(0, channel, *place)] = max(taken)
            else:
                count = math.prod(kernel) if call.attributes.get("count_include_pad", 0) else len(taken)
                result[(0, channel, *place)] = sum(taken[1:], taken[0]) / count
    return result


@_computes("GlobalAveragePool", "GlobalMaxPool")
def _global_pool(call: Application) -> Array:
    x = call.array(0)
    axes = tuple(range(2, x.ndim))
    if call.node.op_type == "GlobalMaxPool":
        return np.asarray(np.max(x, axis=axes, keepdims=True))
    return np.asarray(np.sum(x, axis=axes, keepdims=True)) / math.prod(x.shape[2:])


# --- recurrent layers ------------------------------------------------------------------------------------


@_computes("GRU", "LSTM", "RNN")
def _recurrent(call: Application) -> tuple[Array, ...]:
    """Step through sequences (T, B, I): all states, then the last ones of each direction."""
    x, weight, recurrent = (call.array(index) for index in range(3))
    gates = {"RNN": 1, "GRU": 3, "LSTM": 4}[call.node.op_type]
    directions, hidden = weight.shape[0], recurrent.shape[2]
    direction = call.attributes.get("direction", b"forward")
    zero = 0 * weight.ravel()[0]
    every, last = [], []
    for k in range(directions):
        backwards = direction == b"reverse" or k == 1
        w, r = (array[k].reshape(gates, hidden, -1) for array in (weight, recurrent))
        b = call.array(3)[k] if call.has(3) else np.full(2 * gates * hidden, zero)
        peepholes = call.array(7)[k] if call.has(7) else np.full(3 * hidden, zero)
        state = [
            call.array(5 + place)[k] if call.has(5 + place) else np.full((x.shape[1], hidden), zero)
            for place in range(1 + (gates == 4))
        ]
        step = {1: _step_of_rnn, 3: _step_of_gru, 4: _step_of_lstm}[gates]
        states = []
        for row in x[::-1] if backwards else x:
            parts = (row, w, r, b.reshape(2, gates, hidden), peepholes.reshape(3, hidden))
            state = step(call, k, parts, state)
            states.append(state[0])
        every.append(np.array(states[::-1] if backwards else states))
        last.append(state)
    ends = (np.array([state[place] for state in last]) for place in range(len(last[0])))
    return (np.stack(every, axis=1), *ends)


def _bend(call: Application, direction: int, number: int, argument: Array) -> Array:
    default = {"RNN": ["Tanh"], "GRU": ["Sigmoid", "Tanh"], "LSTM": ["Sigmoid", "Tanh", "Tanh"]}[
        call.node.op_type
    ]
    given = call.attributes.get("activations")
    names = [name.decode() for name in given] if given else default * (direction + 1)
    function = ELEMENTWISE[names[direction * len(default) + number]]
    return call.arithmetic.map(lambda value: function(call.arithmetic.functions, value), argument)


def _step_of_rnn(call: Application, k: int, parts: Any, state: Sequence[Array]) -> list[Array]:
    x, w, r, b, _ = parts
    return [_bend(call, k, 0, x @ w[0].T + b[0, 0] + state[0] @ r[0].T + b[1, 0])]


def _step_of_gru(call: Application, k: int, parts: Any, state: Sequence[Array]) -> list[Array]:
    x, w, r, b, _ = parts
    (h,) = state
    update, reset = (
        _bend(call, k, 0, x @ w[gate].T + b[0, gate] + h @ r[gate].T + b[1, gate]) for gate in (0, 1)
    )
    if call.attributes.get("linear_before_reset", 0):
        kept = reset * (h @ r[2].T + b[1, 2])
    else:
        kept = (reset * h) @ r[2].T + b[1, 2]
    return [(1 - update) * _bend(call, k, 1, x @ w[2].T + b[0, 2] + kept) + update * h]


def _step_of_lstm(call: Application, k: int, parts: Any, state: Sequence[Array]) -> list[Array]:
    x, w, r, b, peepholes = parts
    h, c = state
    let_in, out, forget, new = (x @ w[g].T + b[0, g] + h @ r[g].T + b[1, g] for g in range(4))
    opened = _bend(call, k, 0, let_in + peepholes[0] * c)
    coupled = call.attributes.get("input_forget", 0)
    kept = 1 - opened if coupled else _bend(call, k, 0, forget + peepholes[2] * c)
    c = kept * c + opened * _bend(call, k, 1, new)
    return [_bend(call, k, 0, out + peepholes[1] * c) * _bend(call, k, 2, c), c]


# --- moving ----------------------------------------------------------------------------------------------

_MOVED: dict[tuple[bytes, int, str], list[Array]] = {}
_DATA: dict[str, Callable[[int], Sequence[int]]] = {
    "Concat": range,
    "Pad": lambda count: [0, 2] if count > 2 else [0],
}


@_computes(*MOVING)
def _move(call: Application) -> tuple[Array, ...]:
    """Move the numbers of elements in onnxruntime, then take these elements."""
    data = _DATA.get(call.node.op_type, lambda count: [0])(len(call.inputs))
    pool = [np.zeros(1) if call.arithmetic.convert is None else call.arithmetic.lift(np.zeros(1))]
    feeds: list[Array | None] = []
    first = 1
    for index, array in enumerate(call.inputs):
        if array is not None and index in data:
            pool.append(array.ravel())
            array = np.arange(first, first + array.size, dtype=np.float32).reshape(array.shape)
            first += array.size
        feeds.append(array)
    flat = np.concatenate(pool)
    key = (
        call.node.SerializeToString(deterministic=True),
        call.opset,
        repr([None if f is None else (f.shape, f.tolist()) for f in feeds]),
    )
    if key not in _MOVED:
        if len(_MOVED) > 5000:
            _MOVED.clear()
        _MOVED[key] = run_alone(call.node, call.opset, feeds)
    return tuple(flat[np.asarray(moved).astype(np.int64)] for moved in _MOVED[key])


def run_alone(node: onnx.NodeProto, opset: int, feeds: Sequence[Array | None]) -> list[Array]:
    """Run one node on arrays in onnxruntime, all but data as initialisers."""
    import onnxruntime

    call = onnx.NodeProto()
    call.CopyFrom(node)
    del call.input[:], call.output[:]
    call.input.extend("" if feed is None else f"i{k}" for k, feed in enumerate(feeds))
    call.output.extend(f"o{k}" if name else "" for k, name in enumerate(node.output))
    graph = onnx.helper.make_graph(
        [call],
        "alone",
        [],
        [onnx.helper.make_tensor_value_info(n, onnx.TensorProto.FLOAT, None) for n in call.output if n],
        [numpy_helper.from_array(np.asarray(f), f"i{k}") for k, f in enumerate(feeds) if f is not None],
    )
    model = onnx.helper.make_model(graph, opset_imports=[onnx.helper.make_opsetid("", opset)], ir_version=10)
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4
    content = model.SerializeToString()
    try:
        session = onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
        return [np.asarray(result) for result in session.run(None, {})]
    except Exception as error:  # onnxruntime raises its own, undocumented classes
        raise ValueError(f"{node.op_type} cannot be run: {error}") from error


# --- graphs ----------------------------------------------------------------------------------------------


def fold(node: onnx.NodeProto, opset: int, arrays: Sequence[Array | None]) -> list[Array]:
    """Evaluate a node of constants in the element types of the model."""
    from onnx.reference import ReferenceEvaluator

    names = [f"i{k}" if array is not None else "" for k, array in enumerate(arrays)]
    call = onnx.NodeProto()
    call.CopyFrom(node)
    del call.input[:], call.output[:]
    call.input.extend(names)
    call.output.extend(f"o{k}" if name else "" for k, name in enumerate(node.output))
    anything = onnx.TypeProto()
    graph = onnx.helper.make_graph(
        [call],
        "constant",
        [onnx.helper.make_value_info(name, anything) for name in names if name],
        [onnx.helper.make_value_info(name, anything) for name in call.output if name],
    )
    model = onnx.helper.make_model(graph, opset_imports=[onnx.helper.make_opsetid("", opset)])
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        given = {name: array for name, array in zip(names, arrays, strict=True) if name}
        return [np.asarray(result) for result in ReferenceEvaluator(model).run(None, given)]


def apply(
    node: onnx.NodeProto, opset: int, inputs: Sequence[Array | None], arithmetic: Arithmetic
) -> Sequence[Array]:
    """Evaluate a node that depends on the observation; constants among its inputs are lifted as well."""
    if node.op_type in ("Shape", "Size"):
        shape = np.array(inputs[0].shape if inputs[0] is not None else (), dtype=np.int64)
        start, end = attributes_of(node).get("start", 0), attributes_of(node).get("end")
        return [shape[start:end] if node.op_type == "Shape" else np.asarray(shape.prod())]
    lifted = [
        None if array is None else arithmetic.lift(array) if array.dtype != object else array
        for array in inputs
    ]
    with np.errstate(all="ignore"):
        results = OPERATORS[node.op_type](Application(node, opset, lifted, arithmetic))
    return [np.asarray(result) for result in results]


@dataclass(eq=False)
class Interpreter:
    """A model with one input and one output, its constants evaluated once.

    Notes
    -----
    A constant that is computed from stored ones is the real number that the graph means: types round only where a step
    is taken, as by QuantizeLinear.
    """

    model: onnx.ModelProto
    nodes: Sequence[onnx.NodeProto] = field(init=False)
    """Those that depend on the observation."""

    def __post_init__(self) -> None:
        known = {tensor.name for tensor in self.model.graph.initializer}
        nodes = []
        for node in self.model.graph.node:
            if all(name in known for name in node.input if name):
                known.update(node.output)
            else:
                nodes.append(node)
        self.nodes = nodes
        self._constants: dict[int, Mapping[str, Array]] = {}

    @property
    def opset(self) -> int:
        """Return the version of the default operator set."""
        return int(next(o.version for o in self.model.opset_import if o.domain in ("", "ai.onnx")))

    @cached_property
    def is_rational(self) -> bool:
        """Whether fractions are enough."""
        stored = {tensor.name: numpy_helper.to_array(tensor) for tensor in self.model.graph.initializer}
        return all(
            node.op_type in RATIONAL
            or node.op_type in STEPS
            or (node.op_type == "Pow" and bool((stored.get(node.input[1], np.array(0.5)) % 1 == 0).all()))
            for node in self.model.graph.node
        )

    def constants(self, arithmetic: Arithmetic) -> Mapping[str, Array]:
        """Return all constants by name."""
        if id(arithmetic) not in self._constants:
            self._constants[id(arithmetic)] = self._evaluated_constants(arithmetic)
        return self._constants[id(arithmetic)]

    def _evaluated_constants(self, arithmetic: Arithmetic) -> Mapping[str, Array]:
        stored = {tensor.name: numpy_helper.to_array(tensor) for tensor in self.model.graph.initializer}
        real = {name: arithmetic.lift(array) for name, array in stored.items()}
        for node in self.model.graph.node:
            if not all(name in stored for name in node.input if name):
                continue
            typed = fold(node, self.opset, [stored[name] if name else None for name in node.input])
            stored.update(zip(node.output, typed, strict=False))
            results = [arithmetic.lift(array) for array in typed]
            if typed[0].dtype.kind not in "biu" and node.op_type in OPERATORS and node.op_type not in STEPS:
                inputs = [real[name] if name else None for name in node.input]
                results = list(apply(node, self.opset, inputs, arithmetic))
            real.update(zip(node.output, results, strict=False))
        return real

    def __call__(self, point: Array, arithmetic: Arithmetic = PRECISE) -> list[Any]:
        """Return the flat output at one observation of the input's shape at batch size 1."""
        graph = self.model.graph
        values = {**self.constants(arithmetic), graph.input[0].name: arithmetic.lift(point)}
        for node in self.nodes:
            inputs = [values[name] if name else None for name in node.input]
            outputs = apply(node, self.opset, inputs, arithmetic)
            values.update((name, value) for name, value in zip(node.output, outputs, strict=False) if name)
        return list(values[graph.output[0].name].ravel().tolist())
