"""What onnxruntime's own operators stand for, written in operators of the standard.

Its optimiser joins nodes into operators that are not ONNX (a Gemm with its activation, a Gelu with its bias, ...). Each
stands for a few of the standard's, which are read in its place, so that readers of operators and engine know nothing
of it: what the engine counts for the parts covers the whole, which rounds no more often. What computes otherwise
(with integers of few bits inside) has no parts here and is refused by name.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import onnx
from onnx import helper

from viatool.policy.assembly import Refusal
from viatool.policy.graph import GraphNode, graph_node

DOMAIN = "com.microsoft"

_HINT = "export the operators apart: onnxruntime joined them"

_Builder = Callable[["_Body"], None]


class _Body:
    """The parts of one call, under construction."""

    def __init__(self, node: GraphNode, ranks: Sequence[int]) -> None:
        self.inputs, self.outputs = list(node.inputs), list(node.outputs)
        self.ranks = ranks
        self.attributes = node.attributes
        self.nodes: list[onnx.NodeProto] = []

    def given(self, index: int) -> str:
        """Return the name of an input, empty where it is left out."""
        return self.inputs[index] if index < len(self.inputs) else ""

    def number(self, name: str, default: float) -> float:
        """Return a floating-point attribute."""
        value = self.attributes.get(name, default)
        return float(value) if isinstance(value, int | float) else default

    def has(self, name: str) -> bool:
        """Whether a flag is set."""
        return bool(self.attributes.get(name, 0))

    def kept(self, *names: str) -> dict[str, Any]:
        """Return the attributes of these names that the call has."""
        return {name: self.attributes[name] for name in names if name in self.attributes}

    def add(self, operator: str, *inputs: str, to: int | None = None, **attributes: Any) -> str:
        """Add a node; its value is the output of that number of the call, or a new one."""
        made = f"{self.outputs[0]}/part {len(self.nodes)}" if to is None else self.outputs[to]
        self.nodes.append(helper.make_node(operator, list(inputs), [made], **attributes))
        return made

    def constant(self, value: float) -> str:
        """Add a float32 number."""
        return self.add("Constant", value_float=value)

    def transposed(self, index: int) -> str:
        """Add an input with its last two axes exchanged."""
        *rest, row, column = range(self.ranks[index])
        return self.add("Transpose", self.inputs[index], perm=[*rest, column, row])

    def sum(self, *inputs: str) -> str:
        """Add the sum of those inputs that are given."""
        first, *others = filter(None, inputs)
        for other in others:
            first = self.add("Add", first, other)
        return first

    def end(self, value: str) -> None:
        """Make a value the output."""
        self.add("Identity", value, to=0)


_ACTIVATION_PARAMETERS = {
    "Elu": ("alpha",),
    "HardSigmoid": ("alpha", "beta"),
    "LeakyRelu": ("alpha",),
    "Selu": ("alpha", "gamma"),
    "ThresholdedRelu": ("alpha",),
}
_PLAIN_ACTIVATIONS = ("Relu", "Sigmoid", "Softplus", "Softsign", "Tanh")


def _activated(body: _Body, value: str, parameters: Sequence[float] | None = None) -> None:
    """End with the activation that an attribute names; its parameters are attributes, or a list in their order."""
    operator = str(body.attributes.get("activation", ""))
    names = _ACTIVATION_PARAMETERS.get(operator, ())
    if not operator:
        body.end(value)
    elif operator == "Clip" and parameters is not None and len(parameters) == 2:
        body.add("Clip", value, *(body.constant(limit) for limit in parameters), to=0)
    elif operator in _PLAIN_ACTIVATIONS or (names and parameters is None):
        given = {name: body.attributes.get(f"activation_{name}") for name in names}
        body.add(
            operator, value, to=0, **{name: number for name, number in given.items() if number is not None}
        )
    elif names and parameters is not None and len(parameters) == len(names):
        body.add(operator, value, to=0, **dict(zip(names, parameters, strict=True)))
    else:
        raise Refusal(f"joins the activation '{operator}', which is not read there", _HINT)


def _fused_gemm(body: _Body) -> None:
    gemm = body.kept("alpha", "beta", "transA", "transB")
    _activated(body, body.add("Gemm", *body.inputs, **gemm))


def _fused_conv(body: _Body) -> None:
    names = ("auto_pad", "dilations", "group", "kernel_shape", "pads", "strides")
    value = body.add("Conv", *filter(None, body.inputs[:3]), **body.kept(*names))
    parameters = body.kept("activation_params").get("activation_params", ())
    _activated(body, body.sum(value, body.given(3)), parameters)


def _fused_matmul(body: _Body) -> None:
    if body.has("transBatchA") or body.has("transBatchB"):
        raise Refusal("moves the first axis of a product, which is not read", _HINT)
    sides = [
        body.transposed(index) if body.has(flag) else body.inputs[index]
        for index, flag in enumerate(("transA", "transB"))
    ]
    value, alpha = body.add("MatMul", *sides), body.number("alpha", 1.0)
    body.end(value if alpha == 1.0 else body.add("Mul", value, body.constant(alpha)))


def _gelu(form: str) -> _Builder:
    def build(body: _Body) -> None:
        body.add("Gelu", body.sum(*body.inputs), to=0, approximate=form)

    return build


def _quick_gelu(body: _Body) -> None:
    (x,), alpha = body.inputs, body.number("alpha", 1.702)
    scaled = x if alpha == 1.0 else body.add("Mul", x, body.constant(alpha))
    body.add("Mul", x, body.add("Sigmoid", scaled), to=0)


def _layer_normalization(body: _Body) -> None:
    body.nodes.append(
        helper.make_node(
            "LayerNormalization",
            body.inputs,
            body.outputs,
            **body.kept("axis", "epsilon", "stash_type"),
        )
    )


def _simplified(body: _Body) -> None:
    body.add("RMSNormalization", *body.inputs, to=0, **body.kept("axis", "epsilon", "stash_type"))


def _skip_layer_normalization(body: _Body) -> None:
    total = body.sum(body.given(0), body.given(1), body.given(4))
    _normalised_sum(body, "LayerNormalization", total, body.given(2), body.given(3))


def _skip_simplified(body: _Body) -> None:
    total = body.sum(body.given(0), body.given(1), body.given(3))
    _normalised_sum(body, "RMSNormalization", total, body.given(2))


_EPSILON = 1e-12
"""What onnxruntime adds to a variance where a node does not say it."""


def _normalised_sum(body: _Body, operator: str, total: str, *parameters: str) -> None:
    given = [name for name in parameters if name]
    body.add(operator, total, *given, to=0, axis=-1, epsilon=body.number("epsilon", _EPSILON))
    if len(body.outputs) > 3 and body.outputs[3]:
        body.add("Identity", total, to=3)


_FUSED: dict[tuple[str, str], tuple[int, _Builder]] = {
    ("", "LayerNormalization"): (17, _layer_normalization),
    ("", "SimplifiedLayerNormalization"): (23, _simplified),
    (DOMAIN, "BiasGelu"): (20, _gelu("none")),
    (DOMAIN, "FastGelu"): (20, _gelu("tanh")),
    (DOMAIN, "FusedConv"): (13, _fused_conv),
    (DOMAIN, "FusedGemm"): (13, _fused_gemm),
    (DOMAIN, "FusedMatMul"): (13, _fused_matmul),
    (DOMAIN, "Gelu"): (20, _gelu("none")),
    (DOMAIN, "QuickGelu"): (13, _quick_gelu),
    (DOMAIN, "SkipLayerNormalization"): (17, _skip_layer_normalization),
    (DOMAIN, "SkipSimplifiedLayerNormalization"): (23, _skip_simplified),
}
"""Version of the standard that defines the parts, and what builds them. Two operators bear the standard's domain."""

_ALSO_STANDARD = ("", "LayerNormalization")
"""In the standard since opset 17; onnxruntime writes it into older models too."""


def fused_operators() -> list[str]:
    """Return the operators that are read through their parts, with their domains."""
    return sorted(f"{domain}.{name}" if domain else name for domain, name in _FUSED)


def is_fused(node: GraphNode) -> bool:
    """Whether a node calls an operator of onnxruntime's own that is read through its parts."""
    key = (node.domain, node.operator)
    return key in _FUSED and (key != _ALSO_STANDARD or node.opset < _FUSED[key][0])


def parts_of(node: GraphNode, ranks: Sequence[int]) -> list[GraphNode]:
    """Return the calls of the standard's operators for which a call of onnxruntime's own stands.

    Parameters
    ----------
    node : GraphNode
        Such that `is_fused`.
    ranks : sequence of int
        Number of axes of each input; 0 for one that is left out.

    Returns
    -------
    list of GraphNode
        From the node's inputs to its outputs, each after what it reads.

    Raises
    ------
    Refusal
        If it stands for something that is not read.
    """
    version, build = _FUSED[node.domain, node.operator]
    body = _Body(node, ranks)
    build(body)
    return [graph_node(call, "", version) for call in body.nodes]
