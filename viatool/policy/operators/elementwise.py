"""Functions of one variable: each becomes one activation."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from viatool.policy.activations import ActivationFunction, activation
from viatool.policy.assembly import Computed, Counted, Refusal
from viatool.policy.operators.gates import reciprocal
from viatool.policy.operators.rectifiers import leaky
from viatool.policy.operators.registry import Call, Value, counted, reads

_WITHOUT_PARAMETERS: dict[str, tuple[int, ...]] = {
    "Abs": (6, 13),
    "Erf": (9, 13),
    "Exp": (6, 13),
    "HardSwish": (14, 22),
    "Log": (6, 13),
    "Mish": (18, 22),
    "Relu": (6, 13, 14),
    "Sigmoid": (6, 13),
    "Sign": (9, 13),
    "Softplus": (1, 22),
    "Softsign": (1, 22),
    "Sqrt": (6, 13),
    "Tanh": (6, 13),
}

_WITH_PARAMETERS: dict[str, tuple[tuple[int, ...], tuple[str, ...], tuple[str, ...]]] = {
    # operator: versions, parameters, those that must be positive
    "Celu": ((12, 28), ("alpha",), ("alpha",)),
    "Elu": ((6, 22), ("alpha",), ()),
    "HardSigmoid": ((6, 22), ("alpha", "beta"), ("alpha",)),
    "LeakyRelu": ((6, 16), ("alpha",), ()),
    "Selu": ((6, 22), ("alpha", "gamma"), ()),
    "ThresholdedRelu": ((10, 22), ("alpha",), ()),
}


def _declared(call: Call) -> Sequence[Value]:
    operator = call.node.operator
    _, names, positive = _WITH_PARAMETERS.get(operator, ((), (), ()))
    parameters = {name: call.number(name) for name in names}
    for name in positive:
        if parameters[name] <= 0:
            raise Refusal(f"has {name} = {parameters[name]}, where a positive number is expected")
    return [call.assembly.activation(call.computed(0), activation(operator, **parameters))]


for _operator, _versions in _WITHOUT_PARAMETERS.items():
    reads(_operator, *_versions, treatment="enclosed")(_declared)
for _operator, (_versions, _, _) in _WITH_PARAMETERS.items():
    reads(_operator, *_versions, treatment="enclosed")(_declared)


@reads("Reciprocal", 6, 13, treatment="enclosed")
def read_reciprocal(call: Call) -> Sequence[Value]:
    """Read ``1 / x``, a logistic where x is ``1 + exp(m)``."""
    return [reciprocal(call.assembly, call.computed(0))]


@reads("Gelu", 20, treatment="enclosed")
def read_gelu(call: Call) -> Sequence[Value]:
    """Read both forms of Gelu."""
    forms = {"none": "Gelu", "tanh": "GeluTanh"}
    form = forms.get(str(call.attributes.get("approximate")))
    if form is None:
        raise Refusal(
            f"has approximate = '{call.attributes.get('approximate')}', which is neither none nor tanh"
        )
    return [call.assembly.activation(call.computed(0), form)]


@reads("Swish", 24, treatment="enclosed")
def read_swish(call: Call) -> Sequence[Value]:
    """Read ``x * sigmoid(alpha * x)``; with alpha = 1 it is Silu."""
    x, alpha = call.computed(0), call.number("alpha")
    if alpha == 1.0:
        return [call.assembly.activation(x, "Silu")]
    if alpha > 0:
        return [call.assembly.activation(x, activation("Swish", slope=alpha))]
    gate = call.assembly.activation(call.assembly.scaled(x, alpha), "Sigmoid")
    return [call.assembly.product(x, gate)]


@reads("Clip", 6, 11, 12, 13, treatment="enclosed", note="constant bounds")
def read_clip(call: Call) -> Sequence[Value]:
    """Read bounds from attributes (opset 6) or inputs."""
    if call.version == 6:  # whose defaults, the largest float32 numbers, do limit a double
        return [clipped(call, call.computed(0), call.number("min"), call.number("max"))]
    x, limits = call.computed(0), [-np.inf, np.inf]
    for index, (meaning, combine) in enumerate(
        (("lower bound", call.assembly.maximum), ("upper bound", call.assembly.minimum))
    ):
        if call.has(index + 1) and call.constant(index + 1, meaning).roundings:
            limit = counted(call.constant(index + 1, meaning), meaning)
            if limit.values.size != 1:
                raise Refusal(f"has a {meaning} that is not a single number")
            x = combine(x, call.assembly.inexact(limit, x.precision).reshaped(()))
        else:
            limits[index] = call.scalar(index + 1, meaning, limits[index])
    return [clipped(call, x, *limits)]


def clipped(call: Call, x: Computed, lower: float, upper: float) -> Computed:
    """Return x limited to a range; limits may be infinite."""
    if lower > upper or lower == np.inf or upper == -np.inf:
        raise Refusal(f"clips to the empty range [{lower}, {upper}]")
    if lower == -np.inf and upper == np.inf:
        return x
    function: ActivationFunction = activation("Clip", min=lower, max=upper)
    if lower == 0 and np.isinf(upper):
        function = activation("Relu")
    return call.assembly.activation(x, function)


@reads("PRelu", 6, 7, 9, 16, treatment="enclosed")
def read_prelu(call: Call) -> Sequence[Value]:
    """Read a leaky rectifier whose slope may differ from element to element."""
    x, slopes = call.computed(0), counted(call.constant(1, "slope"), "slope")
    if call.version == 6 and slopes.values.size > 1 and len(x.shape) > 2:
        raise Refusal(
            "has a slope for each channel, which onnxruntime takes as one for each last element",
            "use opset 7",
        )
    values, magnitudes = (np.broadcast_to(part, x.shape).ravel() for part in slopes[:2])
    return [leaky(call.assembly, x, Counted(values, magnitudes, slopes.roundings, slopes.unit))]
