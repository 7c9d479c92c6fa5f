"""Fewer nodes with the same finding: nodes are left out one by one for as long as it stays."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import onnx
from onnx import shape_inference

from tests.attack.graphs import RandomGraph
from tests.attack.strike import Effort, Outcome, strike_in_memory


def minimised(graph: RandomGraph, outcome: Outcome) -> RandomGraph:
    """Return a graph with a finding of the same kind, from which no single node can be left out."""
    kinds = {finding.kind for finding in outcome.findings}
    effort = Effort(exact=20 if "escape (real)" in kinds else 0)
    shrinking = True
    while shrinking:
        shrinking = False
        for model in _smaller(graph.model):
            candidate = replace(graph, model=model)
            found = strike_in_memory(candidate, effort)
            if kinds & {finding.kind for finding in found.findings}:
                graph, shrinking = candidate, True
                break
    return graph


def _smaller(model: onnx.ModelProto) -> Iterator[onnx.ModelProto]:
    """Yield models in which one node is replaced by one of its inputs of the same type and shape."""
    kinds = _types(model)
    constants = {tensor.name for tensor in model.graph.initializer}
    for index, node in reversed(list(enumerate(model.graph.node))):
        for name in node.input:
            same = name and kinds.get(name) == kinds.get(node.output[0]) is not None
            if same and name not in constants:
                smaller = onnx.ModelProto()
                smaller.CopyFrom(model)
                del smaller.graph.node[index]
                _rename(smaller, node.output[0], name)
                if smaller.graph.node:
                    yield _without_dead(smaller)


def _types(model: onnx.ModelProto) -> dict[str, str]:
    inferred = shape_inference.infer_shapes(model)
    values = [*inferred.graph.value_info, *inferred.graph.input, *inferred.graph.output]
    return {value.name: str(value.type) for value in values}


def _rename(model: onnx.ModelProto, old: str, new: str) -> None:
    for node in model.graph.node:
        for index, name in enumerate(node.input):
            if name == old:
                node.input[index] = new
    if model.graph.output[0].name == old:
        model.graph.output[0].name = new
        model.graph.output[0].type.tensor_type.ClearField("shape")


def _without_dead(model: onnx.ModelProto) -> onnx.ModelProto:
    needed = {model.graph.output[0].name}
    kept = []
    for node in reversed(model.graph.node):
        if needed & set(node.output):
            needed |= set(node.input)
            kept.append(node)
    del model.graph.node[:]
    model.graph.node.extend(reversed(kept))
    stored = [tensor for tensor in model.graph.initializer if tensor.name in needed]
    del model.graph.initializer[:]
    model.graph.initializer.extend(stored)
    return model
