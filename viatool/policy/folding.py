"""Evaluation of nodes that do not depend on the observation, once, in the element types of the model."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np
import onnx

from viatool.policy.assembly import Computed, Refusal
from viatool.policy.folded_rounding import cast_constant, with_roundings
from viatool.policy.graph import GraphNode
from viatool.policy.tensors import Array, Constant, convert, dtype_name

MAX_ELEMENTS = 2**24
"""Most elements of a folded tensor."""

# fmt: off
FOLDED = frozenset((
    "Acos", "Acosh", "And", "ArgMax", "ArgMin", "Asin", "Asinh", "Atan", "Atanh", "BitShift",
    "BitwiseAnd", "BitwiseNot", "BitwiseOr", "BitwiseXor", "CastLike", "Ceil", "Constant",
    "ConstantOfShape", "Cos", "Cosh", "CumProd", "CumSum", "DequantizeLinear", "Equal", "EyeLike",
    "Floor", "Hardmax", "IsInf", "IsNaN", "Mod",
    "NonZero", "Not", "OneHot", "QuantizeLinear", "Range", "ReduceProd", "Round", "Shape",
    "Sin", "Sinh", "Size", "Tan", "TopK", "Xor",
))
# fmt: on
"""Operators that are evaluated when they do not depend on the observation; those without a reader are refused else."""

_OF_MATRICES = frozenset(("Hardmax", "LogSoftmax", "Softmax"))
"""Before opset 13 they took a tensor as a matrix."""

_OLDEST_KNOWN = {"DequantizeLinear": 19}
"""Where the reference implementation begins with a version that means the same as those before it."""

Arrays = Sequence[Array | None]
Values = Sequence[Constant | Computed | None]
Maker = Callable[[GraphNode, Values, Mapping[str, Any]], Constant]


def _shape(node: GraphNode, inputs: Values, attributes: Mapping[str, Any]) -> Constant:
    value = inputs[0]
    assert value is not None
    start, end = attributes.get("start", 0), attributes.get("end")
    return Constant(np.asarray(value.shape[slice(start, end)], dtype=np.int64), "int64")


def _size(node: GraphNode, inputs: Values, attributes: Mapping[str, Any]) -> Constant:
    assert inputs[0] is not None
    return Constant(np.asarray(math.prod(inputs[0].shape), dtype=np.int64), "int64")


SHAPE_ONLY: dict[str, Maker] = {"Shape": _shape, "Size": _size}


def fold_shape(node: GraphNode, inputs: Sequence[object], attributes: Mapping[str, Any]) -> Constant | None:
    """Return the value of an operator that only asks for the shape of its input, None for any other."""
    maker = SHAPE_ONLY.get(node.operator)
    value = inputs[0] if inputs else None
    if maker is None or not isinstance(value, Computed):
        return None
    return maker(node, [value], attributes)


def fold(node: GraphNode, inputs: Sequence[Constant | None], attributes: Mapping[str, Any]) -> list[Constant]:
    """Evaluate a node whose inputs are all constant.

    Raises
    ------
    Refusal
        If the result would be too large, or is of a type that cannot be held.
    """
    special = _SPECIAL.get(node.operator)
    if special is not None:
        return [special(node, inputs, attributes)]
    if not any(value is not None for value in inputs):
        raise Refusal("has no inputs")
    results = evaluate(node, [None if value is None else _stored(value) for value in inputs], attributes)
    narrow = any(value is not None and value.dtype == "bfloat16" for value in inputs)
    held = [_held(result, narrow) for result in results]
    return with_roundings(node.operator, inputs, held, lambda arrays: evaluate(node, arrays, attributes))


def evaluate(node: GraphNode, arrays: Arrays, attributes: Mapping[str, Any]) -> list[Array]:
    """Run one node on arrays with the reference implementation of ONNX.

    Raises
    ------
    Refusal
        If the result would be too large.
    """
    from onnx.reference import ReferenceEvaluator

    _guard_size(node, arrays, attributes)
    if node.operator == "DequantizeLinear" and node.opset < 13 and _present(arrays, 2)[1].size != 1:
        raise Refusal(
            "has a scale for each channel, as only opset 13 or newer does", "export with opset_version 13"
        )
    if node.operator in _OF_MATRICES and node.opset < 13:
        return _evaluate_as_matrix(node, arrays[0], attributes.get("axis", 1))
    # fresh names: the file's own may be given twice or be empty
    inputs = [f"x{index}" if array is not None else "" for index, array in enumerate(arrays)]
    outputs = [f"y{index}" if name else "" for index, name in enumerate(node.outputs)]
    call = onnx.NodeProto()
    call.CopyFrom(node.proto)
    del call.input[:], call.output[:]
    call.input.extend(inputs)
    call.output.extend(outputs)
    opset = max(node.opset, _OLDEST_KNOWN.get(node.operator, 0))
    given = {name: array for name, array in zip(inputs, arrays, strict=True) if name and array is not None}
    anything = onnx.TypeProto()
    graph = onnx.helper.make_graph(
        [call],
        "folded",
        [onnx.helper.make_value_info(name, anything) for name in given],
        [onnx.helper.make_value_info(name, anything) for name in outputs if name],
    )
    model = onnx.helper.make_model(graph, opset_imports=[onnx.helper.make_opsetid("", opset)])
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        results = ReferenceEvaluator(model).run(None, given)
    return [np.asarray(result) for result in results]


def _evaluate_as_matrix(node: GraphNode, array: Array | None, axis: int) -> list[Array]:
    """Run a node that takes `axis` and all axes after it as one; the reference implementation does not."""
    if array is None or not -array.ndim <= axis <= array.ndim:
        raise Refusal(f"has no axis {axis}")
    rows = math.prod(array.shape[: axis if axis >= 0 else axis + array.ndim])
    matrix = array.reshape(rows, array.size // max(rows, 1))
    proto = onnx.helper.make_node(node.operator, ["x"], ["y"], axis=1)
    (result,) = evaluate(replace(node, opset=13, proto=proto), [matrix], {"axis": 1})
    return [result.reshape(array.shape)]


def _stored(constant: Constant) -> Array:
    """Return the numbers that a program with the element types of the model has."""
    return convert(constant.array, constant.dtype) if constant.roundings else constant.array


def _held(result: Array, narrow: bool) -> Constant:
    dtype = str(result.dtype)
    if dtype == "bfloat16":
        return Constant(result.astype(np.float32), "bfloat16")
    if narrow and dtype == "float32":
        return Constant(convert(result, "bfloat16"), "bfloat16")
    if result.dtype.kind not in "fiub" or result.dtype.itemsize > 8:
        raise Refusal(f"gives constants of type {dtype}", "export the policy with float32 weights")
    return Constant(result, dtype)


def _constant(node: GraphNode, inputs: Values, attributes: Mapping[str, Any]) -> Constant:
    if len(node.attributes) > 1:
        raise Refusal(f"has several values: {', '.join(sorted(node.attributes))}", "keep one of them")
    for name, dtype in (
        ("value_float", "float32"),
        ("value_floats", "float32"),
        ("value_int", "int64"),
        ("value_ints", "int64"),
    ):
        if name in attributes:
            return Constant(np.asarray(attributes[name], dtype=dtype), dtype)
    value = attributes.get("value")
    if not isinstance(value, Constant):
        raise Refusal(
            "is a constant that is not a dense tensor of numbers",
            "export the policy with dense float32 weights",
        )
    return value


def _constant_of_shape(node: GraphNode, inputs: Values, attributes: Mapping[str, Any]) -> Constant:
    assert isinstance(inputs[0], Constant)
    shape = tuple(int(size) for size in inputs[0].array.ravel())
    _check_size(math.prod(shape))
    value = attributes.get("value")
    if not isinstance(value, Constant):
        value = Constant(np.zeros(1, dtype=np.float32), "float32")
    return Constant(np.full(shape, value.array.ravel()[0]), value.dtype)


def _cast(node: GraphNode, inputs: Values, attributes: Mapping[str, Any]) -> Constant:
    assert isinstance(inputs[0], Constant)
    dtype = dtype_name(attributes["to"])
    if dtype is None:
        raise Refusal("casts to a type that is neither a number nor a boolean")
    return cast_constant(inputs[0], dtype)


def _identity(node: GraphNode, inputs: Values, attributes: Mapping[str, Any]) -> Constant:
    assert isinstance(inputs[0], Constant)
    return inputs[0]


_SPECIAL: dict[str, Maker] = {
    "Cast": _cast,
    "Constant": _constant,
    "ConstantOfShape": _constant_of_shape,
    "Identity": _identity,
    **SHAPE_ONLY,
}


def _check_size(count: float) -> None:
    if not 0 <= count <= MAX_ELEMENTS:
        raise Refusal(f"would make a tensor of {count:.3g} elements", "check the file: no policy needs that")


def _guard_size(node: GraphNode, arrays: Arrays, attributes: Mapping[str, Any]) -> None:
    """Refuse before evaluation what would allocate too much: most operators are bounded by their inputs."""
    bound = _OUTPUT_SIZES.get(node.operator)
    if bound is not None:
        _check_size(bound(arrays, attributes))
        return
    given = [array for array in arrays if array is not None]
    _check_size(sum(array.size for array in given))
    with suppress(ValueError):  # not elementwise: then the result is no larger than the inputs
        _check_size(math.prod(np.broadcast_shapes(*(array.shape for array in given))))


def _expanded(arrays: Arrays, attributes: Mapping[str, Any]) -> float:
    x, shape = _present(arrays, 2)
    return math.prod(np.broadcast_shapes(x.shape, tuple(int(size) for size in shape.ravel())))


def _tiled(arrays: Arrays, attributes: Mapping[str, Any]) -> float:
    x, repeats = _present(arrays, 2)
    return x.size * math.prod(int(count) for count in repeats.ravel())


def _gathered(arrays: Arrays, attributes: Mapping[str, Any]) -> float:
    x, indices = _present(arrays, 2)
    if indices.size and max(abs(int(indices.min())), abs(int(indices.max()))) > max(x.shape, default=0):
        raise Refusal(f"has indices outside the shape {list(x.shape)}", "export the policy again")
    return indices.size * x.size / max(1, min(x.shape, default=1))


def _range(arrays: Arrays, attributes: Mapping[str, Any]) -> float:
    start, limit, delta = (float(array.ravel()[0]) for array in _present(arrays, 3))
    return max(0.0, (limit - start) / delta) if delta else math.inf


def _padded(arrays: Arrays, attributes: Mapping[str, Any]) -> float:
    (x,) = _present(arrays, 1)
    pads = attributes.get("pads", attributes.get("paddings"))
    if pads is None:
        pads = [int(pad) for pad in _present(arrays, 2)[1].ravel()]
    most = max((abs(pad) for pad in pads), default=0)
    return float(math.prod(float(size + 2 * most) for size in x.shape))


def _matrix_product(arrays: Arrays, attributes: Mapping[str, Any]) -> float:
    left, right = _present(arrays, 2)
    inner = max(1, min(left.shape + right.shape, default=1))
    return float(left.size) * right.size / inner**2


def _one_hot(arrays: Arrays, attributes: Mapping[str, Any]) -> float:
    indices, depth = _present(arrays, 2)
    return indices.size * float(depth.ravel()[0])


def _present(arrays: Arrays, count: int) -> list[Array]:
    present = [array for array in arrays[:count] if array is not None]
    if len(present) < count:
        raise Refusal("lacks an input")
    return present


_OUTPUT_SIZES: dict[str, Callable[[Arrays, Mapping[str, Any]], float]] = {
    "Expand": _expanded,
    "Gather": _gathered,
    "GatherElements": _gathered,
    "GatherND": _gathered,
    "Gemm": _matrix_product,
    "MatMul": _matrix_product,
    "OneHot": _one_hot,
    "Pad": _padded,
    "Range": _range,
    "Tile": _tiled,
}
