"""Operators that move elements about: read by running them on the elements' numbers instead of their values.

Each element of every data input gets a number; the operator itself (its reference implementation) moves the
numbers; where a number ends up, its element is copied. One rule reads the whole family, in every version, and
every copy is exact. The number 0 stands for a zero that the operator fills in.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import onnx
from numpy.typing import NDArray

from viatool.arrays import Indices
from viatool.policy.assembly import Computed, Refusal
from viatool.policy.folding import evaluate
from viatool.policy.graph import GraphNode
from viatool.policy.operators.linear import precision_of
from viatool.policy.operators.registry import Call, Value, counted, finite, reads
from viatool.policy.tensors import Constant

_EVERY = 10**6

_MOVING: dict[str, tuple[tuple[int, ...], tuple[int, ...] | int]] = {
    # operator: versions, which inputs hold data (the others are shapes, axes and indices)
    "Compress": ((9, 11, 28), (0,)),
    "Concat": ((4, 11, 13), _EVERY),
    "DepthToSpace": ((1, 11, 13, 28), (0,)),
    "Expand": ((8, 13), (0,)),
    "Flatten": ((1, 9, 11, 13, 21, 23, 24, 25), (0,)),
    "Gather": ((1, 11, 13), (0,)),
    "GatherElements": ((11, 13), (0,)),
    "GatherND": ((11, 12, 13), (0,)),
    "Identity": ((1, 13, 14, 16, 19, 21, 23, 24, 25), (0,)),
    "Pad": ((2, 11, 13, 18, 19, 21, 23, 24, 25), (0, 2)),
    "Reshape": ((5, 13, 14, 19, 21, 23, 24, 25), (0,)),
    "ReverseSequence": ((10, 28), (0,)),
    "Slice": ((1, 10, 11, 13), (0,)),
    "SpaceToDepth": ((1, 13, 28), (0,)),
    "Split": ((2, 11, 13, 18), (0,)),
    "Squeeze": ((1, 11, 13, 21, 23, 24, 25), (0,)),
    "Tile": ((6, 13), (0,)),
    "Transpose": ((1, 13, 21, 23, 24, 25), (0,)),
    "Trilu": ((14,), (0,)),
    "Unsqueeze": ((1, 11, 13, 21, 23, 24, 25), (0,)),
}


def _move(call: Call) -> Sequence[Value]:
    _, data = _MOVING[call.node.operator]
    if call.node.operator == "ReverseSequence":
        axes = (call.integer("batch_axis"), call.integer("time_axis"))
        if sorted(axes) != [0, 1]:
            raise Refusal(f"has batch_axis and time_axis {axes}, expected 0 and 1", "export the policy again")
    return move(call, range(len(call.inputs)) if isinstance(data, int) else data)


def move(call: Call, positions: Sequence[int]) -> Sequence[Value]:
    """Run an operator on element numbers; `positions` tells which inputs hold data."""
    numbers: list[NDArray[np.generic] | None] = []
    moved: list[tuple[int, Value]] = []  # first number of each data input
    following = 1
    for index in range(len(call.inputs)):
        if not call.has(index):
            numbers.append(None)
            continue
        value = call.value(index)
        if index in positions:
            size = int(np.prod(value.shape, dtype=np.int64))
            numbers.append(np.arange(following, following + size).reshape(value.shape))
            moved.append((following, value))
            following += size
        else:
            numbers.append(call.constant(index, "shape or index").array)
    if following - 1 > 2**24:
        raise Refusal("moves more elements than viatool keeps")
    results = evaluate(_filling_zeros(call.node), numbers, call.attributes)
    return [_copied(call, np.asarray(result, dtype=np.int64), moved) for result in results]


def _filling_zeros(node: GraphNode) -> GraphNode:
    """Return a node without the number that an old Pad fills in, which would pass for that of an element."""
    proto = onnx.NodeProto()
    proto.CopyFrom(node.proto)
    kept = [attribute for attribute in proto.attribute if attribute.name != "value"]
    del proto.attribute[:]
    proto.attribute.extend(kept)
    return replace(node, proto=proto)


def _copied(call: Call, result: Indices, moved: Sequence[tuple[int, Value]]) -> Computed:
    """Turn moved numbers into copies of computed elements, and constants into the bias."""
    flat = result.ravel()
    precision = precision_of([value for _, value in moved])
    fill = call.number("value") if call.node.operator == "Pad" and call.version == 2 else 0.0
    bias = np.where(flat == 0, fill, 0.0)
    terms = []
    for first, value in moved:
        size = int(np.prod(value.shape, dtype=np.int64))
        here = (flat >= first) & (flat < first + size)
        if isinstance(value, Constant) and value.roundings:
            value = call.assembly.inexact(counted(value, "constant"), precision)
        if isinstance(value, Constant):
            bias[here] = finite(value, "constant").ravel()[flat[here] - first]
        else:
            terms.append((value, np.where(here, flat - first, -1)))
    if not terms:
        raise Refusal("has no computed data", "export the policy with fixed shapes and weights")
    return call.assembly.copies(terms, bias, tuple(result.shape), precision)


for _operator, (_versions, _) in _MOVING.items():
    reads(_operator, *_versions, treatment="exact")(_move)


@reads("Dropout", 6, 7, 10, 12, 13, 22, treatment="exact", note="inference only")
def read_dropout(call: Call) -> Sequence[Value]:
    """Read the identity that dropout is outside training."""
    training = bool(call.version == 6 and not call.flag("is_test"))
    if call.has(2):
        training = bool(call.constant(2, "training mode").array.any())
    if training:
        raise Refusal("is in training mode and draws random numbers", "export the policy in evaluation mode")
    return [call.computed(0)]
