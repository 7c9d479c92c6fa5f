"""One or more small models for every operator that is read, in every opset version that defines it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import onnx
from onnx import TensorProto, helper

from tests.policy.models import model_of, node, weights


@dataclass(frozen=True)
class Case:
    """Nodes from x to y."""

    nodes: list[onnx.NodeProto]
    initializers: dict[str, Any] = field(default_factory=dict)
    shape: tuple[int, ...] = (1, 4)
    name: str = ""
    least_opset: int = 6

    def model(self, opset: int) -> onnx.ModelProto:
        opset = max(opset, self.least_opset)
        return model_of(self.nodes, self.initializers, shape=self.shape, opset=opset)


Builder = Callable[[int], list[Case]]
CASES: dict[str, Builder] = {}


def case(*operators: str) -> Callable[[Callable[[str, int], list[Case]]], Callable[[str, int], list[Case]]]:
    def register(builder: Callable[[str, int], list[Case]]) -> Callable[[str, int], list[Case]]:
        for operator in operators:
            CASES[operator] = lambda version, operator=operator: builder(operator, version)  # type: ignore[misc]
        return builder

    return register


def ints(*values: int) -> Any:
    return np.array(values, dtype=np.int64)


def floats(*values: float) -> Any:
    return np.array(values, dtype=np.float32)


def positive(*shape: int) -> Any:
    return np.abs(weights(9, *shape)) + np.float32(0.5)


@case(
    "Abs", "Celu", "Elu", "Erf", "Exp", "HardSigmoid", "HardSwish", "Identity", "LeakyRelu", "LogSoftmax", "Mish",
    "Neg", "Relu", "Selu", "Sigmoid", "Sign", "Softmax", "Softplus", "Softsign", "Tanh", "ThresholdedRelu",
)  # fmt: skip
def unary(operator: str, version: int) -> list[Case]:
    return [Case([node(operator, ["x"], ["y"])])]


@case("Log", "Sqrt", "Reciprocal")
def of_positive(operator: str, version: int) -> list[Case]:
    return [Case([node("Exp", ["x"], ["e"]), node(operator, ["e"], ["y"])])]


@case("Add", "Sub", "Mul", "Div")
def arithmetic(operator: str, version: int) -> list[Case]:
    def call(a: str, b: str) -> list[onnx.NodeProto]:
        attributes = {"broadcast": 1} if version < 7 else {}
        return [node(operator, [a, b], ["y"], **attributes)]

    bent = node("Exp", ["x"], ["e"])
    cases = [
        Case(call("x", "c"), {"c": positive(4)}, name="by a vector"),
        Case(call("x", "c"), {"c": np.float32(0.4)}, name="by a number"),
        Case([bent, *call("x", "e")], name="of two computed values"),
        Case([bent, *call("e", "e")], name="of a value with itself"),
    ]
    if version < 7:
        axis = node(operator, ["x", "c"], ["y"], broadcast=1, axis=2)
        return [*cases, Case([axis], {"c": positive(2)}, shape=(1, 3, 2), name="along the last axis")]
    first = Case([bent, *call("c", "e")], {"c": weights(1, 1, 4)}, name="with the constant first")
    wider = Case(call("x", "c"), {"c": positive(3, 1)}, shape=(1, 1, 4), name="broadcast to a larger shape")
    return [*cases, first, wider]


@case("Max", "Min", "Sum", "Mean")
def variadic(operator: str, version: int) -> list[Case]:
    bent = node("Tanh", ["x"], ["t"])
    cases = [
        Case([bent, node(operator, ["x", "t"], ["y"])], name="of two computed values"),
        Case([node(operator, ["x", "c"], ["y"])], {"c": weights(1, 1, 4)}, name="with constants"),
        Case([node(operator, ["x"], ["y"])], name="of one value"),
    ]
    if version >= 8:
        cases.append(
            Case([bent, node(operator, ["x", "c", "t"], ["y"])], {"c": np.float32(0.1)}, name="of three")
        )
    return cases


@case("Pow")
def power(operator: str, version: int) -> list[Case]:
    attributes = {"broadcast": 1} if version < 7 else {}
    cases = [
        Case(
            [node("Pow", ["x", "c"], ["y"], **attributes)], {"c": np.float32(exponent)}, name=f"{exponent:g}"
        )
        for exponent in (2.0, 3.0, 1.0)
    ]
    for exponent in (0.5, -1.0, -0.5, -2.0):
        nodes = [node("Exp", ["x"], ["e"]), node("Pow", ["e", "c"], ["y"], **attributes)]
        cases.append(Case(nodes, {"c": np.float32(exponent)}, name=f"{exponent:g} of positive"))
    return cases


@case("Gelu")
def gelu(operator: str, version: int) -> list[Case]:
    return [Case([node("Gelu", ["x"], ["y"], approximate=form)], name=form) for form in ("none", "tanh")]


@case("Swish")
def swish(operator: str, version: int) -> list[Case]:
    return [Case([node("Swish", ["x"], ["y"], alpha=alpha)], name=f"{alpha:g}") for alpha in (1.0, 1.5)]


@case("Clip")
def clip(operator: str, version: int) -> list[Case]:
    if version == 6:
        return [
            Case([node("Clip", ["x"], ["y"], min=-0.5, max=0.25)]),
            Case([node("Clip", ["x"], ["y"], min=0.0)]),
        ]
    bounds = {"low": np.float32(-0.5), "high": np.float32(0.25)}
    return [
        Case([node("Clip", ["x", "low", "high"], ["y"])], bounds, name="both"),
        Case([node("Clip", ["x", "", "high"], ["y"])], bounds, name="upper"),
        Case([node("Clip", ["x"], ["y"])], name="neither"),
    ]


@case("PRelu")
def prelu(operator: str, version: int) -> list[Case]:
    cases = [
        Case([node("PRelu", ["x", "s"], ["y"])], {"s": floats(0.25, 0.1, -0.5, 1e-12)}, name="by element"),
        Case([node("PRelu", ["x", "s"], ["y"])], {"s": floats(0.25)}, name="one slope"),
    ]
    if version >= 7:
        cases.append(Case([node("PRelu", ["x", "s"], ["y"])], {"s": weights(2, 3, 1)}, shape=(1, 3, 2)))
    return cases


@case("MatMul")
def matmul(operator: str, version: int) -> list[Case]:
    call = [node("MatMul", ["x", "w"], ["y"])]
    left = [node("MatMul", ["w", "x"], ["y"])]
    bilinear = [
        node("Tanh", ["x"], ["t"]),
        node("Transpose", ["t"], ["u"]),
        node("MatMul", ["x", "u"], ["y"]),
    ]
    return [
        Case(call, {"w": weights(1, 4, 3)}, name="weights right"),
        Case(left, {"w": weights(1, 3, 4)}, shape=(4, 1), name="weights left"),
        Case(left, {"w": weights(1, 3, 4)}, shape=(4,), name="a vector"),
        Case(call, {"w": weights(1, 4)}, name="by a vector"),
        Case(call, {"w": weights(1, 2, 3, 4)}, shape=(1, 1, 3), name="a batch of weights"),
        Case(left, {"w": weights(1, 2, 2, 3)}, shape=(3, 2), name="a batch of weights left"),
        Case(bilinear, shape=(2, 3), name="of two computed matrices"),
    ]


@case("Gemm")
def gemm(operator: str, version: int) -> list[Case]:
    attributes = {"broadcast": 1} if version < 7 else {}
    scaled = node("Gemm", ["x", "w", "c"], ["y"], alpha=0.5, beta=-1.5, **attributes)
    computed = node("Gemm", ["t", "u", "x"], ["y"], transB=1, **attributes)
    cases = [
        Case(
            [node("Gemm", ["x", "w", "c"], ["y"], transB=1, **attributes)],
            {"w": weights(1, 3, 4), "c": weights(2, 3)},
        ),
        Case([scaled], {"w": weights(1, 4, 3), "c": weights(2, 1, 3)}, name="alpha and beta"),
        Case(
            [node("Gemm", ["x", "w", "c"], ["y"], transA=1, **attributes)],
            {"w": weights(1, 4, 3), "c": weights(2, 1)},
            shape=(4, 1),
            name="x transposed",
        ),
        Case(
            [node("Gemm", ["w", "x", "c"], ["y"], transB=1, **attributes)],
            {"w": weights(1, 3, 4), "c": weights(2, 3, 1)},
            name="weights left",
        ),
        Case(
            [node("Gemm", ["w", "v", "x"], ["y"], **attributes)],
            {"w": weights(1, 1, 2), "v": weights(2, 2, 4)},
            name="x is the addend",
        ),
    ]
    bilinear = [node("Tanh", ["x"], ["t"]), node("Sigmoid", ["x"], ["u"]), computed]
    cases.append(Case(bilinear, shape=(2, 2), name="of two computed matrices"))
    if version >= 11:
        cases.append(Case([node("Gemm", ["x", "w"], ["y"])], {"w": weights(1, 4, 3)}, name="without addend"))
    return cases


@case("Cast")
def cast(operator: str, version: int) -> list[Case]:
    wide = [
        node("Cast", ["x"], ["d"], to=onnx.TensorProto.DOUBLE),
        node("Cast", ["d"], ["y"], to=onnx.TensorProto.FLOAT),
    ]
    narrow = [
        node("Cast", ["x"], ["d"], to=onnx.TensorProto.FLOAT16),
        node("Cast", ["d"], ["y"], to=onnx.TensorProto.FLOAT),
    ]
    return [Case(wide, name="to float64"), Case(narrow, name="to float16")]


@case("Concat")
def concat(operator: str, version: int) -> list[Case]:
    nodes = [node("Tanh", ["x"], ["t"]), node("Concat", ["t", "c", "x"], ["y"], axis=1)]
    return [Case(nodes, {"c": weights(1, 1, 2)})]


@case("Compress")
def compress(operator: str, version: int) -> list[Case]:
    nodes = [node("Compress", ["x", "c"], ["y"], axis=1)]
    return [Case(nodes, {"c": np.array([True, False, True, True])})]


@case("DepthToSpace", "SpaceToDepth")
def depth(operator: str, version: int) -> list[Case]:
    shape = (1, 4, 1, 2) if operator == "DepthToSpace" else (1, 1, 2, 4)
    return [Case([node(operator, ["x"], ["y"], blocksize=2)], shape=shape)]


@case("Expand")
def expand(operator: str, version: int) -> list[Case]:
    return [Case([node("Expand", ["x", "s"], ["y"])], {"s": ints(2, 3, 4)})]


@case("Flatten")
def flatten(operator: str, version: int) -> list[Case]:
    return [Case([node("Flatten", ["x"], ["y"], axis=axis)], shape=(1, 2, 3)) for axis in (0, 1, 2)]


@case("Gather")
def gather(operator: str, version: int) -> list[Case]:
    return [
        Case([node("Gather", ["x", "i"], ["y"], axis=1)], {"i": ints(2, 0, 2)}),
        Case([node("Gather", ["x", "i"], ["y"], axis=1)], {"i": np.int64(3)}, name="one entry"),
    ]


@case("GatherElements")
def gather_elements(operator: str, version: int) -> list[Case]:
    return [Case([node(operator, ["x", "i"], ["y"], axis=1)], {"i": ints(3, 0).reshape(1, 2)})]


@case("GatherND")
def gather_nd(operator: str, version: int) -> list[Case]:
    return [Case([node(operator, ["x", "i"], ["y"])], {"i": ints(0, 3, 0, 1).reshape(2, 2)})]


@case("Pad")
def pad(operator: str, version: int) -> list[Case]:
    if version == 2:
        return [
            Case([node("Pad", ["x"], ["y"], pads=[0, 1, 0, 2], value=fill)], name=f"with {fill}")
            for fill in (0.5, 2.0)
        ]
    cases = [Case([node("Pad", ["x", "p", "v"], ["y"])], {"p": ints(0, 1, 0, 2), "v": np.float32(0.5)})]
    for mode in ("reflect", "edge"):
        cases.append(Case([node("Pad", ["x", "p"], ["y"], mode=mode)], {"p": ints(0, 1, 0, 2)}, name=mode))
    return cases


@case("Reshape")
def reshape(operator: str, version: int) -> list[Case]:
    return [
        Case([node("Reshape", ["x", "s"], ["y"])], {"s": ints(2, -1)}),
        Case([node("Reshape", ["x", "s"], ["y"])], {"s": ints(0, 2, 2)}, name="keeping an axis"),
    ]


@case("ReverseSequence")
def reverse(operator: str, version: int) -> list[Case]:
    return [Case([node(operator, ["x", "n"], ["y"], batch_axis=0, time_axis=1)], {"n": ints(3)})]


@case("Slice")
def slicing(operator: str, version: int) -> list[Case]:
    if version == 1:
        return [Case([node("Slice", ["x"], ["y"], axes=[1], starts=[1], ends=[3])])]
    bounds = {"s": ints(3), "e": ints(-5), "a": ints(1), "t": ints(-2)}
    return [
        Case([node("Slice", ["x", "s", "e", "a", "t"], ["y"])], bounds, name="backwards"),
        Case([node("Slice", ["x", "s", "e", "a"], ["y"])], {"s": ints(1), "e": ints(2**62), "a": ints(1)}),
    ]


@case("Split")
def split(operator: str, version: int) -> list[Case]:
    rest = [node("Tanh", ["b"], ["t"]), node("Concat", ["t", "a"], ["y"], axis=1)]
    if version < 13:
        return [Case([node("Split", ["x"], ["a", "b"], axis=1, split=[1, 3]), *rest])]
    equal = {"num_outputs": 2} if version >= 18 else {}
    return [
        Case([node("Split", ["x", "s"], ["a", "b"], axis=1), *rest], {"s": ints(1, 3)}),
        Case([node("Split", ["x"], ["a", "b"], axis=1, **equal), *rest], name="equal parts"),
    ]


@case("Squeeze", "Unsqueeze")
def squeeze(operator: str, version: int) -> list[Case]:
    if version < 13:
        return [Case([node(operator, ["x"], ["y"], axes=[0])])]
    return [Case([node(operator, ["x", "a"], ["y"])], {"a": ints(0)})]


@case("Tile")
def tile(operator: str, version: int) -> list[Case]:
    return [Case([node("Tile", ["x", "r"], ["y"])], {"r": ints(1, 2)})]


@case("Transpose")
def transpose(operator: str, version: int) -> list[Case]:
    return [
        Case([node("Transpose", ["x"], ["y"])], shape=(1, 2, 3)),
        Case([node("Transpose", ["x"], ["y"], perm=[0, 2, 1])], shape=(1, 2, 3)),
    ]


@case("Trilu")
def trilu(operator: str, version: int) -> list[Case]:
    return [
        Case([node("Trilu", ["x", "k"], ["y"], upper=upper)], {"k": np.int64(0)}, shape=(3, 3))
        for upper in (0, 1)
    ]


@case("Dropout")
def dropout(operator: str, version: int) -> list[Case]:
    return [Case([node("Dropout", ["x"], ["y"], **({"is_test": 1} if version == 6 else {}))])]


@case("Where")
def where(operator: str, version: int) -> list[Case]:
    nodes = [node("Tanh", ["x"], ["t"]), node("Where", ["c", "x", "t"], ["y"])]
    return [Case(nodes, {"c": np.array([[True, False, True, False]])})]


@case("Greater", "GreaterOrEqual", "Less", "LessOrEqual")
def comparison(operator: str, version: int) -> list[Case]:
    above = operator.startswith("Greater")
    if version < 9:  # without Where nothing can be made of a comparison of computed values
        nodes = [
            node(operator, ["a", "z"], ["c"]),
            node("Cast", ["c"], ["f"], to=1),
            node("Add", ["x", "f"], ["y"]),
        ]
        return [Case(nodes, {"a": np.float32(0.2), "z": np.float32(0.0)}, name="of constants")]
    slow = node("Mul", ["x", "a"], ["s"])
    branches = ["x", "s"] if above else ["s", "x"]
    constants = {"a": np.float32(0.2), "z": np.float32(0.0)}
    forward = [slow, node(operator, ["x", "z"], ["c"]), node("Where", ["c", *branches], ["y"])]
    backward = [slow, node(operator, ["z", "x"], ["c"]), node("Where", ["c", *branches[::-1]], ["y"])]
    steep = {**constants, "a": floats(0.25, 0.1, -0.5, 1e-12)}
    return [
        Case(forward, constants, name="x first"),
        Case(backward, constants, name="bound first"),
        Case(forward, steep, name="a slope for each element"),
    ]


@case("Or")
def either(operator: str, version: int) -> list[Case]:
    def shrunk(name: str) -> list[onnx.NodeProto]:
        return [
            node("Greater", [name, "b"], ["above"]),
            node("Less", [name, "a"], ["below"]),
            node("Or", ["above", "below"], ["c"]),
            node("Where", ["c", name, "z"], ["y"]),
        ]

    bounds = {"a": np.float32(-0.5), "b": np.float32(0.5), "z": np.float32(0.0)}
    summed = [node("Tanh", ["x"], ["t"]), node("Add", ["x", "t"], ["s"]), *shrunk("s")]
    return [
        Case(shrunk("x"), bounds, name="hard shrinkage", least_opset=9),
        Case(summed, bounds, name="hard shrinkage of a sum", least_opset=9),
    ]


@case(
    "ReduceSum", "ReduceMean", "ReduceSumSquare", "ReduceL1", "ReduceL2", "ReduceMax", "ReduceMin",
    "ReduceLogSumExp",
)  # fmt: skip
def reduction(operator: str, version: int) -> list[Case]:
    by_input = 13 if operator == "ReduceSum" else 18
    shape = (2, 3, 2)

    def call(*axes: int, **attributes: int) -> Case:
        if version < by_input:
            return Case([node(operator, ["x"], ["y"], axes=list(axes), **attributes)], shape=shape)
        return Case([node(operator, ["x", "a"], ["y"], **attributes)], {"a": ints(*axes)}, shape=shape)

    everything = Case([node(operator, ["x"], ["y"])], shape=shape, name="all axes")
    return [call(1), call(0, 2, keepdims=0), call(-1), everything]


@case("BatchNormalization")
def batch_normalization(operator: str, version: int) -> list[Case]:
    names = ["x", "s", "b", "m", "v"]
    attributes = {"is_test": 1} if version == 6 else {}

    def statistics(channels: int) -> dict[str, Any]:
        return {
            "s": weights(1, channels),
            "b": weights(2, channels),
            "m": weights(3, channels),
            "v": positive(channels),
        }

    call = [node(operator, names, ["y"], epsilon=1e-3, **attributes)]
    return [Case(call, statistics(4)), Case(call, statistics(3), shape=(1, 3, 2), name="of images")]


@case("LayerNormalization", "RMSNormalization")
def layer_normalization(operator: str, version: int) -> list[Case]:
    names = ["x", "s", "b"] if operator == "LayerNormalization" else ["x", "s"]
    full = {"s": weights(1, 4), "b": weights(2, 4)}
    plane = Case([node(operator, ["x", "s"], ["y"], axis=1)], {"s": weights(1, 2, 2)}, shape=(1, 2, 2))
    return [Case([node(operator, names, ["y"])], {key: full[key] for key in names[1:]}), plane]


@case("InstanceNormalization")
def instance_normalization(operator: str, version: int) -> list[Case]:
    return [
        Case(
            [node(operator, ["x", "s", "b"], ["y"])],
            {"s": weights(1, 2), "b": weights(2, 2)},
            shape=(1, 2, 3),
        )
    ]


@case("GroupNormalization")
def group_normalization(operator: str, version: int) -> list[Case]:
    call = node(operator, ["x", "s", "b"], ["y"], num_groups=2)
    return [Case([call], {"s": weights(1, 4), "b": weights(2, 4)}, shape=(1, 4, 2))]


@case("Conv")
def convolution(operator: str, version: int) -> list[Case]:
    plain = {"w": weights(1, 3, 2, 3), "b": weights(2, 3)}
    return [
        Case([node("Conv", ["x", "w", "b"], ["y"])], plain, shape=(1, 2, 6), name="1d"),
        Case(
            [node("Conv", ["x", "w"], ["y"], pads=[2, 1], strides=[2], dilations=[2])], plain, shape=(1, 2, 6)
        ),
        Case(
            [node("Conv", ["x", "w"], ["y"], auto_pad="SAME_UPPER", strides=[2])],
            plain,
            shape=(1, 2, 6),
            name="same",
        ),
        Case([node("Conv", ["x", "w"], ["y"], auto_pad="SAME_LOWER", strides=[2])], plain, shape=(1, 2, 6)),
        Case([node("Conv", ["x", "w"], ["y"], auto_pad="VALID")], plain, shape=(1, 2, 6)),
        Case(
            [node("Conv", ["x", "w"], ["y"], group=2, pads=[0, 1, 1, 0])],
            {"w": weights(1, 4, 1, 2, 3)},
            shape=(1, 2, 4, 3),
            name="2d in groups",
        ),
        Case(
            [node("Conv", ["x", "w"], ["y"])], {"w": weights(1, 3, 4, 1, 1)}, shape=(1, 4, 1, 1), name="1x1"
        ),
    ]


@case("AveragePool")
def average_pool(operator: str, version: int) -> list[Case]:
    call = {"kernel_shape": [3], "strides": [2], "pads": [1, 1]}
    return [
        Case([node(operator, ["x"], ["y"], **call)], shape=(1, 2, 6)),
        Case([node(operator, ["x"], ["y"], count_include_pad=1, **call)], shape=(1, 2, 6)),
        Case([node(operator, ["x"], ["y"], kernel_shape=[2, 2])], shape=(1, 1, 3, 3), name="2d"),
    ]


@case("MaxPool")
def max_pool(operator: str, version: int) -> list[Case]:
    return [
        Case([node(operator, ["x"], ["y"], kernel_shape=[3], strides=[2], pads=[1, 1])], shape=(1, 2, 6)),
        Case([node(operator, ["x"], ["y"], kernel_shape=[2, 2])], shape=(1, 1, 3, 3), name="2d"),
    ]


@case("GlobalAveragePool", "GlobalMaxPool")
def global_pool(operator: str, version: int) -> list[Case]:
    return [Case([node(operator, ["x"], ["y"])], shape=(1, 2, 3, 2))]


@case("GRU", "LSTM", "RNN")
def recurrent(operator: str, version: int) -> list[Case]:
    gates, features, hidden = {"RNN": 1, "GRU": 3, "LSTM": 4}[operator], 2, 3

    def numbers(directions: int, biased: bool = True) -> dict[str, Any]:
        found = {
            "w": weights(1, directions, gates * hidden, features, scale=0.7),
            "r": weights(2, directions, gates * hidden, hidden, scale=0.7),
            "zeros": np.zeros((directions, 1, hidden), np.float32),
            "h": weights(4, directions, 1, hidden),
            "c": weights(5, directions, 1, hidden),
            "p": weights(6, directions, 3 * hidden),
            "length": np.array([4], np.int32),
        }
        return found | ({"b": weights(3, directions, 2 * gates * hidden)} if biased else {})

    def call(*inputs: str, outputs: tuple[str, ...] = ("", "y"), **attributes: Any) -> list[onnx.NodeProto]:
        return [node(operator, ["x", "w", "r", *inputs], list(outputs), hidden_size=hidden, **attributes)]

    shape = (4, 1, features)
    cell = ["c"] if operator == "LSTM" else []
    bends = {"RNN": ["Relu"], "GRU": ["Sigmoid", "Relu"], "LSTM": ["Sigmoid", "Relu", "Tanh"]}[operator]
    cases = [
        Case(call("b"), numbers(1), shape, "the last state", 7),
        Case(call(), numbers(1, biased=False), shape, "without a bias", 7),
        Case(call("b", outputs=("y", "last")), numbers(1), shape, "every state", 7),
        Case(call("b", "length", "h", *cell), numbers(1), shape, "from a constant state", 7),
        Case(call("b", direction="reverse"), numbers(1), shape, "backwards", 7),
        Case(call("b", direction="bidirectional", outputs=("y",)), numbers(2), shape, "both ways", 7),
        Case(call("b", activations=bends), numbers(1), shape, "other activations", 7),
    ]
    if operator == "GRU":
        cases += [
            Case(call("b", linear_before_reset=1), numbers(1), shape, "reset behind the weights", 7),
            Case(
                call("b", "", "h", linear_before_reset=1), numbers(1), shape, "reset behind, from a state", 7
            ),
        ]
    if operator == "LSTM":
        cases += [
            Case(call("b", "", "zeros", "zeros", "p"), numbers(1), shape, "with peepholes", 7),
            Case(call("b", input_forget=1), numbers(1), shape, "with coupled gates", 7),
            Case(call("b", outputs=("", "", "y")), numbers(1), shape, "the cell", 7),
        ]
    return cases


def told(name: str, kind: int = TensorProto.FLOAT, shape: list[int] | None = None) -> onnx.ValueInfoProto:
    return helper.make_tensor_value_info(name, kind, shape)


def counting(*nodes: onnx.NodeProto, outputs: tuple[str, ...]) -> onnx.GraphProto:
    """The body of a loop over h, which keeps on."""
    inputs = [told("i", TensorProto.INT64, []), told("go", TensorProto.BOOL, []), told("h")]
    kept = [node("Identity", ["go"], ["on"]), *nodes]
    return helper.make_graph(
        kept, "body", inputs, [told("on", TensorProto.BOOL), *(told(name) for name in outputs)]
    )


@case("Loop")
def loop(operator: str, version: int) -> list[Case]:
    turn = [node("MatMul", ["h", "w"], ["m"]), node("Add", ["m", "x"], ["a"]), node("Tanh", ["a"], ["h2"])]
    numbers = {"three": np.array(3), "true": np.array(True), "w": weights(1, 4, 4, scale=0.5)}
    last = node(operator, ["three", "true", "x"], ["y"], body=counting(*turn, outputs=("h2",)))
    scaled = [*turn, node("Cast", ["i"], ["f"], to=1), node("Mul", ["h2", "f"], ["s"])]
    every = node(operator, ["three", "true", "x"], ["", "y"], body=counting(*scaled, outputs=("h2", "s")))
    alone = node(operator, ["three", "", "x"], ["y"], body=last.attribute[0].g)
    return [
        Case([last], numbers, name="the last state", least_opset=7),
        Case([every], numbers, name="every round", least_opset=7),
        Case([alone], numbers, name="a count alone", least_opset=7),
    ]


@case("Scan")
def scan(operator: str, version: int) -> list[Case]:
    turn = [
        node("MatMul", ["e", "w"], ["p"]),
        node("MatMul", ["h", "r"], ["q"]),
        node("Add", ["p", "q"], ["a"]),
    ]
    turn += [node("Tanh", ["a"], ["h2"]), node("Add", ["h2", "e"], ["o"])]
    body = helper.make_graph(turn, "cell", [told("h"), told("e")], [told("h2"), told("o")])
    numbers = {"h0": weights(3, 1, 2), "w": weights(1, 2, 2), "r": weights(2, 2, 2)}

    def call(*outputs: str, **attributes: Any) -> list[onnx.NodeProto]:
        return [node(operator, ["h0", "x"], list(outputs), body=body, num_scan_inputs=1, **attributes)]

    back = {"scan_input_directions": [1], "scan_output_directions": [1]}
    return [
        Case(call("y", ""), numbers, (3, 1, 2), "the last state"),
        Case(call("", "y"), numbers, (3, 1, 2), "every element"),
        Case(call("", "y", **back), numbers, (3, 1, 2), "backwards"),
        Case(
            call("", "y", scan_input_axes=[1], scan_output_axes=[1]), numbers, (1, 3, 2), "along another axis"
        ),
    ]


@case("If")
def branch(operator: str, version: int) -> list[Case]:
    graphs = {
        f"{which}_branch": helper.make_graph([node(bend, ["x"], [which])], which, [], [told(which)])
        for which, bend in (("then", "Tanh"), ("else", "Relu"))
    }
    call = node(operator, ["c"], ["y"], **graphs)
    return [Case([call], {"c": np.array(taken)}, name=str(taken), least_opset=7) for taken in (True, False)]
