"""Constants as exporters leave them: stored, computed by chains of nodes that are folded, quantised."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from tests.attack.building import KINDS, Array, Builder, Unfit, Value

Chain = Callable[[Builder, Array], Value]
CHAINS: list[tuple[tuple[str, ...], Chain]] = []
"""The operators that a chain folds, and the chain; what it makes is near the wanted array, not equal to it."""


def _folds(*operators: str) -> Callable[[Chain], Chain]:
    def register(chain: Chain) -> Chain:
        CHAINS.append((operators, chain))
        return chain

    return register


def constant(g: Builder, array: Any, *, chained: float = 0.25) -> Value:
    """Add a constant of the graph's type, sometimes by a chain of nodes."""
    wanted = g.typed(array)
    if g.chance(chained):
        before = len(g.nodes), len(g.initializers)
        _, chain = g.pick(CHAINS)
        try:
            value = chain(g, wanted)
        except Unfit:
            value = None
        if value is not None and value.shape == wanted.shape and value.array.dtype == wanted.dtype:
            return value
        del g.nodes[before[0] :], g.initializers[before[1] :]
    return g.stored(wanted)


def integers(g: Builder, *values: int) -> Value:
    """Add a vector of int64."""
    return g.stored(np.array(values, dtype=np.int64))


def _odd(g: Builder, array: Array) -> Array:
    return g.typed(1.0 + np.abs(g.rng.normal(size=array.shape)))


@_folds("Mul", "Div")
def _product(g: Builder, wanted: Array) -> Value:
    other = _odd(g, wanted)
    if g.chance(0.5):
        return g.call("Mul", g.stored(g.typed(wanted / other)), g.stored(other))
    return g.call("Div", g.stored(g.typed(wanted * other)), g.stored(other))


@_folds("Add", "Sub", "Sum", "Neg")
def _sum(g: Builder, wanted: Array) -> Value:
    other = g.typed(_odd(g, wanted) * g.pick([1.0, 100.0]))
    if g.chance(0.5):
        return g.call("Sub", g.stored(other), g.stored(g.typed(other - wanted)))
    return g.call(g.pick(["Add", "Sum"]), g.stored(g.typed(wanted + other)), g.call("Neg", g.stored(other)))


@_folds("Exp", "Log", "Sqrt", "Pow", "Reciprocal")
def _function(g: Builder, wanted: Array) -> Value:
    magnitude = g.typed(np.abs(wanted) + 1e-3)
    sign = g.stored(g.typed(np.sign(wanted)))
    match g.between(0, 3):
        case 0:
            value = g.call("Exp", g.stored(g.typed(np.log(magnitude))))
        case 1:
            value = g.call("Sqrt", g.stored(g.typed(magnitude.astype(np.float64) ** 2)))
        case 2:
            value = g.call("Reciprocal", g.stored(g.typed(1 / magnitude)))
        case _:
            value = g.call("Pow", g.stored(magnitude), g.stored(g.typed(g.number(0.5, 2.0, 0.7))))
    return g.call("Mul", value, sign)


@_folds("Sin", "Cos", "Tan", "Atan", "Asin", "Acos", "Sinh", "Cosh", "Asinh", "Acosh", "Atanh")
def _trigonometric(g: Builder, wanted: Array) -> Value:
    if g.kind != "float32":
        raise Unfit("onnxruntime has kernels for float32")
    operator = g.pick(
        ["Sin", "Cos", "Tan", "Atan", "Asin", "Acos", "Sinh", "Cosh", "Asinh", "Acosh", "Atanh"]
    )
    inside = np.tanh(wanted.astype(np.float64)) * 0.9
    argument = inside + 2.0 if operator == "Acosh" else inside
    return g.call(operator, g.stored(g.typed(argument)))


@_folds("Floor", "Ceil", "Round", "Mod")
def _rounded(g: Builder, wanted: Array) -> Value:
    operator = g.pick(["Floor", "Ceil", "Round", "Mod"])
    if operator == "Mod":
        return g.call("Mod", g.stored(wanted), g.stored(g.typed(1.5)), fmod=1)
    return g.call(operator, g.stored(wanted))


