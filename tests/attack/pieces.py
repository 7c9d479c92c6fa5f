"""Pieces of random graphs, one for each operator that is read: with random attributes, shapes and constants."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import onnx

from tests.attack.building import KINDS, Builder, Unfit, Value
from tests.attack.constants import condition, constant, integers

Piece = Callable[[Builder, Value], Value]
PIECES: dict[str, Piece] = {}
"""By operator: what a piece makes of a value contains that operator."""


def _writes(*operators: str) -> Callable[[Callable[[Builder, Value, str], Value]], Callable[..., Value]]:
    def register(piece: Callable[[Builder, Value, str], Value]) -> Callable[..., Value]:
        for operator in operators:
            PIECES[operator] = lambda g, x, operator=operator: piece(g, x, operator)  # type: ignore[misc]
        return piece

    return register


# --- what several pieces need ----------------------------------------------------------------------------


def bounded(g: Builder, x: Value) -> Value:
    """Return something of moderate size."""
    match g.between(0, 5):
        case 0:
            return g.call("Tanh", x)
        case 1:
            return g.call("Sigmoid", x)
        case 2:
            return g.call(
                "Clip", x, g.stored(g.typed(g.number(-1.0, -3.0))), g.stored(g.typed(g.number(0.5, 2.0)))
            )
        case 3:
            return g.call("Softsign", x) if g.has("Softsign") else g.call("Tanh", x)
        case 4:
            return scaled_down(g, x)
    return x


def scaled_down(g: Builder, x: Value) -> Value:
    """Multiply so that the largest value at the probes becomes about 1."""
    largest = max(float(np.abs(sample).max(initial=0.0)) for sample in x.samples)
    return g.call("Mul", x, g.stored(g.typed(1.0 / max(largest, 1e-2))))


def positive(g: Builder, x: Value) -> Value:
    """Return something above 0, sometimes not far above it."""
    margin = g.stored(g.typed(g.number(0.01, 0.1, 1.0)))
    match g.between(0, 4):
        case 0:
            return g.call("Exp", bounded(g, scaled_down(g, x)))
        case 1:
            return g.call("Add", g.call("Abs", x), margin)
        case 2:
            return g.call("Add", g.call("Mul", x, x), margin)
        case 3:
            return g.call("Add", g.call("Sigmoid", x), margin)
    return g.call("Max", bounded(g, x), margin)


def linear(g: Builder, x: Value, size: int | None = None) -> Value:
    """Apply a dense layer: Gemm, MatMul, or both with their bias spelled out."""
    x = g.ranked(x, 2)
    rows, columns = size or g.between(1, 8), x.shape[1]
    weight = g.numbers(columns, rows) / math.sqrt(columns)
    if g.chance(0.5):
        transposed = g.chance(0.5)
        extra = {"transB": 1} if transposed else {}
        if g.chance(0.15):
            extra |= {"alpha": g.number(0.5, -1.3, 2.0), "beta": g.number(1.0, 0.7)}  # type: ignore[dict-item]
        bias = constant(g, g.numbers(rows) * 0.5) if g.chance(0.8) else None
        return g.call("Gemm", x, constant(g, weight.T if transposed else weight), bias, **extra)
    product = g.call("MatMul", x, constant(g, weight))
    return g.call("Add", product, constant(g, g.numbers(rows) * 0.5)) if g.chance(0.8) else product


def other(g: Builder, x: Value) -> Value:
    """Return another value of the shape of x, made from it."""
    match g.between(0, 3):
        case 0:
            return bounded(g, x)
        case 1:
            return g.call("Mul", x, constant(g, g.numbers(*x.shape[1:])))
        case 2:
            return g.call("Relu", x)
    return x


def trailing(g: Builder, x: Value) -> tuple[int, ...]:
    """Draw a shape that broadcasts to that of x, its batch axis left out."""
    shape = [size if g.chance(0.6) else 1 for size in x.shape[1:]]
    return tuple(shape[g.between(0, len(shape)) :]) if g.chance(0.3) else tuple(shape)


# --- functions of one number -----------------------------------------------------------------------------


@_writes(
    "Abs", "Erf", "HardSwish", "Identity", "Mish", "Neg", "Relu", "Sigmoid", "Sign", "Softplus", "Softsign", "Tanh",
)  # fmt: skip
def _unary(g: Builder, x: Value, operator: str) -> Value:
    return g.call(operator, x)


@_writes("Celu", "Elu", "LeakyRelu", "ThresholdedRelu", "Selu", "HardSigmoid", "Swish", "Gelu")
def _parametric(g: Builder, x: Value, operator: str) -> Value:
    attributes: dict[str, float | str] = {}
    match operator:
        case "Gelu":
            attributes = {"approximate": g.pick(["none", "tanh"])}
        case "HardSigmoid":
            attributes = {"alpha": g.number(0.2, 1 / 6, 1.0), "beta": g.number(0.5, 0.0, -2.0)}
        case "Selu" if g.chance(0.5):
            attributes = {"alpha": g.number(1.5, 3.0), "gamma": g.number(0.5, 2.0)}
        case "LeakyRelu":
            attributes = {"alpha": g.number(0.01, 0.2, 1.5, -0.5, 1e-10)}
        case "Selu":
            attributes = {}
        case _:
            attributes = {"alpha": g.number(0.1, 0.5, 1.0, 1.5)}
    return g.call(operator, x, **attributes)


@_writes("Exp")
def _exp(g: Builder, x: Value, operator: str) -> Value:
    return g.call("Exp", bounded(g, x) if g.chance(0.7) else scaled_down(g, x))


@_writes("Log", "Sqrt", "Reciprocal")
def _of_positive(g: Builder, x: Value, operator: str) -> Value:
    return g.call(operator, positive(g, x))


@_writes("Clip")
def _clip(g: Builder, x: Value, operator: str) -> Value:
    low = g.number(-1.0, -0.5, 0.0, -3.0, 0.1, -1e3)
    high = low + g.number(0.25, 1.0, 6.0, 2e3)
    ends = [constant(g, np.array(end), chained=0.1) for end in (low, high)]
    if g.chance(0.2):
        ends[g.between(0, 1)] = None  # type: ignore[call-overload]
    return g.call("Clip", x, *ends)


@_writes("PRelu")
def _prelu(g: Builder, x: Value, operator: str) -> Value:
    return g.call("PRelu", x, constant(g, g.numbers(*trailing(g, x)) * 0.3))


@_writes("Pow")
def _pow(g: Builder, x: Value, operator: str) -> Value:
    exponent = g.number(2.0, 3.0, 1.0, 0.5, -1.0, -0.5, 4.0, -2.0, 5.0, 0.0)
    whole = exponent == int(exponent) and exponent > 0
    base = bounded(g, x) if whole else positive(g, x)
    if g.kind == "float32" and g.chance(0.2) and whole:
        return g.call("Pow", base, g.stored(np.int64(exponent)))
    return g.call("Pow", base, g.stored(g.typed(exponent)))


@_writes("Dropout")
def _dropout(g: Builder, x: Value, operator: str) -> Value:
    return g.call("Dropout", x)


@_writes("Cast")
def _cast(g: Builder, x: Value, operator: str) -> Value:
    for _ in range(g.between(1, 2)):
        through = g.pick([kind for kind in (*KINDS, "bfloat16") if kind != g.kind])
        to = onnx.TensorProto.BFLOAT16 if through == "bfloat16" else KINDS[through]
        x = g.call("Cast", x, to=to)
    return g.call("Cast", x, to=KINDS[g.kind])


# --- arithmetic ------------------------------------------------------------------------------------------


@_writes("Add", "Sub", "Mul", "Div")
def _arithmetic(g: Builder, x: Value, operator: str) -> Value:
    match g.between(0, 3):
        case 0 | 1:
            numbers = g.numbers(*trailing(g, x))
            if operator == "Div":
                numbers = g.typed(np.where(numbers == 0, 1.0, numbers))
            pair = [x, constant(g, numbers)]
        case 2:
            pair = [x, positive(g, other(g, x)) if operator == "Div" else other(g, x)]
        case _:
            pair = [constant(g, g.numbers(*trailing(g, x))), positive(g, x) if operator == "Div" else x]
    if operator in ("Add", "Mul") and g.chance(0.3):
        pair.reverse()
    return g.call(operator, *pair)


@_writes("Max", "Min", "Sum", "Mean")
def _variadic(g: Builder, x: Value, operator: str) -> Value:
    values = [x]
    for _ in range(g.between(0, 2)):
        values.append(other(g, x) if g.chance(0.6) else constant(g, g.numbers(*trailing(g, x))))
    return g.call(operator, *[values[k] for k in g.rng.permutation(len(values))])


@_writes("MatMul")
def _matmul(g: Builder, x: Value, operator: str) -> Value:
    match g.between(0, 3):
        case 0:
            x = g.ranked(x, 2)
            return g.call("MatMul", x, constant(g, g.numbers(x.shape[1], g.between(1, 6))))
        case 1:
            x = g.ranked(x, 3)
            return g.call("MatMul", constant(g, g.numbers(g.between(1, 4), x.shape[1])), x)
        case 2:
            x = g.ranked(x, 3)
            return g.call("MatMul", x, constant(g, g.numbers(1, x.shape[2], g.between(1, 4))))
    x = g.ranked(bounded(g, x), 3)
    turned = g.call("Transpose", other(g, x), perm=[0, 2, 1])
    return g.call("MatMul", x, turned)


@_writes("Gemm")
def _gemm(g: Builder, x: Value, operator: str) -> Value:
    x = g.ranked(x, 2)
    if not g.batched and g.chance(0.4):
        weight = g.numbers(g.between(1, 4), x.shape[1])
        addend = constant(g, g.numbers(weight.shape[0], 1)) if g.chance(0.5) else None
        return g.call("Gemm", constant(g, weight), x, addend, transB=1, alpha=g.number(1.0, 0.5))
    rows = g.between(1, 6)
    weight = g.numbers(rows, x.shape[1]) / math.sqrt(x.shape[1])
    bias = constant(g, g.numbers(*g.pick([(rows,), (1, rows), ()]))) if g.chance(0.8) else None
    factors = {"alpha": g.number(1.0, 1.0, 0.5, -1.5), "beta": g.number(1.0, 1.0, 2.0, 0.1)}
    return g.call("Gemm", x, constant(g, weight), bias, transB=1, **factors)


# --- reductions and normalisations -----------------------------------------------------------------------


@_writes("ReduceSum", "ReduceMean", "ReduceSumSquare", "ReduceL1", "ReduceL2", "ReduceMax", "ReduceMin")
def _reduction(g: Builder, x: Value, operator: str) -> Value:
    x = g.ranked(x, g.between(2, 3))
    axes = sorted({g.axis(x) % len(x.shape) for _ in range(g.between(1, 2))})
    keep = int(g.chance(0.6) or len(axes) == len(x.shape))
    if operator == "ReduceL2":
        x = g.call("Add", x, g.stored(g.typed(0.1))) if g.chance(0.5) else positive(g, x)
    if g.version(operator) >= (13 if operator == "ReduceSum" else 18):
        return g.call(operator, x, integers(g, *axes), keepdims=keep)
    return g.call(operator, x, axes=axes, keepdims=keep)


@_writes("ReduceLogSumExp")
def _log_sum_exp(g: Builder, x: Value, operator: str) -> Value:
    x = g.ranked(linear(g, x, g.between(2, 6)), 2)
    if not g.chance(0.3):
        x = bounded(g, x)
    if g.version(operator) >= 18:
        return g.call(operator, x, integers(g, 1), keepdims=1)
    return g.call(operator, x, axes=[1], keepdims=1)


@_writes("Softmax", "LogSoftmax")
def _softmax(g: Builder, x: Value, operator: str) -> Value:
    if x.size > 10:
        x = linear(g, x, g.between(2, 5))
    x = g.ranked(x, g.between(2, 3))
    return g.call(operator, x if g.chance(0.3) else bounded(g, x), axis=g.axis(x))


@_writes("BatchNormalization")
def _batch_normalization(g: Builder, x: Value, operator: str) -> Value:
    x = g.ranked(x, g.between(2, 4))
    channels = x.shape[1]
    variance = g.typed(np.abs(g.numbers(channels)) + g.number(0.0, 1e-3, 1.0))
    statistics = [constant(g, g.numbers(channels)) for _ in range(3)]
    return g.call(operator, x, *statistics, constant(g, variance), epsilon=g.number(1e-5, 1e-3))


@_writes("LayerNormalization", "RMSNormalization")
def _layer_normalization(g: Builder, x: Value, operator: str) -> Value:
    x = g.ranked(_several(g, x), g.between(2, 3))
    axis = g.between(1, len(x.shape) - 1)
    if math.prod(x.shape[axis:]) < 2:
        axis = 1
    shape = x.shape[axis:]
    given = [constant(g, g.numbers(*shape))]
    if operator == "LayerNormalization" and g.chance(0.7):
        given.append(constant(g, g.numbers(*shape)))
    axis = axis - len(x.shape) if g.chance(0.5) else axis
    return g.call(operator, x, *given, axis=axis, epsilon=g.number(1e-5, 1e-3, 1e-6))


@_writes("InstanceNormalization")
def _instance_normalization(g: Builder, x: Value, operator: str) -> Value:
    x = _several(g, x)
    channels = g.pick([d for d in range(1, x.size) if x.size % d == 0])
    x = g.reshaped(x, 1, channels, x.size // channels)
    return g.call(
        operator, x, *(constant(g, g.numbers(channels)) for _ in range(2)), epsilon=g.number(1e-5, 1e-3)
    )


@_writes("GroupNormalization")
def _group_normalization(g: Builder, x: Value, operator: str) -> Value:
    if g.opset < 21:
        raise Unfit("another meaning before opset 21")
    groups, channels, length = g.pick([1, 2]), g.pick([1, 2]), g.pick([2, 3])
    x = g.reshaped(linear(g, x, groups * channels * length), 1, groups * channels, length)
    given = [constant(g, g.numbers(groups * channels)) for _ in range(2)]
    return g.call(operator, x, *given, num_groups=groups, epsilon=g.number(1e-5, 1e-3))


def _several(g: Builder, x: Value) -> Value:
    """Return at least two numbers."""
    return x if x.size > 1 else linear(g, x, g.between(2, 6))


# --- windows ---------------------------------------------------------------------------------------------


def _image(g: Builder, x: Value) -> Value:
    """Return a value with channels and one or two spatial axes, none of length 1 if that is possible."""
    channels = g.pick([1, 2, 4])
    spatial = g.pick([(4,), (5,), (6,), (3, 3), (2, 3)])
    size = channels * math.prod(spatial)
    if size > 24:
        channels, size = 1, math.prod(spatial)
    return g.reshaped(linear(g, x, size), 1, channels, *spatial)


@_writes("Conv")
def _conv(g: Builder, x: Value, operator: str) -> Value:
    x = _image(g, x)
    rank, inputs = len(x.shape) - 2, x.shape[1]
    groups = g.pick([d for d in (1, 2, 4) if inputs % d == 0])
    outputs = groups * g.between(1, 2)
    kernel = [g.between(1, min(3, size)) for size in x.shape[2:]]
    weight = g.numbers(outputs, inputs // groups, *kernel) / math.sqrt(math.prod(kernel) * inputs / groups)
    attributes: dict[str, object] = {"group": groups, "kernel_shape": kernel}
    match g.between(0, 3):
        case 0:
            attributes["pads"] = [g.between(0, 1) for _ in range(2 * rank)]
            attributes["strides"] = [g.between(1, 2) for _ in range(rank)]
        case 1:
            attributes["auto_pad"] = g.pick(["SAME_UPPER", "SAME_LOWER", "VALID"])
        case 2 if all(2 * (k - 1) + 1 <= size for k, size in zip(kernel, x.shape[2:], strict=True)):
            attributes["dilations"] = [2] * rank
    bias = constant(g, g.numbers(outputs)) if g.chance(0.7) else None
    return g.call("Conv", x, constant(g, weight), bias, **attributes)


@_writes("AveragePool", "MaxPool")
def _pool(g: Builder, x: Value, operator: str) -> Value:
    x = _image(g, x)
    rank = len(x.shape) - 2
    kernel = [g.between(2, min(3, size)) for size in x.shape[2:]]
    attributes: dict[str, object] = {
        "kernel_shape": kernel,
        "strides": [g.between(1, 2) for _ in range(rank)],
    }
    if g.chance(0.5):
        attributes["pads"] = [1] * 2 * rank
    if operator == "AveragePool" and g.chance(0.5):
        attributes["count_include_pad"] = 1
    return g.call(operator, x, **attributes)


@_writes("GlobalAveragePool", "GlobalMaxPool")
def _global_pool(g: Builder, x: Value, operator: str) -> Value:
    return g.call(operator, _image(g, x))


# --- moving ----------------------------------------------------------------------------------------------


@_writes("GRU", "LSTM", "RNN")
def _recurrent(g: Builder, x: Value, operator: str) -> Value:
    """Read what is there as a sequence of two to four steps."""
    gates, hidden, steps = {"RNN": 1, "GRU": 3, "LSTM": 4}[operator], g.between(1, 3), g.between(2, 4)
    features = max(1, min(3, x.size // steps))
    sequence = g.reshaped(linear(g, x, steps * features), 1, steps, features)
    sequence = g.call("Transpose", sequence, perm=[1, 0, 2])
    direction = g.pick(["forward", "reverse", "bidirectional"])
    ways = 2 if direction == "bidirectional" else 1
    weights = [
        constant(g, g.numbers(ways, gates * hidden, size) / math.sqrt(size)) for size in (features, hidden)
    ]
    bias = constant(g, g.numbers(ways, 2 * gates * hidden)) if g.chance(0.7) else None
    attributes: dict[str, object] = {"hidden_size": hidden, "direction": direction}
    if operator == "GRU":
        attributes["linear_before_reset"] = g.between(0, 1)
    count = 3 if operator == "LSTM" else 2
    results = g.call(operator, sequence, *weights, bias, count=count, **attributes)
    if g.chance(0.3):  # every state (T, D, B, H), else one of the last ones (D, B, H)
        turned = g.call("Transpose", results[0], perm=[2, 0, 1, 3])
    else:
        turned = g.call("Transpose", results[g.between(1, count - 1)], perm=[1, 0, 2])
    return g.reshaped(turned, 1, turned.size)


@_writes("Concat")
def _concat(g: Builder, x: Value, operator: str) -> Value:
    axis = g.axis(x)
    parts = [x, other(g, x)]
    if g.chance(0.4) and not g.batched:
        parts.append(constant(g, g.numbers(*x.shape)))
    return g.call("Concat", *parts, axis=axis)


@_writes("Compress")
def _compress(g: Builder, x: Value, operator: str) -> Value:
    axis = g.axis(x)
    chosen = g.rng.random(x.shape[axis]) < 0.7
    chosen[g.between(0, len(chosen) - 1)] = True
    return g.call("Compress", x, g.stored(chosen), axis=axis)


@_writes("DepthToSpace", "SpaceToDepth")
def _depth(g: Builder, x: Value, operator: str) -> Value:
    x = linear(g, x, 8)
    shape = (1, 4, 1, 2) if operator == "DepthToSpace" else (1, 1, 2, 4)
    extra = {"mode": g.pick(["DCR", "CRD"])} if operator == "DepthToSpace" else {}
    return g.call(operator, g.reshaped(x, *shape), blocksize=2, **extra)


@_writes("Expand")
def _expand(g: Builder, x: Value, operator: str) -> Value:
    x = g.ranked(x, 2)
    return g.call("Expand", g.reshaped(x, 1, 1, x.shape[1]), integers(g, 1, g.between(1, 3), 1))


@_writes("Flatten")
def _flatten(g: Builder, x: Value, operator: str) -> Value:
    axis = 1 if g.batched else g.between(0, len(x.shape))
    return g.call("Flatten", x, axis=axis)


@_writes("Gather")
def _gather(g: Builder, x: Value, operator: str) -> Value:
    axis = g.axis(x)
    size = x.shape[axis]
    shape: tuple[int, ...] = g.pick([(), (1,), (3,), (2, 2)])
    if shape == () and len(x.shape) == 2:
        shape = (2,)
    return g.call("Gather", x, g.stored(g.rng.integers(-size, size, shape)), axis=axis)


@_writes("GatherElements")
def _gather_elements(g: Builder, x: Value, operator: str) -> Value:
    if g.batched:
        raise Unfit("names the batch")
    axis = g.axis(x)
    return g.call(operator, x, g.stored(g.rng.integers(0, x.shape[axis], x.shape)), axis=axis)


@_writes("GatherND")
def _gather_nd(g: Builder, x: Value, operator: str) -> Value:
    if g.batched:
        raise Unfit("names the batch")
    index = np.stack([g.rng.integers(0, size, 4) for size in x.shape], axis=-1)
    return g.reshaped(g.call(operator, x, g.stored(index)), 1, 4)


@_writes("Pad")
def _pad(g: Builder, x: Value, operator: str) -> Value:
    rank, axis = len(x.shape), g.axis(x)
    pads = np.zeros(2 * rank, dtype=np.int64)
    mode = g.pick(["constant", "reflect", "edge"])
    most = min(2, x.shape[axis] - 1) if mode == "reflect" else 2
    pads[[axis % rank, axis % rank + rank]] = g.rng.integers(0, most + 1, 2)
    if mode == "constant" and g.chance(0.7):
        return g.call("Pad", x, g.stored(pads), constant(g, np.array(g.number(0.5, -2.0, 0.0)), chained=0.0))
    return g.call("Pad", x, g.stored(pads), mode=mode)


@_writes("Reshape")
def _reshape(g: Builder, x: Value, operator: str) -> Value:
    return g.reshaped(x, 1, *g.factors(x.size, g.between(1, 3)))


@_writes("ReverseSequence")
def _reverse(g: Builder, x: Value, operator: str) -> Value:
    if g.batched:
        raise Unfit("names the batch")
    x = g.ranked(x, g.between(2, 3))
    return g.call(operator, x, integers(g, g.between(1, x.shape[1])), batch_axis=0, time_axis=1)


@_writes("Slice")
def _slice(g: Builder, x: Value, operator: str) -> Value:
    axis = g.axis(x)
    if g.chance(0.4):
        return g.call("Slice", x, *(integers(g, k) for k in (-1, -(2**40), axis, -g.between(1, 2))))
    start = g.between(0, x.shape[axis] - 1)
    return g.call("Slice", x, integers(g, start), integers(g, 2**40), integers(g, axis))


@_writes("Split")
def _split(g: Builder, x: Value, operator: str) -> Value:
    x = g.ranked(_several(g, x), 2)
    left = g.between(1, x.shape[1] - 1)
    sizes = integers(g, left, x.shape[1] - left)
    first, second = g.call("Split", x, sizes, axis=g.pick([1, -1]), count=2)
    if first.shape == second.shape and g.chance(0.5):
        return g.call(g.pick(["Mul", "Add", "Max", "Sub"]), first, g.call("Sigmoid", second))
    return g.call("Concat", bounded(g, second), first, axis=1)


@_writes("Squeeze", "Unsqueeze")
def _squeeze(g: Builder, x: Value, operator: str) -> Value:
    x = g.call("Unsqueeze", x, integers(g, g.between(1, len(x.shape))))
    if operator == "Unsqueeze":
        return x
    ones = [axis for axis, size in enumerate(x.shape) if axis and size == 1]
    return g.call("Squeeze", x, integers(g, g.pick(ones)))


@_writes("Tile")
def _tile(g: Builder, x: Value, operator: str) -> Value:
    repeats = [1] * len(x.shape)
    repeats[g.axis(x)] = g.between(1, 3)
    return g.call("Tile", x, integers(g, *repeats))


@_writes("Transpose")
def _transpose(g: Builder, x: Value, operator: str) -> Value:
    x = g.ranked(x, g.between(2, 4))
    first = 1 if g.batched else 0
    order = [*range(first), *(first + k for k in g.rng.permutation(len(x.shape) - first))]
    turned = g.call("Transpose", x, perm=[int(k) for k in order])
    return g.reshaped(turned, 1, turned.size) if turned.shape[0] != 1 else turned


@_writes("Trilu")
def _trilu(g: Builder, x: Value, operator: str) -> Value:
    return g.call("Trilu", g.ranked(x, 3), g.stored(np.int64(g.between(-1, 1))), upper=g.between(0, 1))


# --- choices ---------------------------------------------------------------------------------------------


@_writes("Where")
def _where(g: Builder, x: Value, operator: str) -> Value:
    branches = [x, other(g, x) if g.chance(0.6) else constant(g, g.numbers(*trailing(g, x)))]
    if g.chance(0.5):
        branches.reverse()
    return g.call("Where", condition(g, *x.shape[1:]), *branches)


@_writes("Greater", "GreaterOrEqual", "Less", "LessOrEqual")
def _rectifier(g: Builder, x: Value, operator: str) -> Value:
    above = operator.startswith("Greater")
    strict = operator in ("Greater", "Less")
    zero = g.stored(g.typed(0.0))
    match g.between(0, 3):
        case 0:
            bound, branches = zero, [x, g.call("Mul", x, g.stored(g.typed(g.number(0.01, 0.2, -0.3))))]
        case 1:
            raised = g.call("Sub", g.call("Exp", scaled_down(g, x)), g.stored(g.typed(1.0)))
            bound, branches = zero, [x, raised]
            x = branches[0] = scaled_down(g, x)
            raised = g.call("Sub", g.call("Exp", x), g.stored(g.typed(1.0)))
            branches[1] = g.call("Mul", raised, g.stored(g.typed(g.number(1.0, 0.5, 1.7))))
        case 2 if strict == above:
            number = g.number(0.5, -0.25, 1.0)
            bound, branches = g.stored(g.typed(number)), [x, g.stored(g.typed(g.number(0.0, 0.1, number)))]
        case _:
            bound = g.stored(g.typed(g.number(20.0, 3.0)))
            branches = [x, g.call("Softplus", x)]
            strict = True
    x_first = g.chance(0.7) or strict != (operator in ("Greater", "Less"))
    found = g.call(operator, x, bound) if x_first else g.call(operator, bound, x)
    if (above == x_first) is False:
        branches.reverse()
    return g.call("Where", found, *branches)


@_writes("Or")
def _shrinkage(g: Builder, x: Value, operator: str) -> Value:
    width = g.number(0.25, 0.5, 2.0)
    above = g.call("Greater", x, g.stored(g.typed(width)))
    below = g.call("Less", x, g.stored(g.typed(-width)))
    return g.call("Where", g.call("Or", above, below), x, g.stored(g.typed(0.0)))
