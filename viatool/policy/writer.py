"""From a network to a clean ONNX file, specification inside; reading it back gives the same function."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import onnx
from onnx import helper

from viatool.arrays import Floats
from viatool.policy.activations import ActivationFunction
from viatool.policy.network import (
    Activation,
    Affine,
    Cast,
    Maximum,
    Minimum,
    Network,
    Node,
    Precision,
    Product,
)
from viatool.policy.specification import METADATA_KEY, PolicySpecification
from viatool.policy.weights import dense

OPSET = 17
IR_VERSION = 8
INPUT_NAME = "observation"
OUTPUT_NAME = "action"

_ELEMENT_TYPES = {
    "float16": onnx.TensorProto.FLOAT16,
    "float32": onnx.TensorProto.FLOAT,
    "float64": onnx.TensorProto.DOUBLE,
}
_NUMPY_TYPES: dict[str, type[np.floating[Any]]] = {
    "float16": np.float16,
    "float32": np.float32,
    "float64": np.float64,
}
_YOUNG_OPERATORS = {"Gelu": 20, "GeluTanh": 20, "Mish": 18}


def write_onnx(network: Network, spec: PolicySpecification | None, path: str | os.PathLike[str]) -> None:
    """Write a network, whole or not at all.

    Parameters
    ----------
    network : Network
        Its weights must be representable in the precision of their node.
    spec : PolicySpecification or None
        Goes into the metadata as JSON.
    path : path
        The ONNX file: input ``observation`` and output ``action``, the first axis free.

    Raises
    ------
    ValueError
        If a weight or a parameter is not representable, or the sizes do not fit the specification.
    """
    if spec is not None and (spec.observation_size, spec.action_size) != (
        network.input_size,
        network.output_size,
    ):
        raise ValueError(
            f"the network maps {network.input_size} to {network.output_size} numbers, its specification "
            f"{spec.observation_size} to {spec.action_size}"
        )
    content = onnx_model(network, spec).SerializeToString(deterministic=True)
    path = Path(path)
    descriptor, draft = tempfile.mkstemp(prefix=f".{path.stem}-", suffix=path.suffix, dir=path.parent)
    try:
        with os.fdopen(descriptor, "wb") as file:
            file.write(content)
        umask = os.umask(0)
        os.umask(umask)
        Path(draft).chmod(0o666 & ~umask)
        Path(draft).replace(path)
    finally:
        Path(draft).unlink(missing_ok=True)


def onnx_model(network: Network, spec: PolicySpecification | None) -> onnx.ModelProto:
    """Return the model of a network, see `write_onnx`."""
    from viatool import __version__

    writer = _Writer(network)
    for index in range(1, len(network.nodes)):
        writer.write(index)
    first, last = network.nodes[0].precision, network.nodes[-1].precision
    final = writer.names[-1]
    writer.nodes.append(helper.make_node("Identity", [final], [OUTPUT_NAME]))
    if writer.nodes[-2:-1] and writer.nodes[-2].output[0] == final:
        writer.nodes.pop()
        writer.nodes[-1].output[0] = OUTPUT_NAME
    graph = helper.make_graph(
        writer.nodes,
        "policy",
        [helper.make_tensor_value_info(INPUT_NAME, _ELEMENT_TYPES[first], ["batch", network.input_size])],
        [helper.make_tensor_value_info(OUTPUT_NAME, _ELEMENT_TYPES[last], ["batch", network.output_size])],
        writer.initializers,
    )
    model = helper.make_model(
        graph,
        opset_imports=[helper.make_opsetid("", writer.opset)],
        producer_name="viatool",
        producer_version=__version__,
    )
    model.ir_version = IR_VERSION if writer.opset == OPSET else 9
    if spec is not None:
        helper.set_model_props(model, {METADATA_KEY: spec.to_json()})
    return model


class _Writer:
    """Collects ONNX nodes; `names` holds the value that each network node became."""

    def __init__(self, network: Network) -> None:
        self.network = network
        self.names: list[str] = [INPUT_NAME]
        self.nodes: list[onnx.NodeProto] = []
        self.initializers: list[onnx.TensorProto] = []
        self.opset = OPSET

    def write(self, index: int) -> None:
        """Append one network node."""
        node = self.network.nodes[index]
        self.names.append(_WRITERS[type(node)](self, node))

    def call(self, operator: str, inputs: Sequence[str], **attributes: Any) -> str:
        """Append one operator; return the name of its result."""
        name = f"{operator.lower()}_{len(self.nodes)}"
        self.nodes.append(helper.make_node(operator, list(inputs), [name], name=name, **attributes))
        return name

    def constant(self, values: Floats, precision: Precision, kind: str) -> str:
        """Append an initialiser."""
        stored = np.asarray(values, dtype=_NUMPY_TYPES[precision])
        if not np.array_equal(stored.astype(np.float64), values):
            raise ValueError(f"a {kind} is not representable in {precision}")
        name = f"{kind}_{len(self.initializers)}"
        self.initializers.append(onnx.numpy_helper.from_array(stored, name))
        return name


def _write_affine(writer: _Writer, node: Affine) -> str:
    if not node.sources:  # the input makes the batch axis
        zeros = np.zeros((node.size, writer.network.input_size))
        return _gemm(writer, INPUT_NAME, zeros, node.bias, node.precision)
    terms = [(writer.names[s], dense(weight)) for s, weight in zip(node.sources, node.weights, strict=True)]
    if len(terms) == 2 and not node.bias.any() and all(_is_identity(weight) for _, weight in terms):
        return writer.call("Add", [name for name, _ in terms])
    if len(terms) == 1 and _is_diagonal(terms[0][1]):
        return _diagonal(writer, terms[0][0], np.diag(terms[0][1]), node)
    if _selects(node):
        return _selection(writer, terms)
    result = _gemm(writer, *terms[0], node.bias, node.precision)
    for name, weight in terms[1:]:
        result = writer.call("Add", [result, _gemm(writer, name, weight, None, node.precision)])
    return result


def _gemm(writer: _Writer, name: str, weight: Floats, bias: Floats | None, precision: Precision) -> str:
    inputs = [name, writer.constant(weight, precision, "weight")]
    if bias is not None and bias.any():
        inputs.append(writer.constant(bias, precision, "bias"))
    return writer.call("Gemm", inputs, transB=1)


def _diagonal(writer: _Writer, name: str, factors: Floats, node: Affine) -> str:
    if (factors == -1).all() and not node.bias.any():
        return writer.call("Neg", [name])
    if (factors != 1).any():
        name = writer.call("Mul", [name, writer.constant(factors, node.precision, "factor")])
    if node.bias.any() or (factors == 1).all():
        name = writer.call("Add", [name, writer.constant(node.bias, node.precision, "offset")])
    return name


def _selection(writer: _Writer, terms: Sequence[tuple[str, Floats]]) -> str:
    """Write exact copies as Concat and Gather."""
    name = terms[0][0] if len(terms) == 1 else writer.call("Concat", [name for name, _ in terms], axis=1)
    columns = np.argmax(np.concatenate([weight for _, weight in terms], axis=1), axis=1)
    if np.array_equal(columns, np.arange(sum(weight.shape[1] for _, weight in terms))):
        return name
    indices = f"index_{len(writer.initializers)}"
    writer.initializers.append(onnx.numpy_helper.from_array(columns.astype(np.int64), indices))
    return writer.call("Gather", [name, indices], axis=1)


def _is_identity(weight: Floats) -> bool:
    return weight.shape[0] == weight.shape[1] and np.array_equal(weight, np.eye(len(weight)))


def _is_diagonal(weight: Floats) -> bool:
    return weight.shape[0] == weight.shape[1] and np.array_equal(weight, np.diag(np.diag(weight)))


def _selects(node: Affine) -> bool:
    joined = np.concatenate([dense(weight) for weight in node.weights], axis=1)
    one_each = np.isin(joined, (0.0, 1.0)).all() and (np.count_nonzero(joined, axis=1) == 1).all()
    return bool(one_each) and not node.bias.any()


def _write_activation(writer: _Writer, node: Activation) -> str:
    function, source = node.function, writer.names[node.source]
    writer.opset = max(writer.opset, _YOUNG_OPERATORS.get(function.name, OPSET))
    special = _ACTIVATIONS.get(function.name)
    if special is not None:
        return special(writer, source, function, node.precision)
    parameters = dict(function.parameters)
    for name, value in parameters.items():
        if float(np.float32(value)) != value:
            raise ValueError(f"{function.name}: {name} = {value!r} is not representable in float32")
    return writer.call(function.name, [source], **parameters)


def _write_clip(writer: _Writer, source: str, function: ActivationFunction, precision: Precision) -> str:
    inputs = [source]
    for name, value in function.parameters:
        finite = np.isfinite(value)
        kind = f"bound_{name}"  # not "max" alone, which is the name of what a Max gives
        inputs.append(writer.constant(np.asarray(value), precision, kind) if finite else "")
    return writer.call("Clip", inputs if inputs[-1] else inputs[:-1])


def _write_silu(writer: _Writer, source: str, function: ActivationFunction, precision: Precision) -> str:
    return writer.call("Mul", [source, writer.call("Sigmoid", [source])])


def _write_logistic(writer: _Writer, source: str, function: ActivationFunction, precision: Precision) -> str:
    growth = writer.call("Exp", [writer.call("Neg", [source])])
    one = writer.constant(np.asarray(1.0), precision, "one")
    return writer.call("Div", [one, writer.call("Add", [growth, one])])


def _write_power(writer: _Writer, source: str, function: ActivationFunction, precision: Precision) -> str:
    (exponent,) = (value for _, value in function.parameters)
    return writer.call("Pow", [source, writer.constant(np.asarray(exponent), precision, "exponent")])


def _write_gelu(writer: _Writer, source: str, function: ActivationFunction, precision: Precision) -> str:
    return writer.call("Gelu", [source], approximate="tanh" if function.name == "GeluTanh" else "none")


def _write_gate(writer: _Writer, source: str, function: ActivationFunction, precision: Precision) -> str:
    return writer.call(function.name.removeprefix("Recurrent"), [source])


_ACTIVATIONS: dict[str, Callable[[_Writer, str, ActivationFunction, Precision], str]] = {
    "Clip": _write_clip,
    "Gelu": _write_gelu,
    "GeluTanh": _write_gelu,
    "Logistic": _write_logistic,
    "Pow": _write_power,
    "RecurrentSigmoid": _write_gate,
    "RecurrentTanh": _write_gate,
    "Silu": _write_silu,
}


def _write_pair(writer: _Writer, node: Product | Maximum | Minimum) -> str:
    operator = {Product: "Mul", Maximum: "Max", Minimum: "Min"}[type(node)]
    return writer.call(operator, [writer.names[node.left], writer.names[node.right]])


def _write_cast(writer: _Writer, node: Cast) -> str:
    return writer.call("Cast", [writer.names[node.source]], to=_ELEMENT_TYPES[node.precision])


_WRITERS: dict[type[Node], Callable[[_Writer, Any], str]] = {
    Affine: _write_affine,
    Activation: _write_activation,
    Product: _write_pair,
    Maximum: _write_pair,
    Minimum: _write_pair,
    Cast: _write_cast,
}