@_folds("Cast", "CastLike")
def _cast(g: Builder, wanted: Array) -> Value:
    through = g.pick(["float16", "float32", "float64", "int64"])
    first = g.stored(np.asarray(np.clip(wanted, -1e4, 1e4), dtype=through))
    if g.chance(0.3) and g.opset >= 15:
        return g.call("CastLike", first, g.stored(g.typed(1.0)))
    return g.call("Cast", first, to=KINDS[g.kind])


def check_quantised(g: Builder) -> None:
    """Raise Unfit where onnxruntime has no kernels of quantised weights."""
    if g.kind != "float32" or g.version("DequantizeLinear") > 25:
        raise Unfit("no quantised weights")


@_folds("QuantizeLinear", "DequantizeLinear")
def _quantised(g: Builder, wanted: Array) -> Value:
    check_quantised(g)
    kind = g.pick([np.int8, np.uint8])
    axis = wanted.ndim - 1
    by_channel = wanted.ndim == 2 and g.chance(0.5)
    largest = np.abs(wanted).max(axis=0) if by_channel else np.abs(wanted).max(initial=0.0)
    scale = np.asarray(np.maximum(largest, 1e-6) / 127, dtype=np.float32)
    zero = np.full(scale.shape, 128 if kind is np.uint8 else 0, dtype=kind)
    axes = {"axis": axis} if by_channel else {}
    if g.chance(0.5):
        stored = np.clip(
            np.round(wanted / scale) + zero.astype(int), *((0, 255) if kind is np.uint8 else (-128, 127))
        )
        return g.call(
            "DequantizeLinear", g.stored(stored.astype(kind)), g.stored(scale), g.stored(zero), **axes
        )
    step, offset = g.stored(scale), g.stored(zero)
    quantised = g.call("QuantizeLinear", g.stored(wanted), step, offset, **axes)
    return g.call("DequantizeLinear", quantised, step, offset, **axes)


@_folds("Transpose", "Concat", "Slice", "Unsqueeze", "Squeeze", "Reshape", "Tile", "Expand")
def _moved(g: Builder, wanted: Array) -> Value:
    if wanted.ndim < 1:
        return g.call("Squeeze", g.stored(wanted.reshape(1)), integers(g, 0))
    match g.between(0, 3):
        case 0:
            order = [int(k) for k in g.rng.permutation(wanted.ndim)]
            back = [order.index(k) for k in range(wanted.ndim)]
            return g.call("Transpose", g.stored(wanted.transpose(order)), perm=back)
        case 1 if wanted.shape[0] > 1:
            return g.call("Concat", g.stored(wanted[:1]), g.stored(wanted[1:]), axis=0)
        case 2:
            wide = np.concatenate([wanted, wanted])
            return g.call(
                "Slice", g.stored(wide), integers(g, 0), integers(g, wanted.shape[0]), integers(g, 0)
            )
        case _:
            return g.call("Reshape", g.stored(wanted.ravel()), integers(g, *wanted.shape))


@_folds("ConstantOfShape", "Shape", "Size", "Range", "EyeLike", "CumSum", "CumProd")
def _made(g: Builder, wanted: Array) -> Value:
    shape = g.call("Shape", g.stored(wanted))
    if wanted.ndim == 2 and wanted.shape[0] == wanted.shape[1] and g.chance(0.4):
        return g.call("EyeLike", g.stored(wanted))
    if wanted.ndim == 1 and g.chance(0.3):
        count = g.call("Cast", g.call("Size", g.stored(wanted)), to=KINDS[g.kind])
        if g.kind == "float16":
            raise Unfit("no Range of half")
        return g.call("Range", g.stored(g.typed(0.0)), count, g.stored(g.typed(1.0)))
    if wanted.ndim == 1 and g.kind != "float16" and g.chance(0.5):
        operator = "CumProd" if g.opset >= 26 and g.chance(0.5) else "CumSum"
        return g.call(operator, g.stored(g.typed(np.tanh(wanted))), g.stored(np.int64(0)))
    from onnx import numpy_helper

    fill = g.typed([wanted.ravel()[0]])
    return g.call("ConstantOfShape", shape, value=numpy_helper.from_array(fill))


