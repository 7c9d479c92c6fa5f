"""What a model file holds, whether it can be verified, and a sidecar to fill in."""

from __future__ import annotations

import json
import os
from collections import Counter
from dataclasses import asdict, dataclass, fields

import numpy as np
import onnx

from viatool.errors import PolicyError, SelfCheckError
from viatool.policy.action_map import with_action_map
from viatool.policy.model_file import ModelFile, Port, actor_graph, open_model
from viatool.policy.network import Activation, Affine, Network, Node
from viatool.policy.policy import check_sizes
from viatool.policy.reader import Finding, read_network
from viatool.policy.runtime import runtime_of
from viatool.policy.self_check import SelfCheck, check_network
from viatool.policy.specification import PolicySpecification
from viatool.policy.specification_file import load_specification


@dataclass(frozen=True)
class Layer:
    """One node of the network that is verified.

    Parameters
    ----------
    kind : str
        ``affine``, ``elementwise affine``, ``copy``, ``constant``, an activation, ``product``, ...
    size : int
        Length of its output.
    precision : str
        In which the program computes it.
    sources : tuple of int
        The layers that it reads; 0 is the observation.
    parameters : int
        How many weights and biases it keeps.
    """

    kind: str
    size: int
    precision: str
    sources: tuple[int, ...]
    parameters: int


@dataclass(frozen=True)
class Value:
    """An input or output of the graph: name, element type and shape as written in the file."""

    name: str
    dtype: str
    shape: tuple[int | str, ...]


@dataclass(frozen=True, eq=False)
class Inspection:
    """What a model file holds.

    Parameters
    ----------
    path, sha256 : str
        The file.
    opset, ir_version : int
        Versions of the operators and of the file format.
    producer : str
        The exporter.
    inputs, outputs : tuple of Value
        All of the graph.
    port : Port or None
        The input that is the observation; None where that could not be settled.
    operators : dict
        How often each operator stands in the file's graph, by name.
    layers : tuple of Layer
        Of the network that is verified, the observation excluded; empty where it cannot be read.
    activations : dict
        How many neurons each activation bends.
    specification : PolicySpecification or None
        From the file or the sidecar.
    self_check : SelfCheck or None
        None where it was not reached.
    findings : tuple of Finding
        Every node that is not supported.
    problems : tuple of str
        Whatever else prevents verification.
    before, after : str
        The maps that are applied to the observation and to the action.
    """

    path: str
    sha256: str
    opset: int
    ir_version: int
    producer: str
    inputs: tuple[Value, ...]
    outputs: tuple[Value, ...]
    port: Port | None
    operators: dict[str, int]
    layers: tuple[Layer, ...]
    activations: dict[str, int]
    specification: PolicySpecification | None
    self_check: SelfCheck | None
    findings: tuple[Finding, ...]
    problems: tuple[str, ...]
    before: str = ""
    after: str = ""

    @property
    def verifiable(self) -> bool:
        """Whether nothing prevents verification."""
        return self.self_check is not None and not self.findings and not self.problems

    def to_json(self) -> str:
        """Return everything as a JSON document."""
        facts = {field.name: getattr(self, field.name) for field in fields(self)}
        spec = self.specification
        facts["specification"] = None if spec is None else spec.model_dump(mode="json", exclude_none=True)
        facts["verifiable"] = self.verifiable
        return json.dumps(facts, default=asdict, indent=2) + "\n"


def describe(
    path: str | os.PathLike[str], spec: str | os.PathLike[str] | PolicySpecification | None = None
) -> Inspection:
    """Look into a model file, as far as it can be read.

    Parameters
    ----------
    path : path
        The ONNX file.
    spec : path or PolicySpecification, optional
        A sidecar; it replaces the specification inside the file.

    Raises
    ------
    PolicyError
        If the file or the sidecar cannot be read at all.
    """
    model = open_model(path)
    problems: list[str] = []
    found = _Found()
    try:
        if isinstance(spec, (str, os.PathLike)):
            spec = load_specification(spec)
        found.specification = spec or model.specification()
        _look_inside(model, found)
    except (PolicyError, SelfCheckError) as error:
        problems.append(str(error))
    graph = model.proto.graph
    initializers = {tensor.name for tensor in graph.initializer}
    network = found.network
    return Inspection(
        path=str(model.path),
        sha256=model.sha256,
        opset=model.opset,
        ir_version=int(model.proto.ir_version),
        producer=model.producer,
        inputs=tuple(_value(value) for value in graph.input if value.name not in initializers),
        outputs=tuple(_value(value) for value in graph.output),
        port=found.port,
        operators=dict(sorted(Counter(node.op_type for node in graph.node).items())),
        layers=() if network is None else tuple(layers_of(network)),
        activations={} if network is None else _activations(network),
        specification=found.specification,
        self_check=found.self_check,
        findings=found.findings,
        problems=tuple(problems),
        before="" if network is None else map_before(network),
        after=map_after(found.specification),
    )


