"""What a model file holds, whether it can be verified, and a sidecar to fill in."""

from __future__ import annotations

import json
import os
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, fields

import numpy as np
import onnx

from viatool.errors import PolicyError, SelfCheckError, ViatoolError
from viatool.policy.action_map import with_action_map
from viatool.policy.entries import SUFFIX, as_specified
from viatool.policy.executed import executed_networks
from viatool.policy.graph import Graph, live, read_graph
from viatool.policy.maps import Maps, maps_of
from viatool.policy.memory import checked_memory, memory_program, with_memory
from viatool.policy.model_file import ModelFile, Ports, actor_graph, open_model
from viatool.policy.network import Activation, Affine, Cast, Input, Maximum, Minimum, Network, Node, Product
from viatool.policy.policy import check_inputs, check_sizes
from viatool.policy.reader import UnreadableNode, read_network, unsupported
from viatool.policy.runtime import runtime_of
from viatool.policy.self_check import SelfCheck, check_executed
from viatool.policy.specification import PolicySpecification
from viatool.policy.specification_file import load_specification
from viatool.policy.weights import copies, terms


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
    """An input or output of the graph.

    Parameters
    ----------
    name, dtype : str
        As written in the file.
    shape : tuple of int or str
        As written in the file; names stand for free sizes.
    depends_on : tuple of str
        The inputs that an output depends on; an output of constants depends on none.
    """

    name: str
    dtype: str
    shape: tuple[int | str, ...]
    depends_on: tuple[str, ...] = ()


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
    ports : Ports or None
        The inputs that together are the observation, in its order; None where that could not be settled.
    action : str or None
        The output that is the action; None where that could not be settled.
    memory : dict
        Of inputs, the last of `ports`, the outputs of the step before that they take.
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
    findings : tuple of UnreadableNode
        Every node that is not supported.
    problems : tuple of ViatoolError
        Whatever else prevents verification; a `SelfCheckError` where the network was read wrongly.
    maps : Maps or None
        What is applied before and after the network; None where it cannot be read.
    """

    path: str
    sha256: str
    opset: int
    ir_version: int
    producer: str
    inputs: tuple[Value, ...]
    outputs: tuple[Value, ...]
    ports: Ports | None
    action: str | None
    memory: dict[str, str]
    operators: dict[str, int]
    layers: tuple[Layer, ...]
    activations: dict[str, int]
    specification: PolicySpecification | None
    self_check: SelfCheck | None
    findings: tuple[UnreadableNode, ...]
    problems: tuple[ViatoolError, ...]
    maps: Maps | None

    @property
    def verifiable(self) -> bool:
        """Whether nothing prevents verification."""
        return self.self_check is not None and not self.findings and not self.problems

    @property
    def failure(self) -> ViatoolError | None:
        """Return one error with everything that prevents verification; None where nothing does."""
        found = [unsupported(self.path, self.findings)] if self.findings else []
        errors: list[ViatoolError] = [*found, *self.problems]
        if len(errors) < 2:
            return next(iter(errors), None)
        kind = next((type(error) for error in errors if isinstance(error, SelfCheckError)), PolicyError)
        return kind("\n".join(error.message for error in errors), "; ".join(e.hint for e in errors if e.hint))

    def to_json(self) -> str:
        """Return everything as a JSON document."""
        facts = {each.name: getattr(self, each.name) for each in fields(self)}
        spec = self.specification
        facts["specification"] = None if spec is None else spec.model_dump(mode="json", exclude_none=True)
        facts["problems"] = [{"message": error.message, "hint": error.hint} for error in self.problems]
        facts["ports"] = None if self.ports is None else [asdict(port) for port in self.ports.each]
        facts["verifiable"] = self.verifiable
        return json.dumps(facts, default=asdict, indent=2) + "\n"


def describe(
    path: str | os.PathLike[str],
    spec: str | os.PathLike[str] | PolicySpecification | None = None,
    *,
    input_name: str | Sequence[str] | None = None,
    output_name: str | None = None,
    memory: Mapping[str, str] | None = None,
) -> Inspection:
    """Look into a model file, as far as it can be read.

    Parameters
    ----------
    path : path
        The ONNX file.
    spec : path or PolicySpecification, optional
        A sidecar; it replaces the specification inside the file.
    input_name : str or sequence of str, optional
        The inputs of the graph that together are the observation, in its order; they override the specification's.
    output_name : str, optional
        Which of several outputs is the action; it overrides the specification's.
    memory : mapping, optional
        Inputs that take what an output gave in the step before, of a policy without a specification.

    Raises
    ------
    PolicyError
        If the file cannot be read at all.
    """
    model = open_model(path)
    problems: list[ViatoolError] = []
    found = _Found()
    try:
        if isinstance(spec, (str, os.PathLike)):
            spec = load_specification(spec)
        found.specification = spec or model.specification()
    except PolicyError as error:
        problems.append(error)
    found.memory = dict((memory or {}) if found.specification is None else found.specification.memory)
    try:
        _look_inside(model, found, input_name, output_name)
    except (PolicyError, SelfCheckError) as error:
        problems.append(error)
    inputs, outputs = _ports(model)
    network = found.network
    return Inspection(
        path=str(model.path),
        sha256=model.sha256,
        opset=model.opset,
        ir_version=int(model.proto.ir_version),
        producer=model.producer,
        inputs=inputs,
        outputs=outputs,
        ports=found.ports,
        action=found.action,
        memory=found.memory,
        operators=_operators(model),
        layers=() if network is None else tuple(layers_of(network)),
        activations={} if network is None else _activations(network),
        specification=found.specification,
        self_check=found.self_check,
        findings=found.findings,
        problems=tuple(problems),
        maps=found.maps,
    )


@dataclass
class _Found:
    """What was found before something stopped the inspection."""

    specification: PolicySpecification | None = None
    memory: dict[str, str] = field(default_factory=dict)
    ports: Ports | None = None
    action: str | None = None
    network: Network | None = None
    maps: Maps | None = None
    self_check: SelfCheck | None = None
    findings: tuple[UnreadableNode, ...] = ()


def _look_inside(
    model: ModelFile, found: _Found, input_name: str | Sequence[str] | None, output_name: str | None
) -> None:
    spec = found.specification
    output_name = output_name or (spec.output if spec else None)
    model, output_name = as_specified(model, spec, output_name)
    named = input_name or (spec.input if spec else None)
    graph, ports = actor_graph(model, named, output_name, found.memory)
    found.ports, found.action = ports, graph.outputs[0].removesuffix(SUFFIX)
    reading = read_network(graph, ports, model.folder)
    found.findings = reading.findings
    if reading.network is None:
        return
    found.network, found.maps = reading.network, maps_of(reading.network, spec, ports)
    if spec is not None:
        found.specification = spec = with_memory(model.path, spec, ports)
        check_inputs(model.path, ports, spec, named=bool(input_name))
        check_sizes(model.path, reading.network, spec)
    found.network = with_action_map(reading.network, spec)
    runtime = runtime_of(model, graph, ports)
    found.self_check = check_executed(executed_networks(model, reading.network, runtime), runtime, spec)
    if spec is not None:
        memory_program(model, spec, ports)
    elif found.memory:
        checked_memory(model, found.memory, ports, np.zeros(ports.size))


def _ports(model: ModelFile) -> tuple[tuple[Value, ...], tuple[Value, ...]]:
    """Return the inputs and the outputs of the file's graph."""
    stored = {tensor.name for tensor in model.proto.graph.initializer}
    try:
        graph: Graph | None = read_graph(model.proto, model.folder)
    except PolicyError:
        graph = None
    outputs = []
    for value in model.proto.graph.output:
        depends_on: tuple[str, ...] = ()
        if graph is not None:
            with suppress(PolicyError):
                depends_on = tuple(live(graph, value.name).inputs)
        outputs.append(_value(value, depends_on))
    inputs = tuple(_value(value) for value in model.proto.graph.input if value.name not in stored)
    return inputs, tuple(outputs)


