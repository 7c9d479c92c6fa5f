"""Programs that run a network as a robot would: sums in any order, fused or not, and onnxruntime itself."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from viatool.policy.network import (
    Activation,
    Affine,
    Cast,
    Input,
    Maximum,
    Minimum,
    Network,
    Precision,
    Product,
)

Floats = NDArray[np.float64]

EXACT_ACTIVATIONS = frozenset(
    {"Guard", "Known", "Relu", "ThresholdedRelu", "Abs", "Clip", "HardShrink", "Sign", "Threshold"}
)
"""Activations that a runtime computes without rounding."""


def number_type(precision: Precision) -> Any:
    """Return the numpy type of a precision."""
    if precision == "bfloat16":
        import ml_dtypes  # comes with onnx

        return ml_dtypes.bfloat16
    return np.dtype(precision).type


def run_in_any_order(
    network: Network,
    points: Floats,
    rng: np.random.Generator,
    *,
    fused: bool = False,
    sloppiness: int = 0,
) -> Floats:
    """Run a network in the precision of its nodes, every sum in a random order.

    Parameters
    ----------
    network : Network
        n inputs, A actions.
    points : ndarray
        ``(B, n)``; rounded to the precision of the input first.
    rng : Generator
        Draws the orders.
    fused : bool
        Whether products are added with one rounding (fused multiply-add).
    sloppiness : int
        Activations are moved by up to this many steps from the rounded value.

    Returns
    -------
    ndarray
        ``(B, A)`` float64.
    """
    values: list[NDArray[Any]] = []
    for node in network.nodes:
        kind = number_type(node.precision)
        with np.errstate(under="ignore"):
            match node:
                case Input():
                    values.append(points.astype(kind))
                case Affine():
                    values.append(_summed(node, values, points.shape[0], rng, fused, kind))
                case Activation():
                    values.append(_sloppy(node, values[node.source], rng, sloppiness, kind))
                case Product():
                    values.append((values[node.left] * values[node.right]).astype(kind))
                case Maximum():
                    values.append(np.maximum(values[node.left], values[node.right]))
                case Minimum():
                    values.append(np.minimum(values[node.left], values[node.right]))
                case Cast():
                    values.append(values[node.source].astype(kind))
    return values[-1].astype(np.float64)


def _summed(
    node: Affine, values: list[NDArray[Any]], batch: int, rng: np.random.Generator, fused: bool, kind: Any
) -> NDArray[Any]:
    """Add the terms of each row in its own random order, in a row or pairwise as a random tree."""
    weight = np.concatenate([np.zeros((node.size, 0)), *node.weights], axis=1).astype(kind)
    inputs = np.concatenate([np.zeros((batch, 0), kind), *(values[k] for k in node.sources)], axis=1)
    order = rng.permuted(np.tile(np.arange(weight.shape[1]), (node.size, 1)), axis=1)  # (N, K)
    factors, terms = np.take_along_axis(weight, order, axis=1), inputs[:, order]  # (N, K), (B, N, K)
    total: NDArray[Any] = np.broadcast_to(node.bias.astype(kind), (batch, node.size))
    if fused:
        for k in range(weight.shape[1]):
            product = terms[:, :, k].astype(np.longdouble) * factors[:, k].astype(np.longdouble)
            total = (product + total.astype(np.longdouble)).astype(kind)
        return total
    parts = [total, *(factors[:, k] * terms[:, :, k] for k in range(weight.shape[1]))]
    as_tree = rng.random() < 0.5
    while len(parts) > 1:
        left = int(rng.integers(len(parts) - 1)) if as_tree else 0
        parts[left : left + 2] = [parts[left] + parts[left + 1]]
    return parts[0]


def _sloppy(
    node: Activation, x: NDArray[Any], rng: np.random.Generator, sloppiness: int, kind: Any
) -> NDArray[Any]:
    result = np.asarray(node.function(x.astype(np.float64)), dtype=kind)
    if node.function.name in EXACT_ACTIVATIONS or not sloppiness:
        return result
    steps = rng.integers(-sloppiness, sloppiness + 1, result.shape)
    step = np.nextafter(result, kind(np.inf)) - result
    return (result + (steps.astype(kind) * step)).astype(kind)


# --- onnxruntime -----------------------------------------------------------------------------------------


def onnx_model(network: Network) -> bytes:
    """Write a float32 network as an ONNX model of standard operators (opset 20), dynamic in the batch."""
    return _Writer(network).model()


def run_onnx(network: Network, points: Floats) -> Floats:
    """Run a float32 network in onnxruntime on one thread: points (B, n) to actions (B, A)."""
    session = onnx_session(onnx_model(network))
    (actions,) = session.run(None, {"v0": points.astype(np.float32)})
    return np.asarray(actions, dtype=np.float64)


def onnx_session(model: bytes) -> Any:
    """Return a single-threaded session."""
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 3
    return onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])


class _Writer:
    def __init__(self, network: Network) -> None:
        self.network = network
        self.nodes: list[Any] = []
        self.constants: list[Any] = []

    def model(self) -> bytes:
        from onnx import TensorProto, helper

        for index, node in enumerate(self.network.nodes[1:], start=1):
            self.write(node, f"v{index}")
        self.emit("Identity", [f"v{len(self.network.nodes) - 1}"], "action")
        graph = helper.make_graph(
            self.nodes,
            "network",
            [helper.make_tensor_value_info("v0", TensorProto.FLOAT, ["B", self.network.input_size])],
            [helper.make_tensor_value_info("action", TensorProto.FLOAT, ["B", self.network.output_size])],
            self.constants,
        )
        opsets = [helper.make_opsetid("", 20)]
        return bytes(helper.make_model(graph, opset_imports=opsets, ir_version=9).SerializeToString())

    def emit(self, operator: str, inputs: list[str], output: str = "", **attributes: Any) -> str:
        from onnx import helper

        output = output or f"t{len(self.nodes)}"
        self.nodes.append(helper.make_node(operator, inputs, [output], **attributes))
        return output

    def constant(self, value: Any) -> str:
        from onnx import numpy_helper

        name = f"c{len(self.constants)}"
        self.constants.append(numpy_helper.from_array(np.asarray(value, dtype=np.float32), name))
        return name

    def write(self, node: Any, name: str) -> None:
        match node:
            case Affine():
                self.write_affine(node, name)
            case Activation():
                self.write_activation(node, f"v{node.source}", name)
            case Product():
                self.emit("Mul", [f"v{node.left}", f"v{node.right}"], name)
            case Maximum():
                self.emit("Max", [f"v{node.left}", f"v{node.right}"], name)
            case Minimum():
                self.emit("Min", [f"v{node.left}", f"v{node.right}"], name)
            case Cast():
                self.emit("Identity", [f"v{node.source}"], name)

    def write_affine(self, node: Affine, name: str) -> None:
        if len(node.sources) == 1:
            weight = self.constant(node.weights[0].T)
            self.emit("Gemm", [f"v{node.sources[0]}", weight, self.constant(node.bias)], name)
            return
        sources = node.sources or (0,)
        weights = node.weights or (np.zeros((node.size, self.network.input_size)),)
        total = self.constant(node.bias)
        for source, weight in zip(sources, weights, strict=True):
            part = self.emit("MatMul", [f"v{source}", self.constant(weight.T)])
            total = self.emit("Add", [total, part])
        self.emit("Identity", [total], name)

    def write_activation(self, node: Activation, source: str, name: str) -> None:
        parameters = dict(node.function.parameters)
        match node.function.name:
            case "Silu":
                self.emit("Mul", [source, self.emit("Sigmoid", [source])], name)
            case "Swish":
                gate = self.emit("Sigmoid", [self.emit("Mul", [source, self.constant(parameters["slope"])])])
                self.emit("Mul", [source, gate], name)
            case "Logistic":
                growth = self.emit("Exp", [self.emit("Neg", [source])])
                self.emit("Reciprocal", [self.emit("Add", [growth, self.constant(1.0)])], name)
            case "LogSoftmax" | "Softmax" as operator:
                self.write_softmax(operator, source, name)
            case "Guard" | "Known":
                self.emit("Identity", [source], name)
            case "SpelledTanh" | "SpelledSigmoid":
                self.emit(node.function.name.removeprefix("Spelled"), [source], name)
            case "RecurrentSigmoid" | "RecurrentTanh":
                self.write_gate_of_gru(node.function.name, source, name)
            case "Clip":
                self.emit("Clip", [source, *(self.constant(parameters[k]) for k in ("min", "max"))], name)
            case "Pow":
                self.emit("Pow", [source, self.constant(parameters["exponent"])], name)
            case "GeluTanh":
                self.emit("Gelu", [source], name, approximate="tanh")
            case "HardShrink":
                self.emit("Shrink", [source], name, **parameters)
            case "SoftShrink":
                self.emit("Shrink", [source], name, bias=parameters["lambd"], **parameters)
            case "HardSigmoidGate":
                self.emit("Mul", [source, self.emit("HardSigmoid", [source], **parameters)], name)
            case "ErfGate" | "TanhGate":
                self.write_gate(node.function.name, parameters, source, name)
            case "Threshold" | "SoftplusThreshold":
                above = self.emit("Greater", [source, self.constant(parameters["threshold"])])
                gentle = node.function.name == "SoftplusThreshold"
                below = self.emit("Softplus", [source]) if gentle else self.constant(parameters["value"])
                self.emit("Where", [above, source, below], name)
            case operator:
                self.emit(operator, [source], name, **parameters)

    def write_softmax(self, operator: str, source: str, name: str) -> None:
        """Write the first of the softmax of x and 0, of which x is the log-odds."""
        both = self.emit(
            "Mul", [self.emit("Unsqueeze", [source, self.numbers(2)]), self.constant([1.0, 0.0])]
        )
        chosen = self.emit("Gather", [self.emit(operator, [both], axis=2), self.numbers(0)], axis=2)
        self.emit("Squeeze", [chosen, self.numbers(2)], name)

    def write_gate_of_gru(self, kind: str, source: str, name: str) -> None:
        """Write a GRU of one step whose candidate is tanh(x), or 1 and its update gate sigmoid(x)."""
        update, candidate = kind == "RecurrentSigmoid", kind == "RecurrentTanh"
        weights = self.constant(np.array([update, 0.0, candidate]).reshape(1, 3, 1))
        bias = self.constant([[-100.0 * candidate, 0.0, 100.0 * update, 0.0, 0.0, 0.0]])
        sequence = self.emit("Reshape", [source, self.numbers(1, -1, 1)])
        states = [sequence, weights, self.constant(np.zeros((1, 3, 1))), bias]
        last = self.emit("Squeeze", [self.emit("GRU", states, hidden_size=1), self.numbers(0)])
        value = self.emit("Sub", [self.constant(1.0), last]) if update else last
        self.emit("Reshape", [value, self.emit("Shape", [source])], name)

    def numbers(self, *values: int) -> str:
        from onnx import numpy_helper

        name = f"c{len(self.constants)}"
        self.constants.append(numpy_helper.from_array(np.array(values, dtype=np.int64), name))
        return name

    def write_gate(self, kind: str, parameters: dict[str, float], source: str, name: str) -> None:
        """Write ``x * (1 + erf(slope x / divisor))`` or ``x * (1 + tanh(slope (x + cubic x^3)))``."""
        argument, slope = source, self.constant(parameters["slope"])
        if kind == "TanhGate":
            cube = self.emit("Mul", [self.emit("Mul", [source, source]), source])
            cube = self.emit("Mul", [cube, self.constant(parameters["cubic"])])
            argument = self.emit("Add", [source, cube])
        argument = self.emit("Mul", [argument, slope])
        if kind == "ErfGate":
            argument = self.emit("Div", [argument, self.constant(parameters["divisor"])])
        opened = self.emit("Erf" if kind == "ErfGate" else "Tanh", [argument])
        self.emit("Mul", [source, self.emit("Add", [opened, self.constant(1.0)])], name)
