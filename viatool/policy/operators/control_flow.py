"""Loops and branches within one observation, unrolled: what runs is known before anything is observed.

A Loop whose condition depends on constants alone runs so many rounds; a Scan runs once for each element of a sequence
of fixed length; an If whose condition is constant has one branch. Each round becomes calls of its own, which are read
like any other; what the observation decides about is refused.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from onnx import helper

from viatool.policy.assembly import Refusal
from viatool.policy.graph import MAX_NODES, GraphNode, Subgraph, graph_node
from viatool.policy.operators.registry import Call, Result, reads
from viatool.policy.tensors import Constant, read_tensor

_FIX = "export the actor with a fixed number of rounds, and such that no branch depends on the observation"


@reads("If", 1, 11, 13, 16, 19, 21, 23, 24, 25, treatment="exact", note="constant condition")
def read_if(call: Call) -> Sequence[Result | None]:
    """Read the branch that is taken."""
    return _Run(call).branch()


@reads("Loop", 1, 11, 13, 16, 19, 21, 23, 24, 25, treatment="exact", note="as many rounds as constants say")
def read_loop(call: Call) -> Sequence[Result | None]:
    """Read all rounds of a loop."""
    return _Run(call).loop()


@reads("Scan", 9, 11, 16, 19, 21, 23, 24, 25, treatment="exact", note="sequences of fixed length")
def read_scan(call: Call) -> Sequence[Result | None]:
    """Read all rounds of a scan."""
    return _Run(call).scan()


class _Run:
    """One call, round after round; the values of each round have names of their own."""

    def __init__(self, call: Call) -> None:
        self.node, self._assembly = call.node, call.assembly
        if call.scope is None:
            raise Refusal("stands where no graph is read")
        self.scope, self._read = dict(call.scope.values), call.scope.read
        self._calls = 0

    def branch(self) -> list[Any]:
        """Read the branch of an If that is taken."""
        taken = self._truth(self._given(0), "which branch it takes")
        body = self._body("then_branch" if taken else "else_branch")
        return [self.scope.get(name) for name in self._round(body, "then" if taken else "else", [])]

    def loop(self) -> list[Any]:
        """Read all rounds of a Loop."""
        body = self._body("body")
        most = self._count(self._given(0))
        goes_on, states = self._given(1), self.node.inputs[2:]
        stacks: list[list[str]] = [[] for _ in body.outputs[1 + len(states) :]]
        number = 0
        while (most is None or number < most) and (
            goes_on is None or self._truth(goes_on, "how often it runs")
        ):
            given = [
                self._name(f"round {number}", "number", Constant(np.asarray(number, np.int64), "int64")),
                self._name(f"round {number}", "condition", Constant(np.asarray(True), "bool")),
                *states,
            ]
            condition, *made = self._round(body, f"round {number}", given)
            goes_on, states = self.scope.get(condition), tuple(made[: len(states)])
            for stack, name in zip(stacks, made[len(states) :], strict=True):
                stack.append(name)
            number += 1
        if not number and any(self.node.outputs[len(states) :]):
            raise Refusal("runs no round, so that what it collects is empty", _FIX)
        return [*(self.scope.get(name) for name in states), *(self._stacked(stack, 0) for stack in stacks)]

    def scan(self) -> list[Any]:
        """Read all rounds of a Scan."""
        body, count = self._body("body"), self._integer("num_scan_inputs")
        states, sequences = self.node.inputs[: len(self.node.inputs) - count], self.node.inputs[-count:]
        made_of_each = len(body.outputs) - len(states)
        ways, axes = self._each("scan_input_directions", count), self._each("scan_input_axes", count)
        lengths = {self._length(name, axis) for name, axis in zip(sequences, axes, strict=True)}
        if len(lengths) != 1:
            raise Refusal(f"goes through sequences of different lengths: {sorted(lengths)}")
        (length,) = lengths
        stacks: list[list[str]] = [[] for _ in range(made_of_each)]
        for number in range(length):
            label = f"round {number}"
            elements = [
                self._element(name, length - 1 - number if back else number, axis, f"{label}/element {k}")
                for k, (name, back, axis) in enumerate(zip(sequences, ways, axes, strict=True))
            ]
            made = self._round(body, label, [*states, *elements])
            states = tuple(made[: len(states)])
            for stack, name in zip(stacks, made[len(states) :], strict=True):
                stack.append(name)
        order = self._each("scan_output_directions", made_of_each)
        places = self._each("scan_output_axes", made_of_each)
        each = [
            self._stacked(stack[::-1] if back else stack, place)
            for stack, back, place in zip(stacks, order, places, strict=True)
        ]
        return [*(self.scope.get(name) for name in states), *each]

    def _round(self, body: Subgraph, label: str, given: Sequence[str]) -> list[str]:
        """Read one round of a body, and return the names of what it gives."""
        if len(given) != len(body.inputs):
            raise Refusal(f"gives {len(given)} values to a body that takes {len(body.inputs)}")
        names = dict(zip(body.inputs, given, strict=True))
        for name, tensor in body.initializers.items():
            names[name] = self._name(label, name, read_tensor(tensor, None))
        for call in body.nodes:
            for name in filter(None, call.outputs):
                names[name] = f"{self.node.key}/{label}/{name}"
            self._call(call.renamed(names, f"{self.node.name}/{label}/{call.name}"))
        return [names.get(name, name) for name in body.outputs]

    def _call(self, call: GraphNode) -> None:
        self._calls += 1
        if self._calls > MAX_NODES:
            raise Refusal(f"runs more than {MAX_NODES} calls in all its rounds", _FIX)
        missing = [name for name in call.reads if name and name not in self.scope]
        if missing:
            raise Refusal(
                f"holds the node {call.label}, which reads '{missing[0]}', which nothing made before it"
            )
        try:
            results = self._read(call, self.scope)
        except Refusal as refusal:
            raise Refusal(f"holds the node {call.label}, which {refusal.reason}", refusal.hint) from refusal
        made = zip(call.outputs, results, strict=False)
        self.scope.update((name, value) for name, value in made if name and value is not None)

    def _element(self, name: str, number: int, axis: int, label: str) -> str:
        """Return the name of one element of a sequence."""
        index = self._name(label, "index", Constant(np.asarray(number, np.int64), "int64"))
        made = f"{self.node.key}/{label}"
        self._standard("Gather", [name, index], made, axis=axis)
        return made

    def _stacked(self, names: Sequence[str], axis: int) -> Any:
        """Return values along a new axis."""
        if not names:
            return None
        parts, axes = [], f"{self.node.key}/axes"
        for number, name in enumerate(names):
            parts.append(f"{name}/unsqueezed {number}")
            self.scope[axes] = Constant(np.array([axis], dtype=np.int64), "int64")
            self._standard("Unsqueeze", [name, axes], parts[-1])
        made = f"{names[0]}/stacked"
        rank = len(self.scope[parts[0]].shape)
        self._standard("Concat", parts, made, axis=axis if axis >= 0 else axis + rank)
        return self.scope.get(made)

    def _standard(self, operator: str, inputs: Sequence[str], made: str, **attributes: Any) -> None:
        self._call(graph_node(helper.make_node(operator, list(inputs), [made], made, **attributes), "", 17))

    def _name(self, label: str, name: str, value: Constant) -> str:
        """Return the name of a constant that is put into the scope."""
        made = f"{self.node.key}/{label}/{name}"
        self.scope[made] = value
        return made

    def _given(self, index: int) -> Any:
        """Return an input; None where it is left out."""
        name = self.node.inputs[index] if index < len(self.node.inputs) else ""
        return self.scope[name] if name else None

    def _body(self, attribute: str) -> Subgraph:
        body = self.node.subgraphs.get(attribute)
        if body is None:
            raise Refusal(f"has no graph '{attribute}'", "export the policy again")
        return body

    @staticmethod
    def _truth(value: Any, what: str) -> bool:
        if not isinstance(value, Constant):
            raise Refusal(f"is control flow: the observation decides {what}", _FIX)
        if value.array.size != 1:
            raise Refusal("has a condition that is not a single number")
        return bool(value.array.ravel()[0])

    def _count(self, value: Any) -> int | None:
        """Return how many rounds a Loop has at most; None where only its condition ends it."""
        if value is None:
            return None
        if not isinstance(value, Constant):
            raise Refusal("is control flow: the observation decides how often it runs", _FIX)
        if value.array.size != 1:
            raise Refusal("has a number of rounds that is not a single number")
        return int(value.array.ravel()[0])

    def _length(self, name: str, axis: int) -> int:
        """Return how many elements a sequence has."""
        shape = getattr(self.scope[name], "shape", ())
        if not -len(shape) <= axis < len(shape):
            raise Refusal(f"goes along axis {axis} of a value of shape {list(shape)}")
        return int(shape[axis])

    def _integer(self, name: str) -> int:
        value = self.node.attributes.get(name)
        if not isinstance(value, int) or not 0 < value <= len(self.node.inputs):
            raise Refusal(f"has {name} = {value}")
        return value

    def _each(self, name: str, count: int) -> tuple[int, ...]:
        """Return an attribute that has a number for each of several values; zeros where it is left out."""
        value = self.node.attributes.get(name) or (0,) * count
        if not isinstance(value, tuple) or len(value) != count:
            raise Refusal(f"has {name} = {value} for {count} values")
        return tuple(int(entry) for entry in value)
