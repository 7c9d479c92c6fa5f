"""Why an operator is refused, and what the user can do about it."""

from __future__ import annotations

from viatool.policy.assembly import Refusal
from viatool.policy.graph import GraphNode

# fmt: off
_STEPS = frozenset((
    "Equal", "Greater", "GreaterOrEqual", "Less", "LessOrEqual", "Not", "And", "Or", "Xor",
    "Floor", "Ceil", "Round", "Mod", "IsNaN", "IsInf",
    "BitShift", "BitwiseAnd", "BitwiseNot", "BitwiseOr", "BitwiseXor", "BitCast",
))
_QUANTISED = frozenset((
    "ConvInteger", "DequantizeLinear", "DynamicQuantizeLinear", "MatMulInteger", "QLinearConv", "QLinearMatMul",
    "QuantizeLinear",
))
# fmt: on

FAMILIES: tuple[tuple[str, str, frozenset[str]], ...] = (
    (
        "is recurrent: its result depends on earlier observations",
        "export the actor without its memory, or with the memory as part of the observation",
        frozenset(("CausalConvWithState", "LinearAttention")),
    ),
    (
        "is control flow",
        "export the actor with fixed shapes, so that no branch or loop is left",
        frozenset(("SequenceMap",)),
    ),
    (
        "is stochastic",
        "export the deterministic action (the mean), not the sampled one",
        frozenset(
            (
                "RandomNormal",
                "RandomNormalLike",
                "RandomUniform",
                "RandomUniformLike",
                "Multinomial",
                "Bernoulli",
            )
        ),
    ),
    (
        "makes a discrete choice from computed values",
        "export the continuous actions, or the values that are compared, and give their commands as `kind: choice`",
        frozenset(
            ("ArgMax", "ArgMin", "TopK", "Hardmax", "NonZero", "Unique", "NonMaxSuppression", "OneHot")
        ),
    ),
    (
        "is a step function of computed values",
        "export the actor without the comparison, or clip instead",
        _STEPS,
    ),
    (
        "computes with integers to which values were rounded: the policy is quantised",
        "verify and deploy the policy as it was before it was quantised",
        _QUANTISED,
    ),
)
"""Reason, hint and operators of each family that is refused when it meets computed values."""


# fmt: off
_OF_FEW_BITS = frozenset(("com.microsoft", name) for name in (
    "DynamicQuantizeMatMul", "MatMulInteger16", "MatMulIntegerToFloat", "MatMulNBits", "QAttention", "QGemm",
    "QLinearAdd", "QLinearConcat", "QLinearGlobalAveragePool", "QLinearLeakyRelu", "QLinearMul", "QLinearSigmoid",
    "QLinearSoftmax",
))
# fmt: on


def reason_for(node: GraphNode, version: int) -> Refusal:
    """Return why an operator is not read."""
    if (node.domain, node.operator) in _OF_FEW_BITS:
        return Refusal(
            "computes with integers of 8 bits or less, to which it rounds what it is given",
            "dequantise the weights before the export, so that the model holds them in float32",
        )
    if node.domain:
        return Refusal(
            f"is from the domain '{node.domain}', which is not ONNX",
            "export the policy with standard operators, and such that its runtime does not join them into this one",
        )
    for reason, hint, operators in FAMILIES:
        if node.operator in operators:
            return Refusal(reason, hint)
    if node.operator in ("Sin", "Cos", "Tan", "Atan", "Asin", "Acos"):
        return Refusal(
            "is a trigonometric function of computed values, which is not read",
            "compute it before the network and make it part of the observation",
        )
    return Refusal(
        f"is not read in opset version {version}",
        "export the actor alone, see docs/operators.md for what is read",
    )