def _operators(model: ModelFile) -> dict[str, int]:
    """Count the calls in the file's graph; an operator of another domain is named with it."""
    names = (
        node.op_type if node.domain in ("", "ai.onnx") else f"{node.domain}.{node.op_type}"
        for node in model.proto.graph.node
    )
    return dict(sorted(Counter(names).items()))


def layers_of(network: Network) -> list[Layer]:
    """Return the nodes of a network after its input, in words."""
    nodes = network.nodes[1:]
    return [Layer(_kind(node), node.size, node.precision, node.sources, _parameters(node)) for node in nodes]


def _kind(node: Node) -> str:
    match node:
        case Activation():
            return node.function.name
        case Affine():
            return _kind_of_affine(node)
        case Input() | Product() | Maximum() | Minimum() | Cast():
            return type(node).__name__.lower()


def _kind_of_affine(node: Affine) -> str:
    if not node.sources:
        return "constant"
    ones = all(copies(weight).all() for weight in node.weights)
    per_row = np.sum([terms(weight) for weight in node.weights], axis=0)
    if ones and not node.bias.any() and np.max(per_row) <= 1:
        return "copy"
    return "elementwise affine" if node.is_elementwise else "affine"


def _parameters(node: Node) -> int:
    match node:
        case Affine():
            weights = sum(int(terms(weight).sum()) for weight in node.weights)
            return weights + int(np.count_nonzero(node.bias))
        case Input() | Activation() | Product() | Maximum() | Minimum() | Cast():
            return 0


def _activations(network: Network) -> dict[str, int]:
    counter: Counter[str] = Counter()
    for node in network.nodes:
        if isinstance(node, Activation):
            counter[node.function.name] += node.size
    return dict(counter.most_common())


def _value(value: onnx.ValueInfoProto, depends_on: tuple[str, ...] = ()) -> Value:
    if not value.type.HasField("tensor_type"):
        return Value(value.name, str(value.type.WhichOneof("value") or "unknown"), (), depends_on)
    tensor = value.type.tensor_type
    kinds = {number: name.lower() for name, number in onnx.TensorProto.DataType.items()}
    shape = tuple(
        int(axis.dim_value) if axis.HasField("dim_value") else (axis.dim_param or "?")
        for axis in tensor.shape.dim
    )
    return Value(value.name, kinds.get(tensor.elem_type, str(tensor.elem_type)), shape, depends_on)
