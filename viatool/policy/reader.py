"""From the nodes of a model to the network that is verified, or to a list of all that stands in the way."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import onnx

from viatool.errors import PolicyError
from viatool.policy.assembly import Assembly, Computed, Refusal
from viatool.policy.folding import FOLDED, SHAPE_ONLY, fold, fold_shape
from viatool.policy.fused import is_fused, parts_of
from viatool.policy.graph import Graph, GraphNode
from viatool.policy.model_file import Ports
from viatool.policy.network import Network
from viatool.policy.operators import Call, Comparison, Result, Scope, entry_of
from viatool.policy.refusals import reason_for
from viatool.policy.tensors import Constant, read_tensor

_MALFORMED = (
    ValueError,
    TypeError,
    IndexError,
    KeyError,
    AttributeError,
    ArithmeticError,
    RuntimeError,
    AssertionError,
)
"""What the evaluation of a malformed node may raise."""


@dataclass(frozen=True)
class UnreadableNode:
    """One node that cannot be read.

    Parameters
    ----------
    node : str
        Its name.
    operator : str
        What it calls, with its domain.
    reason, hint : str
        Why, and one imperative.
    """

    node: str
    operator: str
    reason: str
    hint: str = ""

    def __str__(self) -> str:
        return f"node '{self.node}' ({self.operator}) {self.reason}"


@dataclass(frozen=True, eq=False)
class Reading:
    """What came of reading a graph: the network, or the findings that prevent it."""

    network: Network | None
    findings: tuple[UnreadableNode, ...]


def unsupported(what: str, findings: Sequence[UnreadableNode]) -> PolicyError:
    """Return the error that names every node that cannot be read, with each hint once."""
    count = len(findings)
    lines = "".join(f"\n  - {finding}" for finding in findings)
    hints = dict.fromkeys(finding.hint for finding in findings if finding.hint)
    return PolicyError(
        f"{what}: {count} {'node is' if count == 1 else 'nodes are'} not supported:{lines}", "; ".join(hints)
    )


@dataclass(frozen=True)
class _Unreadable:
    """Stands for a value that a refused node should have made; whether it would depend on the observation."""

    computed: bool


def read_network(graph: Graph, ports: Ports, folder: Path) -> Reading:
    """Read the live nodes of a graph into a network.

    Parameters
    ----------
    graph : Graph
        With one output and its live nodes in order.
    ports : Ports
        The inputs that are the observation.
    folder : Path
        Where external data may lie.

    Raises
    ------
    PolicyError
        If a stored tensor is broken.
    """
    assembly = Assembly(ports.size, ports.precision)
    values: dict[str, Result | _Unreadable] = dict(_observed(ports, assembly))
    for name, tensor in graph.initializers.items():
        values[name] = read_tensor(tensor, folder)
    findings: list[UnreadableNode] = []
    for node in graph.nodes:
        assembly.call = node.label
        results: Sequence[Result | None] = []
        try:
            with np.errstate(all="ignore"):  # what is not finite is refused by name
                results = _read_node(node, values, assembly)
        except Refusal as refusal:
            findings.append(UnreadableNode(node.name, _operator(node), refusal.reason, refusal.hint))
        missing = _Unreadable(_is_computed(node, values))
        values.update((name, missing) for name in node.outputs if name)
        made = zip(node.outputs, results, strict=False)
        values.update((name, value) for name, value in made if name and value is not None)
    if findings:
        return Reading(None, tuple(findings))
    output = values[graph.outputs[0]]
    if not isinstance(output, Computed):
        raise PolicyError(
            f"the output '{graph.outputs[0]}' does not depend on the input {', '.join(map(repr, ports.names))}",
            "choose another output, or export the policy again",
        )
    return Reading(assembly.network(output), ())


def _observed(ports: Ports, assembly: Assembly) -> Iterator[tuple[str, Computed]]:
    """Return each input by its name: the observation, or the part of it that the input takes."""
    if len(ports.each) == 1:
        (port,) = ports.each
        yield port.name, Computed(0, port.shape, port.precision)
        return
    observation = Computed(0, (ports.size,), ports.precision)
    for port in ports.each:
        assembly.call = f"the input '{port.name}'"
        place = np.arange(ports.size)[ports.places[port.name]]
        yield (
            port.name,
            assembly.copies([(observation, place)], np.zeros(place.size), port.shape, port.precision),
        )


def _is_computed(node: GraphNode, values: Mapping[str, Result | _Unreadable]) -> bool:
    """Whether what a node makes depends on more than constants."""
    if node.operator in SHAPE_ONLY:
        return False
    given = [values[name] for name in node.reads if name]
    constant = [isinstance(v, Constant) or (isinstance(v, _Unreadable) and not v.computed) for v in given]
    return not given or not all(constant)


def _operator(node: GraphNode) -> str:
    return f"{node.domain}.{node.operator}" if node.domain else node.operator


def _read_node(
    node: GraphNode, values: Mapping[str, Result | _Unreadable], assembly: Assembly
) -> Sequence[Result | None]:
    """Return the values that a node makes; none where its inputs are unreadable and it says nothing new."""
    if is_fused(node):
        return _read_parts(node, values, assembly)
    version, schema = _schema(node)
    entry = entry_of(node.operator, version)
    if entry is None and node.operator not in FOLDED:
        raise reason_for(node, version)
    given = [values[name] if name else None for name in node.inputs]
    if any(isinstance(values[name], _Unreadable) for name in node.captured):
        return []
    attributes = _with_defaults(node, schema)
    inputs: list[Result | None] = []
    for value in given:
        if isinstance(value, _Unreadable):
            if entry is None and value.computed and node.operator not in SHAPE_ONLY:
                raise reason_for(node, version)
            return []
        inputs.append(value)
    try:
        constants = [value for value in inputs if not isinstance(value, Computed | Comparison)]
        if len(constants) == len(inputs) and not node.subgraphs:
            return list(fold(node, constants, attributes))
        known = fold_shape(node, inputs, attributes)
        if known is not None:
            return [known]
        if entry is None:
            raise reason_for(node, version)
        scope = Scope(values, lambda call, around: _read_node(call, around, assembly))
        return list(entry.reader(Call(node, version, inputs, attributes, assembly, scope)))
    except _MALFORMED as error:
        raise Refusal(f"is malformed: {_first_line(error)}", "export the policy again") from error


def _read_parts(
    node: GraphNode, values: Mapping[str, Result | _Unreadable], assembly: Assembly
) -> list[Result]:
    """Return the values of a node that stands for several of the standard's."""
    inner = {name: values[name] for name in node.inputs if name}
    if any(isinstance(value, _Unreadable) for value in inner.values()):
        return []
    ranks = [len(_shape_of(inner[name])) if name else 0 for name in node.inputs]
    for part in parts_of(node, ranks):
        made = zip(part.outputs, _read_node(part, inner, assembly), strict=False)
        inner.update((name, value) for name, value in made if value is not None)
    results = [inner.get(name or node.key) for name in node.outputs]
    if any(result is None for result in results):
        raise Refusal("has an output that is not read", "export the actor alone")
    return [result for result in results if result is not None and not isinstance(result, _Unreadable)]


