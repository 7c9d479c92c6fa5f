"""Functions that exporters spell out from parts, with the right constants and with slightly wrong ones."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from tests.attack.building import Builder, Value
from tests.attack.constants import check_quantised, constant, integers
from tests.attack.pieces import PIECES, bounded, linear, scaled_down

Idiom = Callable[[Builder, Value], Value]
IDIOMS: list[Idiom] = []


def _idiom(function: Idiom) -> Idiom:
    IDIOMS.append(function)
    return function


def near(g: Builder, value: float) -> Value:
    """Store a constant, sometimes rounded to three decimals or off by a little."""
    off = g.pick(
        [
            value,
            value,
            value,
            round(value, 3),
            round(value, 2),
            value * 1.0001,
            value * (1 + 1e-6),
            value * 1.02,
        ]
    )
    return g.stored(g.typed(off))


def reduced(g: Builder, operator: str, x: Value, keep: int = 1) -> Value:
    """Reduce the last axis."""
    if g.version(operator) >= (13 if operator == "ReduceSum" else 18):
        return g.call(operator, x, integers(g, -1), keepdims=keep)
    return g.call(operator, x, axes=[-1], keepdims=keep)


@_idiom
def gelu(g: Builder, x: Value) -> Value:
    inner = (
        g.call("Div", x, near(g, math.sqrt(2)))
        if g.chance(0.5)
        else g.call("Mul", x, near(g, math.sqrt(0.5)))
    )
    raised = g.call("Add", g.call("Erf", inner), near(g, 1.0))
    match g.between(0, 2):
        case 0:
            return g.call("Mul", g.call("Mul", x, raised), near(g, 0.5))
        case 1:
            return g.call("Mul", g.call("Mul", x, near(g, 0.5)), raised)
    return g.call("Mul", x, g.call("Mul", raised, near(g, 0.5)))


@_idiom
def biased_gelu(g: Builder, x: Value) -> Value:
    x = g.ranked(x, 2)
    return gelu(g, g.call("Add", x, constant(g, g.numbers(x.shape[1]))))


@_idiom
def gelu_tanh(g: Builder, x: Value) -> Value:
    x = bounded(g, x) if g.chance(0.5) else x
    cube = (
        g.call("Pow", x, g.stored(g.typed(3.0))) if g.chance(0.5) else g.call("Mul", g.call("Mul", x, x), x)
    )
    inner = g.call("Add", x, g.call("Mul", cube, near(g, 0.044715)))
    gate = g.call("Add", g.call("Tanh", g.call("Mul", inner, near(g, math.sqrt(2 / math.pi)))), near(g, 1.0))
    return g.call("Mul", g.call("Mul", x, near(g, 0.5)), gate)


@_idiom
def swish(g: Builder, x: Value) -> Value:
    inner = g.call("Mul", x, near(g, g.pick([1.702, 1.5, 0.5]))) if g.chance(0.5) else x
    pair = [x, g.call("Sigmoid", inner)]
    return g.call("Mul", *pair[:: g.pick([1, -1])])


@_idiom
def mish(g: Builder, x: Value) -> Value:
    return g.call("Mul", x, g.call("Tanh", softplus(g, x)))


@_idiom
def softplus(g: Builder, x: Value) -> Value:
    if g.has("Softplus") and g.chance(0.4):
        return g.call("Softplus", x)
    return g.call(
        "Log", g.call("Add", g.call("Exp", scaled_down(g, x) if g.chance(0.5) else x), near(g, 1.0))
    )


@_idiom
def logistic(g: Builder, x: Value) -> Value:
    """Write ``1 / (1 + exp(-k (x - c)))``."""
    steep = g.call("Mul", x, g.stored(g.typed(-g.number(1.0, 10.0, 0.3))))
    moved = g.call("Add", steep, g.stored(g.typed(g.number(0.0, 2.0, -35.0))))
    with g.overflowing():
        below = g.call("Add", g.call("Exp", moved), near(g, 1.0))
    return g.call("Div", g.stored(g.typed(1.0)), below) if g.chance(0.6) else g.call("Reciprocal", below)


@_idiom
def tanh_from_sigmoid(g: Builder, x: Value) -> Value:
    doubled = g.call("Mul", g.call("Sigmoid", g.call("Mul", x, near(g, 2.0))), near(g, 2.0))
    return g.call("Sub", doubled, near(g, 1.0))


@_idiom
def tanh_from_exp(g: Builder, x: Value) -> Value:
    x = scaled_down(g, x)
    up, down = g.call("Exp", x), g.call("Exp", g.call("Neg", x))
    return g.call("Div", g.call("Sub", up, down), g.call("Add", up, down))


@_idiom
def softmax_from_parts(g: Builder, x: Value) -> Value:
    x = linear(g, x, g.between(2, 5))
    x = g.call("Sub", x, reduced(g, "ReduceMax", x)) if g.chance(0.5) else scaled_down(g, x)
    powers = g.call("Exp", x)
    return g.call("Div", powers, reduced(g, "ReduceSum", powers))


@_idiom
def layer_norm_from_parts(g: Builder, x: Value) -> Value:
    x = g.ranked(x if x.size > 1 else linear(g, x, 4), 2)
    deviation = g.call("Sub", x, reduced(g, "ReduceMean", x))
    square = (
        g.call("Pow", deviation, g.stored(g.typed(2.0)))
        if g.chance(0.6)
        else g.call("Mul", deviation, deviation)
    )
    epsilon = g.number(1e-5, 1e-3, 1e-6) if g.kind != "float16" else g.number(1e-3, 1e-2)
    spread = g.call("Sqrt", g.call("Add", reduced(g, "ReduceMean", square), g.stored(g.typed(epsilon))))
    result = g.call("Div", deviation, spread)
    size = x.shape[1]
    if g.chance(0.7):
        result = g.call("Mul", result, constant(g, g.numbers(size)))
    return g.call("Add", result, constant(g, g.numbers(size))) if g.chance(0.7) else result


@_idiom
def rms_norm_from_parts(g: Builder, x: Value) -> Value:
    x = g.ranked(x if x.size > 1 else linear(g, x, 4), 2)
    mean = reduced(g, "ReduceMean", g.call("Mul", x, x))
    raised = g.call("Add", mean, g.stored(g.typed(g.number(1e-3, 1e-2))))
    if g.chance(0.5):
        return g.call("Div", x, g.call("Sqrt", raised))
    return g.call("Mul", x, g.call("Reciprocal", g.call("Sqrt", raised)))


@_idiom
def unit_length(g: Builder, x: Value) -> Value:
    x = g.call("Add", g.ranked(x, 2), g.stored(g.typed(0.5)))
    return g.call("Div", x, g.call("Clip", reduced(g, "ReduceL2", x), g.stored(g.typed(1e-2))))


@_idiom
def hard_swish_from_clip(g: Builder, x: Value) -> Value:
    gate = g.call("Clip", g.call("Add", x, near(g, 3.0)), g.stored(g.typed(0.0)), near(g, 6.0))
    return g.call("Div", g.call("Mul", x, gate), near(g, 6.0))


@_idiom
def hard_sigmoid_gate(g: Builder, x: Value) -> Value:
    return g.call("Mul", x, g.call("HardSigmoid", x, alpha=g.number(1 / 6, 0.2), beta=0.5))


@_idiom
def clipped_rectifier(g: Builder, x: Value) -> Value:
    ends = [g.stored(g.typed(end)) for end in (g.number(0.0, -1.0), g.number(6.0, 1.0))]
    if g.chance(0.5):
        return g.call("Clip", g.call("Relu", x), *ends)
    return g.call("Min", g.call("Max", x, ends[0]), ends[1])


@_idiom
def normaliser(g: Builder, x: Value) -> Value:
    """Subtract means, divide by spreads of any size, and clip."""
    x = g.ranked(x, 2)
    size = x.shape[1]
    mean = g.typed(g.rng.normal(size=size) * g.pick([1.0, 30.0]))
    spread = g.typed(10.0 ** g.rng.uniform(-1.5, 2, size))
    centred = g.call("Sub", x, constant(g, mean))
    if g.chance(0.6):
        scaled = g.call("Div", centred, constant(g, spread))
    else:
        scaled = g.call("Mul", centred, constant(g, 1 / spread))
    return g.call(
        "Clip", scaled, g.stored(g.typed(-g.number(5.0, 10.0))), g.stored(g.typed(g.number(5.0, 10.0)))
    )


@_idiom
def norm_of_what_is_far_from_zero(g: Builder, x: Value) -> Value:
    """Normalise numbers whose mean is large beside their spread."""
    x = linear(g, x, g.between(2, 6))
    x = g.call("Add", x, g.stored(g.typed(g.number(3.0, 10.0, 100.0))))
    return (
        PIECES["LayerNormalization"](g, x) if g.opset >= 17 and g.chance(0.6) else layer_norm_from_parts(g, x)
    )


@_idiom
def wide_layers(g: Builder, x: Value) -> Value:
    """Two dense layers with more neurons than anything else has."""
    width = min(g.most, g.pick([16, 32, 140]))
    for _ in range(g.between(1, 2)):
        x = PIECES[g.pick(["Relu", "Relu", "Tanh", "LeakyRelu"])](g, linear(g, x, width))
    return linear(g, x, g.between(1, 4))


@_idiom
def stacked(g: Builder, x: Value) -> Value:
    """Put one idiom on another."""
    return g.pick(IDIOMS)(g, g.pick(IDIOMS)(g, x))


@_idiom
def dense_layer(g: Builder, x: Value) -> Value:
    """Write what runtimes fuse: a product, its bias, a batch normalisation, an activation."""
    x = linear(g, x)
    if g.chance(0.3):
        x = PIECES["BatchNormalization"](g, x)
    return PIECES[g.pick(["Relu", "Tanh", "LeakyRelu", "Sigmoid", "Elu", "Clip", "Softplus"])](g, x)


@_idiom
def convolved_layer(g: Builder, x: Value) -> Value:
    x = PIECES["Conv"](g, x)
    channels = [1] * (len(x.shape) - 2)
    for operator in ("Mul", "Add"):
        if g.chance(0.4):
            x = g.call(operator, x, g.stored(g.numbers(x.shape[1], *channels)))
    if g.chance(0.3):
        given = [g.stored(g.numbers(x.shape[1])) for _ in range(3)]
        x = g.call("BatchNormalization", x, *given, g.stored(g.typed(np.abs(g.numbers(x.shape[1])) + 0.1)))
    return PIECES[g.pick(["Relu", "Tanh", "LeakyRelu", "Sigmoid", "Clip", "HardSigmoid"])](g, x)


@_idiom
def quantised_layer(g: Builder, x: Value) -> Value:
    """Multiply by int8 weights that the graph dequantises."""
    check_quantised(g)
    x = g.ranked(x, 2)
    rows = g.between(1, 6)
    stored = g.stored(g.rng.integers(-127, 128, (x.shape[1], rows)).astype(np.int8))
    scale = np.asarray(g.rng.uniform(0.002, 0.02, g.pick([(), (rows,)])), dtype=np.float32)
    axes = {"axis": 1} if scale.ndim else {}
    zero = g.stored(np.zeros(scale.shape, dtype=np.int8)) if g.chance(0.5) else None
    weight = g.call("DequantizeLinear", stored, g.stored(scale), zero, **axes)
    product = g.call("MatMul", x, weight)
    return g.call("Add", product, constant(g, g.numbers(rows))) if g.chance(0.6) else product


@_idiom
def merged_scales(g: Builder, x: Value) -> Value:
    """Scale and shift several times, so that what cancels is merged."""
    for _ in range(g.between(2, 4)):
        operator = g.pick(["Mul", "Add", "Sub", "Div"])
        number = (
            g.number(0.1, 3.0, 1000.0, 1e-3, 1 / 3)
            if operator in ("Mul", "Div")
            else g.number(0.3, 1e3, -1e3)
        )
        x = g.call(operator, x, g.stored(g.typed(number)))
    return scaled_down(g, x)


@_idiom
def gated_unit(g: Builder, x: Value) -> Value:
    half = g.between(1, 4)
    both = linear(g, x, 2 * half)
    first, second = g.call("Split", both, integers(g, half, half), axis=1, count=2)
    return g.call("Mul", first, g.call("Sigmoid", second))


@_idiom
def attention(g: Builder, x: Value) -> Value:
    """Weigh three values by the softmax of products with two keys."""
    tokens, width = g.pick([(2, 2), (3, 2), (2, 3)])
    x = bounded(g, x)
    query, key, value = (g.reshaped(linear(g, x, tokens * width), 1, tokens, width) for _ in range(3))
    scores = g.call("MatMul", query, g.call("Transpose", key, perm=[0, 2, 1]))
    scores = g.call("Div", scores, near(g, math.sqrt(width)))
    return g.call("MatMul", g.call("Softmax", scores, axis=-1), value)


@_idiom
def residual(g: Builder, x: Value) -> Value:
    x = g.ranked(x, 2)
    inner = PIECES[g.pick(["Relu", "Tanh", "Gelu", "Sigmoid", "LeakyRelu"])](g, linear(g, x))
    return g.call("Add", x, linear(g, inner, x.shape[1]))


@_idiom
def cancelling(g: Builder, x: Value) -> Value:
    """Add a large number and take it away."""
    large = g.stored(g.typed(g.number(16.0, 1e3, 1e4)))
    return g.call("Sub", g.call("Add", x, large), large)


@_idiom
def dueling(g: Builder, x: Value) -> Value:
    advantages = linear(g, x, g.between(2, 4))
    centred = g.call("Sub", advantages, reduced(g, "ReduceMean", advantages))
    return g.call("Add", linear(g, x, 1), centred)
