"""Comparisons and selection: by constants they copy, by computed values only known rectifiers are read."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from viatool.policy.assembly import Computed, Refusal
from viatool.policy.operators.rectifiers import Branch, rectified
from viatool.policy.operators.registry import Call, Comparison, Result, Value, finite, reads
from viatool.policy.operators.shape import move
from viatool.policy.tensors import Constant

_STEP_HINT = "export the actor without the comparison, or clip instead"
_NOTE = "as the condition of a rectifier: LeakyRelu, Elu, Threshold, torch's Softplus, the shrinkages"

_COMPARISONS: dict[str, tuple[tuple[int, ...], bool, bool]] = {
    # operator: versions, true above the bound, the bound itself counts as below
    "Greater": ((7, 9, 13), True, True),
    "GreaterOrEqual": ((12, 16), True, False),
    "Less": ((7, 9, 13), False, False),
    "LessOrEqual": ((12, 16), False, True),
}


def _compare(call: Call) -> Sequence[Result]:
    _, above, strict = _COMPARISONS[call.node.operator]
    left, right = call.value(0), call.value(1)
    if isinstance(left, Constant):  # c < x is x > c
        left, right, above, strict = right, left, not above, not strict
    if isinstance(right, Computed) or isinstance(left, Constant):
        raise Refusal("compares two computed values", _STEP_HINT)
    bounds = finite(right, "bound")
    if bounds.size != 1:
        raise Refusal("compares with several bounds", _STEP_HINT)
    return [Comparison(left, float(bounds.ravel()[0]), strict, above)]


for _operator, (_versions, _, _) in _COMPARISONS.items():
    reads(_operator, *_versions, treatment="folded", note=_NOTE)(_compare)


@reads("Or", 7, treatment="folded", note=_NOTE)
def read_or(call: Call) -> Sequence[Result]:
    """Read ``x > b or x < -b`` as ``|x| > b``, torch's Hardshrink."""
    above, below = call.inputs[:2]
    if not isinstance(above, Comparison) or not isinstance(below, Comparison):
        raise Refusal("is a step function of computed values", _STEP_HINT)
    if below.above:
        above, below = below, above
    same = above.subject.node == below.subject.node and above.bound == -below.bound
    # the comparison below holds where its opposite does not, so its strictness is the other way round
    if not same or not above.above or below.above or above.strict == below.strict or not above.bound > 0:
        raise Refusal("joins comparisons of computed values that do not make a rectifier", _STEP_HINT)
    return [Comparison(call.assembly.activation(above.subject, "Abs"), above.bound, above.strict, True)]


@reads("Where", 9, 16, treatment="exact", note="constant condition, or a rectifier")
def read_where(call: Call) -> Sequence[Value]:
    """Read a selection by a constant condition, or a rectifier written as one."""
    condition = call.inputs[0]
    if not isinstance(condition, Comparison):
        return move(call, (1, 2))
    above, below = call.value(1), call.value(2)
    if not condition.above:
        above, below = below, above
    x = condition.subject
    shape = np.broadcast_shapes(x.shape, above.shape, below.shape)
    upper, lower = _branch(above, x), _branch(below, x)
    if upper is not None and lower is not None and shape == x.shape:
        result = rectified(call.assembly, x, condition.bound, upper, lower, strict=condition.strict)
        if result is not None:
            return [result]
    raise Refusal(
        "chooses by a comparison of computed values, and is not a rectifier that is known", _STEP_HINT
    )


def _branch(value: Value, x: Computed) -> Branch | None:
    """Return a branch as a computed value or one number; None where it is neither."""
    if isinstance(value, Computed):
        return value if value.shape == x.shape else None
    numbers = finite(value, "constant")
    return float(numbers.flat[0]) if numbers.size and (numbers == numbers.flat[0]).all() else None