def _shape_of(value: Result | _Unreadable) -> tuple[int, ...]:
    return value.shape if isinstance(value, Constant | Computed) else ()


def _first_line(error: Exception) -> str:
    return (str(error) or type(error).__name__).splitlines()[0][:200]


def _schema(node: GraphNode) -> tuple[int, Any]:
    if node.domain:
        raise reason_for(node, node.opset)
    try:
        schema = onnx.defs.get_schema(node.operator, node.opset, "")
    except onnx.defs.SchemaError as error:
        raise Refusal(f"is not an operator of opset {node.opset}", "export the policy again") from error
    return schema.since_version, schema


def _with_defaults(node: GraphNode, schema: Any) -> dict[str, Any]:
    attributes: dict[str, Any] = {}
    for name, declared in schema.attributes.items():
        if name in node.attributes:
            attributes[name] = node.attributes[name]
        elif declared.default_value.type:
            value = onnx.helper.get_attribute_value(declared.default_value)
            value = tuple(value) if isinstance(value, list) else value
            attributes[name] = value.decode() if isinstance(value, bytes) else value
    unknown = sorted(node.attributes.keys() - schema.attributes.keys())
    if unknown:
        raise Refusal(f"has the unknown attribute '{unknown[0]}'", "export the policy again")
    return attributes
