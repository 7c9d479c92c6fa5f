"""The computation of a model file as a flat list of live nodes, each with the opset version that defines it.

Model-local functions are expanded here, each node keeping the opset of the function it came from; nodes that
the chosen output does not need are dropped; what contradicts itself (cycles, names given twice) is refused.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import onnx

from viatool.errors import PolicyError
from viatool.policy.tensors import Constant, read_tensor

MAX_NODES = 20_000
"""Most nodes, after functions are expanded."""

MAX_DEPTH = 50
"""Deepest nesting of functions."""

OLDEST_OPSET = 6

Attribute = int | float | str | tuple[int, ...] | tuple[float, ...] | tuple[str, ...] | Constant
Renamed = Callable[[str], str]
"""Gives the name in the whole graph of a value of some part; the empty name stays empty."""

_REPAIR = "export the policy again: the file is damaged"


@dataclass(frozen=True, eq=False)
class Subgraph:
    """The graph that a loop or a branch holds.

    Parameters
    ----------
    nodes : tuple of GraphNode
        In the order of the file, functions expanded.
    initializers : mapping
        Of its own.
    inputs, outputs : tuple of str
        What it is given in each round, and what it gives.
    """

    nodes: tuple[GraphNode, ...]
    initializers: Mapping[str, onnx.TensorProto]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]

    @cached_property
    def captured(self) -> tuple[str, ...]:
        """Return what it reads of the graph around it."""
        own = {*self.inputs, *self.initializers, *(name for node in self.nodes for name in node.outputs)}
        read = [*(name for node in self.nodes for name in node.reads), *self.outputs]
        return tuple(dict.fromkeys(name for name in read if name and name not in own))


@dataclass(frozen=True, eq=False)
class GraphNode:
    """One operator call.

    Parameters
    ----------
    name : str
        Its name in the file, or its output's name.
    operator, domain : str
        What it calls; the domain of standard operators is empty.
    opset : int
        The version of the domain that the model or function imports.
    inputs, outputs : tuple of str
        Value names; empty where an optional one is left out.
    attributes : dict
        As stored, without defaults.
    proto : onnx.NodeProto
        The call itself, with the attributes of an enclosing function filled in.
    subgraphs : dict
        The graphs that it holds, by attribute.
    """

    name: str
    operator: str
    domain: str
    opset: int
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    attributes: Mapping[str, Attribute]
    proto: onnx.NodeProto
    subgraphs: Mapping[str, Subgraph] = field(default_factory=dict)

    @property
    def captured(self) -> tuple[str, ...]:
        """Return what the graphs that it holds read of the graph around them."""
        return tuple(name for graph in self.subgraphs.values() for name in graph.captured)

    @property
    def reads(self) -> tuple[str, ...]:
        """Return the values that it depends on: its inputs, and what its graphs read of the graph around them."""
        return (*self.inputs, *self.captured)

    def renamed(self, names: Mapping[str, str], name: str) -> GraphNode:
        """Return the call with other values, and a name of its own; in its graphs, those around them."""
        own = dict(names)
        return replace(
            self,
            name=name,
            inputs=tuple(own.get(value, value) for value in self.inputs),
            outputs=tuple(own.get(value, value) for value in self.outputs),
            subgraphs={key: _renamed(graph, own) for key, graph in self.subgraphs.items()},
        )

    @property
    def key(self) -> str:
        """Return what tells the node from all others: its first output."""
        return next(filter(None, self.outputs), self.name)

    @property
    def label(self) -> str:
        """Return how the node is called in messages."""
        operator = f"{self.domain}.{self.operator}" if self.domain else self.operator
        return f"'{self.name}' ({operator})"


def _renamed(graph: Subgraph, names: Mapping[str, str]) -> Subgraph:
    """Return a graph that reads other values of the graph around it; its own keep their names."""
    around = {name: names[name] for name in graph.captured if name in names}
    return replace(
        graph,
        nodes=tuple(node.renamed(around, node.name) for node in graph.nodes),
        outputs=tuple(around.get(name, name) for name in graph.outputs),
    )


@dataclass(frozen=True, eq=False)
class Graph:
    """The nodes that are needed, in an order in which each stands after what it reads."""

    nodes: tuple[GraphNode, ...]
    initializers: Mapping[str, onnx.TensorProto]
    inputs: Mapping[str, onnx.ValueInfoProto]
    outputs: tuple[str, ...]


@dataclass
class _Expansion:
    """The state of one expansion: collected nodes, and the functions that are being expanded."""

    functions: Mapping[tuple[str, str], onnx.FunctionProto]
    folder: Path
    nodes: list[GraphNode] = field(default_factory=list)
    calls: int = 0


def read_graph(model: onnx.ModelProto, folder: Path) -> Graph:
    """Flatten a model.

    Raises
    ------
    PolicyError
        If names are given twice, functions call themselves, an opset is unknown, or it is absurdly large.
    """
    graph = model.graph
    if not graph.node and not graph.output:
        raise PolicyError("the file holds no computation", "give an ONNX model")
    functions: dict[tuple[str, str], onnx.FunctionProto] = {}
    for function in model.functions:
        key = (_domain(function.domain), function.name)
        if key in functions:
            raise PolicyError(f"function '{function.name}' is defined twice", _REPAIR)
        functions[key] = function
    expansion = _Expansion(functions, folder)
    opsets = _opsets(model.opset_import)
    _expand(expansion, graph.node, opsets, str, "", ())
    initializers = {tensor.name: tensor for tensor in graph.initializer}
    if len(initializers) != len(graph.initializer):
        raise PolicyError("two initialisers have the same name", _REPAIR)
    inputs = {value.name: value for value in graph.input}
    if len(inputs) != len(graph.input):
        raise PolicyError("two inputs have the same name", _REPAIR)
    if len(graph.sparse_initializer):
        names = ", ".join(tensor.values.name for tensor in graph.sparse_initializer)
        raise PolicyError(f"the weights {names} are sparse tensors", "export the policy with dense weights")
    return Graph(
        tuple(expansion.nodes),
        initializers,
        {name: value for name, value in inputs.items() if name not in initializers},
        tuple(value.name for value in graph.output),
    )


def live(graph: Graph, *outputs: str) -> Graph:
    """Return the graph with the nodes alone that some values depend on, in topological order.

    Raises
    ------
    PolicyError
        If there is a cycle, a value that nothing makes, or one that is made twice.
    """
    makers = _makers(graph)
    ordered: list[GraphNode] = []
    finished: dict[str, bool] = {}  # by first output: False while the node's sources are visited
    stack: list[tuple[GraphNode, Iterator[str]]] = []

    def visit(name: str) -> None:
        node = makers.get(name)
        if node is None:
            if name not in graph.initializers and name not in graph.inputs:
                raise PolicyError(f"nothing makes the value '{name}', which the output depends on", _REPAIR)
        elif node.key not in finished:
            finished[node.key] = False
            stack.append((node, iter(node.reads)))
        elif not finished[node.key]:
            raise PolicyError(f"node {node.label} depends on its own output", _REPAIR)

    for output in outputs:
        visit(output)
        while stack:
            node, sources = stack[-1]
            source = next(sources, None)
            if source is None:
                finished[node.key] = True
                ordered.append(node)
                stack.pop()
            elif source:
                visit(source)
    used = {source for node in ordered for source in node.reads} | set(outputs)
    return Graph(
        tuple(_with_outputs(node, used) for node in ordered),
        {name: tensor for name, tensor in graph.initializers.items() if name in used},
        {name: value for name, value in graph.inputs.items() if name in used},
        outputs,
    )


def _with_outputs(node: GraphNode, used: Collection[str]) -> GraphNode:
    """Return a node without the names of outputs that nobody reads."""
    return replace(node, outputs=tuple(name if name in used else "" for name in node.outputs))


def _makers(graph: Graph) -> dict[str, GraphNode]:
    makers: dict[str, GraphNode] = {}
    for node in graph.nodes:
        for name in filter(None, node.outputs):
            if name in makers or name in graph.initializers or name in graph.inputs:
                raise PolicyError(
                    f"node {node.label} makes the value '{name}', which exists already", _REPAIR
                )
            makers[name] = node
    return makers


def _expand(
    expansion: _Expansion,
    nodes: Iterable[onnx.NodeProto],
    opsets: Mapping[str, int],
    renamed: Renamed,
    prefix: str,
    open_calls: tuple[tuple[str, str], ...],
    arguments: Mapping[str, onnx.AttributeProto] | None = None,
) -> None:
    """Append nodes with the names that their values have in the whole graph; those of inner functions get a prefix."""
    for proto in nodes:
        expansion.calls += 1
        if expansion.calls > MAX_NODES:
            raise PolicyError(f"the model has more than {MAX_NODES} nodes", "export the actor alone")
        call = onnx.NodeProto()
        call.CopyFrom(proto)
        _fill_references(call, arguments)
        del call.input[:], call.output[:]
        call.input.extend(renamed(name) for name in proto.input)
        call.output.extend(renamed(name) for name in proto.output)
        domain = _domain(proto.domain)
        key = (domain, proto.op_type)
        if key in expansion.functions:
            if key in open_calls or len(open_calls) >= MAX_DEPTH:
                raise PolicyError(f"function '{proto.op_type}' calls itself or is nested too deeply", _REPAIR)
            inner = f"{prefix}{proto.op_type}_{expansion.calls}/"
            _expand_call(expansion, call, expansion.functions[key], inner, (*open_calls, key))
        else:
            graphs = {
                attribute.name: _expand_graph(
                    expansion, attribute.g, opsets, renamed, prefix, open_calls, arguments
                )
                for attribute in call.attribute
                if attribute.type == onnx.AttributeProto.GRAPH
            }
            if graphs:
                _name_outputs(call, f"{prefix}{proto.op_type}_{expansion.calls}")
            node = graph_node(call, domain, opsets.get(domain, 0))
            expansion.nodes.append(replace(node, subgraphs=graphs) if graphs else node)


def _name_outputs(call: onnx.NodeProto, prefix: str) -> None:
    """Name the outputs that a loop or branch leaves out, on which onnxruntime crashes."""
    named = [name or f"{prefix}/unused {index}" for index, name in enumerate(call.output)]
    del call.output[:]
    call.output.extend(named)


def _expand_graph(
    expansion: _Expansion,
    graph: onnx.GraphProto,
    opsets: Mapping[str, int],
    renamed: Renamed,
    prefix: str,
    open_calls: tuple[tuple[str, str], ...],
    arguments: Mapping[str, onnx.AttributeProto] | None,
) -> Subgraph:
    """Expand the graph that a call holds, in place, with the names of its values as the caller has them."""
    if len(open_calls) >= MAX_DEPTH:
        raise PolicyError("graphs are nested too deeply", _REPAIR)
    if len(graph.sparse_initializer) or any(t.external_data for t in graph.initializer):
        raise PolicyError(
            f"the graph '{graph.name}' of a loop or branch has weights that are sparse or stand in another file",
            "export the policy with dense weights inside",
        )
    around, expansion.nodes = expansion.nodes, []
    _expand(expansion, graph.node, opsets, renamed, prefix, (*open_calls, ("", graph.name)), arguments)
    nodes, expansion.nodes = tuple(expansion.nodes), around
    del graph.node[:]
    graph.node.extend(node.proto for node in nodes)
    for value in (*graph.input, *graph.output, *graph.initializer):
        value.name = renamed(value.name)
    del graph.value_info[:]
    initializers = {tensor.name: tensor for tensor in graph.initializer}
    inputs = tuple(value.name for value in graph.input)
    return Subgraph(nodes, initializers, inputs, tuple(value.name for value in graph.output))


def _expand_call(
    expansion: _Expansion,
    call: onnx.NodeProto,
    function: onnx.FunctionProto,
    prefix: str,
    open_calls: tuple[tuple[str, str], ...],
) -> None:
    if len(call.input) > len(function.input) or len(call.output) > len(function.output):
        raise PolicyError(f"a call of function '{function.name}' has too many inputs or outputs", _REPAIR)
    names = dict(zip(function.input, call.input, strict=False))
    names.update(dict.fromkeys(function.input[len(call.input) :], ""))
    inner_outputs = dict(zip(function.output, call.output, strict=False))
    through = {name: outer for name, outer in inner_outputs.items() if outer and name in names}
    names.update((name, outer) for name, outer in inner_outputs.items() if outer and name not in names)
    arguments = {attribute.name: attribute for attribute in function.attribute_proto}
    arguments.update((attribute.name, attribute) for attribute in call.attribute)
    opsets = _opsets(function.opset_import)

    def renamed(name: str) -> str:
        return names.get(name, prefix + name) if name else ""

    _expand(expansion, function.node, opsets, renamed, prefix, open_calls, arguments)
    for name, outer in through.items():  # an output that is an input
        copy = onnx.helper.make_node("Identity", [names[name]], [outer])
        expansion.nodes.append(graph_node(copy, "", max(opsets.get("", 13), 13)))


def _fill_references(call: onnx.NodeProto, arguments: Mapping[str, onnx.AttributeProto] | None) -> None:
    kept = []
    for attribute in call.attribute:
        reference = attribute.ref_attr_name
        if reference:
            if arguments is None:
                raise PolicyError(
                    f"node '{call.name}' refers to attribute '{reference}' outside a function", _REPAIR
                )
            if reference not in arguments:
                continue
            name = attribute.name
            attribute = onnx.AttributeProto()  # a filled-in copy takes its place
            attribute.CopyFrom(arguments[reference])
            attribute.name = name
        copy = onnx.AttributeProto()
        copy.CopyFrom(attribute)
        kept.append(copy)
    del call.attribute[:]
    call.attribute.extend(kept)


def graph_node(call: onnx.NodeProto, domain: str, opset: int) -> GraphNode:
    """Return one call, with the version of its domain that defines it.

    Raises
    ------
    PolicyError
        If it has two attributes of the same name.
    """
    name = call.name or next(filter(None, call.output), call.op_type)
    attributes = {attribute.name: _attribute(attribute, name) for attribute in call.attribute}
    if len(attributes) != len(call.attribute):
        raise PolicyError(f"node '{name}' has two attributes of the same name", _REPAIR)
    return GraphNode(
        name,
        call.op_type,
        domain,
        opset,
        tuple(call.input),
        tuple(call.output),
        attributes,
        call,
    )


def _attribute(attribute: onnx.AttributeProto, node: str) -> Attribute:
    kinds = onnx.AttributeProto
    simple = {kinds.INT: "i", kinds.FLOAT: "f", kinds.INTS: "ints", kinds.FLOATS: "floats"}
    if attribute.type in simple:
        value = getattr(attribute, simple[attribute.type])
        return tuple(value) if attribute.type in (kinds.INTS, kinds.FLOATS) else value
    if attribute.type == kinds.STRING:
        return bytes(attribute.s).decode("utf-8", errors="replace")
    if attribute.type == kinds.STRINGS:
        return tuple(bytes(text).decode("utf-8", errors="replace") for text in attribute.strings)
    if attribute.type == kinds.TENSOR:
        return read_tensor(attribute.t, None)
    return f"<{kinds.AttributeType.Name(attribute.type).lower()}>"


def _domain(domain: str) -> str:
    return "" if domain == "ai.onnx" else domain


def _opsets(imports: Iterable[onnx.OperatorSetIdProto]) -> dict[str, int]:
    opsets: dict[str, int] = {}
    for entry in imports:
        domain = _domain(entry.domain)
        if opsets.setdefault(domain, entry.version) != entry.version:
            raise PolicyError(f"two versions of the opset '{domain or 'ai.onnx'}' are imported", _REPAIR)
    version = opsets.get("")
    newest = onnx.defs.onnx_opset_version()
    if version is not None and not OLDEST_OPSET <= version <= newest:
        raise PolicyError(
            f"the model uses opset {version}; viatool reads opsets {OLDEST_OPSET} to {newest} with this onnx",
            "export the policy with another opset_version, or update the onnx package",
        )
    return opsets