@dataclass
class _Found:
    """What was found before something stopped the inspection."""

    specification: PolicySpecification | None = None
    port: Port | None = None
    network: Network | None = None
    self_check: SelfCheck | None = None
    findings: tuple[Finding, ...] = ()


def _look_inside(model: ModelFile, found: _Found) -> None:
    spec = found.specification
    graph, port = actor_graph(model, spec.input if spec else None, spec.output if spec else None)
    found.port = port
    reading = read_network(graph, port.name, port.shape, port.precision, model.folder)
    found.findings = reading.findings
    if reading.network is None:
        return
    found.network = reading.network
    if spec is not None:
        check_sizes(model.path, reading.network, spec)
    found.self_check = check_network(reading.network, runtime_of(model, graph, port), spec)
    found.network = with_action_map(reading.network, spec)


def layers_of(network: Network) -> list[Layer]:
    """Return the nodes of a network after its input, in words."""
    nodes = network.nodes[1:]
    return [Layer(_kind(node), node.size, node.precision, node.sources, _parameters(node)) for node in nodes]


def _kind(node: Node) -> str:
    if isinstance(node, Activation):
        return node.function.name
    if not isinstance(node, Affine):
        return type(node).__name__.lower()
    if not node.sources:
        return "constant"
    ones = all(np.isin(weight, (0.0, 1.0)).all() for weight in node.weights)
    per_row = sum(np.count_nonzero(weight, axis=1) for weight in node.weights)
    if ones and not node.bias.any() and np.max(per_row) <= 1:
        return "copy"
    return "elementwise affine" if _is_elementwise(node) else "affine"


def _is_elementwise(node: Affine) -> bool:
    (weight, *more) = node.weights
    return (
        not more and weight.shape[0] == weight.shape[1] and np.array_equal(weight, np.diag(np.diag(weight)))
    )


def _parameters(node: Node) -> int:
    if not isinstance(node, Affine):
        return 0
    return sum(int(np.count_nonzero(weight)) for weight in node.weights) + int(np.count_nonzero(node.bias))


def _activations(network: Network) -> dict[str, int]:
    counter: Counter[str] = Counter()
    for node in network.nodes:
        if isinstance(node, Activation):
            counter[node.function.name] += node.size
    return dict(counter.most_common())


def map_before(network: Network) -> str:
    """Return in words what the model itself does to the observation before its first layer."""
    count = 0
    last = 0
    for index, node in enumerate(network.nodes[1:], start=1):
        if not isinstance(node, Affine) or node.sources != (last,) or not _is_elementwise(node):
            break
        count, last = count + 1, index
    if not count:
        return "none: the raw observation enters the first layer, so it must come as it was in training"
    return f"inside the model: scale and offset of each entry, in {count} step{'s' if count > 1 else ''}"


def map_after(spec: PolicySpecification | None) -> str:
    """Return in words what the specification does to the output of the model."""
    if spec is None:
        return "unknown: there is no specification"
    if spec.action_map is None:
        return "none: the output of the model is the physical command"
    scale = ", ".join(f"{value:g}" for value in spec.action_map.scale)
    offset = ", ".join(f"{value:g}" for value in spec.action_map.offset)
    clip = ", clipped to the limits of the actions" if spec.action_map.clip else ""
    return f"by the specification: ({scale}) * output + ({offset}){clip}"


def _value(value: onnx.ValueInfoProto) -> Value:
    if not value.type.HasField("tensor_type"):
        return Value(value.name, str(value.type.WhichOneof("value") or "unknown"), ())
    tensor = value.type.tensor_type
    kinds = {number: name.lower() for name, number in onnx.TensorProto.DataType.items()}
    shape = tuple(
        int(axis.dim_value) if axis.HasField("dim_value") else (axis.dim_param or "?")
        for axis in tensor.shape.dim
    )
    return Value(value.name, kinds.get(tensor.elem_type, str(tensor.elem_type)), shape)
