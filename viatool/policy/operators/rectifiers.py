"""Activations that exporters write as a selection by a comparison of their argument, where exactly equal."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from viatool.arrays import Floats
from viatool.policy.activations import activation
from viatool.policy.assembly import Assembly, Computed, Counted, Term
from viatool.policy.network import Affine
from viatool.policy.operators.gates import is_product
from viatool.policy.weights import is_scaling, scale_of

_LARGEST_ELU = 2.0
"""Written out, exp(x) - 1 errs by its last places where it is small, times alpha: no more than Elu's own error."""

Branch = Computed | float
Rule = Callable[[Assembly, Computed, float, Branch, Branch], Computed | None]


def rectified(
    assembly: Assembly, x: Computed, bound: float, above: Branch, below: Branch, *, strict: bool
) -> Computed | None:
    """Return ``above where x > bound else below`` as one activation, None where it is not a known one.

    Parameters
    ----------
    assembly : Assembly
        Where it goes.
    x : Computed
        What is compared.
    bound : float
        With what.
    above, below : Computed or float
        The two branches; a number stands for a constant.
    strict : bool
        Whether the bound itself takes the branch below, which matters where the function jumps.
    """
    rules = _CONTINUOUS if not strict else _CONTINUOUS + _JUMPING
    return next((r for rule in rules if (r := rule(assembly, x, bound, above, below)) is not None), None)


def _leaky(assembly: Assembly, x: Computed, bound: float, above: Branch, below: Branch) -> Computed | None:
    """Recognise Relu, LeakyRelu and PRelu: x above 0, a multiple of each element below."""
    if bound != 0 or not _is(above, x):
        return None
    if isinstance(below, float):
        return assembly.activation(x, "Relu") if below == 0 else None
    slopes = _multiples(assembly, below, x)
    return None if slopes is None else leaky(assembly, x, Counted(slopes, np.abs(slopes)))


def leaky(assembly: Assembly, x: Computed, slopes: Counted) -> Computed:
    """Add a rectifier that multiplies each element below 0 by a slope of its own, ``(x.size,)``."""
    given = slopes.values
    if (given == given[0]).all() and not slopes.roundings:
        return assembly.activation(x, activation("LeakyRelu", alpha=float(given[0])))
    assembly.reserve(x.size, x.size)
    positive, rest = assembly.activation(x, "Relu"), 1.0 - given
    exact = (rest + given == 1.0).all() and ((1.0 - rest) == given).all()
    if exact and not slopes.roundings:  # one bent term is tighter
        terms = [Term(positive, np.diag(rest)), Term(x, np.diag(given))]
    else:
        negative = assembly.activation(assembly.scaled(x, -1.0), "Relu")
        steep = Term(negative, np.diag(-given), np.diag(slopes.magnitudes))
        terms = [Term(positive, np.eye(x.size)), steep]
    return assembly.affine(terms, np.zeros(x.size), x.shape, x.precision, slopes.roundings)


def _multiples(assembly: Assembly, value: Computed, x: Computed) -> Floats | None:
    """Return by which number each element of x was multiplied to make a value, None where it was not."""
    node = assembly.nodes[value.node]
    if not isinstance(node, Affine) or node.sources != (x.node,) or node.bias.any() or node.roundings:
        return None
    if node.merged_weights is not None or node.merged_bias is not None or node.size != x.size:
        return None
    return scale_of(node.weights[0])


def _elu(assembly: Assembly, x: Computed, bound: float, above: Branch, below: Branch) -> Computed | None:
    """Recognise Elu: x above 0, ``alpha * (exp(x) - 1)`` below it."""
    if bound != 0 or not _is(above, x) or not isinstance(below, Computed):
        return None
    alpha, raised = 1.0, assembly.scaling_of(below)
    if raised is not None and raised.offset == 0 and not raised.roundings:
        alpha, raised = raised.factor, assembly.scaling_of(raised.source)
    if raised is None or (raised.factor, raised.offset, raised.roundings) != (1.0, -1.0, 0):
        return None
    argument = assembly.function_of(raised.source, "Exp")
    if argument is None or argument.node != x.node or not 0 < alpha <= _LARGEST_ELU:
        return None
    return assembly.activation(x, activation("Elu", alpha=alpha))