@_folds("Softmax", "ReduceSum", "ReduceMean", "ReduceProd", "MatMul", "Hardmax")
def _long(g: Builder, wanted: Array) -> Value:
    if wanted.ndim < 1:
        raise Unfit("a scalar")
    match g.between(0, 3):
        case 0:
            return g.call(g.pick(["Softmax", "Hardmax"]), g.stored(wanted), axis=-1)
        case 1:
            parts = np.stack([wanted, g.numbers(*wanted.shape), g.numbers(*wanted.shape)])
            return g.call("ReduceSum", g.stored(parts), integers(g, 0), keepdims=0)
        case 2:
            parts = np.stack([wanted, _odd(g, wanted)])
            if g.opset >= 18:
                return g.call("ReduceProd", g.stored(parts), integers(g, 0), keepdims=0)
            return g.call("ReduceProd", g.stored(parts), axes=[0], keepdims=0)
        case _:
            size = wanted.shape[-1]
            return g.call("MatMul", g.stored(wanted), g.stored(g.numbers(size, size)))


@_folds("Where", "Equal", "Greater", "Less", "And", "Or", "Xor", "Not", "IsNaN", "IsInf")
def _chosen(g: Builder, wanted: Array) -> Value:
    return g.call("Where", condition(g, *wanted.shape), g.stored(wanted), g.stored(g.numbers(*wanted.shape)))


@_folds("Gather", "ArgMax", "ArgMin", "TopK", "NonZero", "OneHot")
def _gathered(g: Builder, wanted: Array) -> Value:
    table = np.stack([wanted, g.numbers(*wanted.shape)])
    scores = g.stored(g.typed([0.5, -1.0]))
    match g.between(0, 3):
        case 0:
            index = g.call(g.pick(["ArgMax", "ArgMin"]), scores, axis=0, keepdims=0)
        case 1:
            _, index = g.call("TopK", scores, integers(g, 1), count=2)
            index = g.call("Squeeze", index, integers(g, 0))
        case 2:
            found = g.call("NonZero", g.stored(g.typed([0.0, 2.0])))
            index = g.call("Squeeze", found, integers(g, 0, 1))
        case _:
            chosen = g.call(
                "OneHot", g.stored(np.int64(1)), integers(g, 2), g.stored(np.array([0, 1])), axis=0
            )
            index = g.call("ArgMax", chosen, axis=0, keepdims=0)
    return g.call("Gather", g.stored(table), index, axis=0)


@_folds("BitShift", "BitwiseAnd", "BitwiseOr", "BitwiseXor", "BitwiseNot")
def _bits(g: Builder, wanted: Array) -> Value:
    whole = np.asarray(np.clip(np.abs(np.nan_to_num(wanted)), 0, 200)).astype(np.uint8)
    operator = g.pick(["BitShift", "BitwiseAnd", "BitwiseOr", "BitwiseXor", "BitwiseNot"])
    if operator != "BitShift" and g.opset < 18:
        raise Unfit("no bitwise operators")
    match operator:
        case "BitShift":
            bits = g.call(operator, g.stored(whole), g.stored(np.uint8(1)), direction="RIGHT")
        case "BitwiseNot":
            bits = g.call(operator, g.stored(whole))
        case _:
            bits = g.call(operator, g.stored(whole), g.stored(np.uint8(11)))
    return g.call("Cast", bits, to=KINDS[g.kind])


def condition(g: Builder, *shape: int) -> Value:
    """Add a boolean constant, stored or computed."""
    stored = g.stored(g.rng.random(shape) < 0.5)
    scores = g.stored(g.numbers(*shape))
    match g.between(0, 6):
        case 0:
            return g.call(g.pick(["Greater", "Less"]), scores, g.stored(g.typed(0.0)))
        case 1:
            return g.call("Equal", g.stored(g.rng.integers(0, 2, shape)), g.stored(np.int64(1)))
        case 2:
            return g.call(g.pick(["And", "Or", "Xor"]), stored, g.stored(g.rng.random(shape) < 0.5))
        case 3:
            return g.call("Not", stored)
        case 4:
            return g.call(
                "Not", g.call(g.pick(["IsNaN", "IsInf"]) if g.kind == "float32" else "IsNaN", scores)
            )
    return stored