def _shifted(assembly: Assembly, x: Computed, bound: float, above: Branch, below: Branch) -> Computed | None:
    """Recognise ``x - bound`` on one side and 0 on the other: the halves of torch's Softshrink."""
    for line, other, function in (
        (above, below, activation("Relu")),
        (below, above, activation("Clip", max=0.0)),
    ):
        if isinstance(line, Computed) and other == 0.0:
            scaling = assembly.scaling_of(line)
            if scaling is not None and scaling.source.node == x.node and scaling.factor == 1.0:
                return assembly.activation(line, function) if scaling.offset == -bound else None
    return None


def _soft_shrink(
    assembly: Assembly, x: Computed, bound: float, above: Branch, below: Branch
) -> Computed | None:
    """Recognise ``x - bound * sign(x) where |x| > bound else 0``."""
    argument = assembly.function_of(x, "Abs")
    if argument is None or not isinstance(above, Computed) or not bound > 0 or not _is_zero(assembly, below):
        return None
    node = assembly.nodes[above.node]
    if not isinstance(node, Affine) or node.bias.any() or len(node.sources) != 2:
        return None
    weights = dict(zip(node.sources, node.weights, strict=True))
    own = weights.pop(argument.node, None)
    if own is None or len(weights) != 1:
        return None
    ((other, weight),) = weights.items()
    jump = assembly.scaling_of(Computed(other, x.shape, x.precision))
    if jump is None or jump.offset or jump.factor != bound or jump.roundings:
        return None
    sign = assembly.function_of(jump.source, "Sign")
    if sign is None or sign.node != argument.node:
        return None
    if not is_scaling(own) or not is_scaling(weight, -1.0):
        return None
    return assembly.activation(argument, activation("SoftShrink", lambd=bound))


def _softplus(assembly: Assembly, x: Computed, bound: float, above: Branch, below: Branch) -> Computed | None:
    """Recognise torch's Softplus: ``softplus(b x) / b``, and x where ``b x`` exceeds a threshold."""
    if bound <= 0 or isinstance(below, float) or isinstance(above, float):
        return None
    function = activation("SoftplusThreshold", threshold=bound)
    argument = assembly.function_of(below, "Softplus")
    if argument is not None and argument.node == x.node == above.node:
        return assembly.activation(x, function)
    steep, flat = assembly.scaling_of(x), assembly.scaling_of(below)
    if steep is None or flat is None or steep.offset or flat.offset or steep.roundings:
        return None
    argument = assembly.function_of(flat.source, "Softplus")
    if argument is None or argument.node != x.node or steep.source.node != above.node:
        return None
    if flat.factor != 1.0 / steep.factor:
        return None
    merged = int(
        not is_product(1.0, flat.factor, steep.factor)
    )  # above the threshold the program takes x itself
    return assembly.scaled(assembly.activation(x, function), flat.factor, roundings=flat.roundings + merged)


def _threshold(
    assembly: Assembly, x: Computed, bound: float, above: Branch, below: Branch
) -> Computed | None:
    """Recognise x above a bound and a number below."""
    if not _is(above, x) or not isinstance(below, float):
        return None
    if below == 0:
        return assembly.activation(x, activation("ThresholdedRelu", alpha=bound))
    return assembly.activation(x, activation("Threshold", threshold=bound, value=below))


def _hard_shrink(
    assembly: Assembly, x: Computed, bound: float, above: Branch, below: Branch
) -> Computed | None:
    """Recognise x where its magnitude exceeds a positive bound, else 0."""
    argument = assembly.function_of(x, "Abs")
    if argument is None or not _is(above, argument) or not bound > 0 or not _is_zero(assembly, below):
        return None
    return assembly.activation(argument, activation("HardShrink", lambd=bound))


def _is(branch: Branch, x: Computed) -> bool:
    return isinstance(branch, Computed) and branch.node == x.node


def _is_zero(assembly: Assembly, branch: Branch) -> bool:
    if isinstance(branch, float):
        return branch == 0
    node = assembly.nodes[branch.node]
    return isinstance(node, Affine) and not node.sources and not node.bias.any()


_CONTINUOUS: tuple[Rule, ...] = (_leaky, _elu, _shifted, _soft_shrink)
_JUMPING: tuple[Rule, ...] = (_softplus, _threshold, _hard_shrink)
"""These jump at the bound, so it matters which branch the bound itself takes."""
