"""Quotients of exponentials with exponentials above as well: sigmoids, tanh and the softmax, spelled out.

Each is bounded whatever its parts are, so it is one function of the exponent, enclosed in its natural range. Where the
program's exponential overflows above as well as below, the quotient is not a number; a guard on the exponent refuses
what may come so far.

Notes
-----
**Sound:** with exponentials that err by 16 roundings of ``max(1, |z|)`` of their value, ``e / (b + a e)`` errs by at
most ``y (1 - y) 16 u max(1, |z|) + 4 u y <= 9 u`` times its own range, where ``y (1 - y) max(1, |z|) <= 0.28``: less
than half of what `taylor.rounding` counts for the functions here.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from viatool.arrays import Floats, Indices
from viatool.policy.activations import activation
from viatool.policy.assembly import Assembly, Computed, Term, UniformScaling, broadcast_index
from viatool.policy.network import Affine, Cast, Maximum, Precision
from viatool.policy.operators.reduction import softmax_of
from viatool.policy.weights import copies, dense, is_scaling, scale_of
from viatool.rounding import LARGEST, SMALLEST_NORMAL, UNIT_ROUNDOFF

_NEAR = 5.0
"""How far from 0 the largest exponent may be where it is not asked whether others vanish."""

_SLIGHTLY = 2.0**-6
"""By which share of themselves the constants of a program may be off that move the largest exponent."""


def of_exponentials(assembly: Assembly, numerator: Computed, divisor: Computed) -> Computed | None:
    """Return a quotient of two values that hold exponentials as a bounded function, None where it is no known one."""
    for recognise in (_softmax, _ratio, _tanh):
        result = recognise(assembly, numerator, divisor)
        if result is not None:
            return result
    return None


def log_softmax(assembly: Assembly, logits: Computed, logarithm: Computed) -> Computed | None:
    """Return ``z - log sum exp(z)``, None where the logarithm is another."""
    before, rounded = _behind_casts(assembly, logarithm)
    total = assembly.function_of(before, "Log")
    found = None if total is None else _groups_of_sum(assembly, total, logits)
    if found is None:
        return None
    groups, summed = found
    precisions = {logits.precision, rounded, summed}
    result = _in_precision_of(assembly, logits, groups, "LogSoftmax", precisions)
    return None if result is None else assembly.cast(result, logits.precision)


def _ratio(assembly: Assembly, numerator: Computed, divisor: Computed) -> Computed | None:
    """Recognise ``(p + q exp(z)) / (b + a exp(z)) = p / b + (q / a - p / b) sigmoid(z + log(a / b))``."""
    below, above = _in_exponential(assembly, divisor), _in_exponential(assembly, numerator)
    if below is None or above is None or numerator.shape != divisor.shape:
        return None
    (exponent, a, b), (same, q, p) = below, above
    if same.node != exponent.node or not (a > 0 and b > 0 and _are_moderate(divisor.precision, a, b, p, q)):
        return None
    highest = math.log(LARGEST[divisor.precision] / (a + abs(q) + 1.0)) - 1.0
    guarded = _guarded(assembly, exponent, -math.inf, highest)
    share = _sigmoid(assembly, guarded, math.log(a) - math.log(b))
    factor, offset = q / a - p / b, p / b
    weight = factor * np.eye(share.size)
    size = abs(q / a) + abs(p / b)
    return assembly.affine(
        [Term(share, weight, size * np.eye(share.size))],
        np.full(share.size, offset), numerator.shape, numerator.precision, roundings=4,
    )  # fmt: skip


def _are_moderate(precision: Precision, *numbers: float) -> bool:
    """Tell whether sums with exponentials neither overflow nor suffer from what is flushed to zero."""
    limit = (8 * UNIT_ROUNDOFF[precision] / SMALLEST_NORMAL[precision]) ** 0.25
    return all(number == 0 or 1 / limit <= abs(number) <= limit for number in numbers)


def _tanh(assembly: Assembly, numerator: Computed, divisor: Computed) -> Computed | None:
    """Recognise ``(exp(z) - exp(-z)) / (exp(z) + exp(-z))``."""
    above, below = assembly.nodes[numerator.node], assembly.nodes[divisor.node]
    if not (isinstance(above, Affine) and isinstance(below, Affine)) or numerator.shape != divisor.shape:
        return None
    if len(above.sources) != 2 or above.sources != below.sources or above.bias.any() or below.bias.any():
        return None
    if above.roundings or below.roundings or not all(is_scaling(weight) for weight in below.weights):
        return None
    for plus, minus in ((0, 1), (1, 0)):
        if is_scaling(above.weights[plus]) and is_scaling(above.weights[minus], -1.0):
            rising, falling = (
                assembly.function_of(Computed(above.sources[k], numerator.shape, numerator.precision), "Exp")
                for k in (plus, minus)
            )
            if rising is None or falling is None or not _are_opposite(assembly, rising, falling):
                return None
            limit = math.log(LARGEST[numerator.precision]) - 1.0
            return assembly.activation(_guarded(assembly, rising, -limit, limit), "SpelledTanh")
    return None


def _are_opposite(assembly: Assembly, left: Computed, right: Computed) -> bool:
    whole = UniformScaling(left, 1.0, 0.0, 0)
    scaled = [(assembly.scaling_of(x) or UniformScaling(x, 1.0, 0.0, 0)) for x in (left, right)]
    pairs = [(scaled[0], scaled[1]), (whole, scaled[1]), (scaled[0], UniformScaling(right, 1.0, 0.0, 0))]
    return any(
        a.source.node == b.source.node and a.factor == -b.factor and not (a.offset or b.offset)
        and not (a.roundings or b.roundings)
        for a, b in pairs
    )  # fmt: skip


def _softmax(assembly: Assembly, numerator: Computed, divisor: Computed) -> Computed | None:
    """Recognise ``exp(z) / sum exp(z)``."""
    above, rounded = _behind_casts(assembly, numerator)
    exponent = assembly.function_of(above, "Exp")
    found = None if exponent is None else _groups_of_sum(assembly, divisor, exponent)
    if exponent is None or found is None:
        return None
    groups, summed = found
    result = _in_precision_of(assembly, exponent, groups, "Softmax", {rounded, summed})
    return None if result is None else assembly.cast(result, numerator.precision)


def _in_precision_of(
    assembly: Assembly, exponent: Computed, groups: Indices, name: str, precisions: set[Precision]
) -> Computed | None:
    """Add a softmax or its logarithm that is computed in several precisions, as one in the coarsest of them."""
    if {"float16", "bfloat16"} <= precisions:  # neither has the other's range
        return None
    coarsest = max(precisions, key=UNIT_ROUNDOFF.__getitem__)
    return _softmax_of_parts(assembly, replace(exponent, precision=coarsest), groups, name)


def _behind_casts(assembly: Assembly, value: Computed) -> tuple[Computed, Precision]:
    """Return a value before it was cast, and the coarsest precision that it went through."""
    index, precisions = value.node, {value.precision}
    node = assembly.nodes[index]
    while isinstance(node, Cast):
        precisions.add(node.precision)
        index, node = node.source, assembly.nodes[node.source]
    precisions.add(node.precision)
    coarsest = max(precisions, key=UNIT_ROUNDOFF.__getitem__)
    return replace(value, node=index, precision=node.precision), coarsest


def _groups_of_sum(
    assembly: Assembly, divisor: Computed, exponent: Computed
) -> tuple[Indices, Precision] | None:
    """Return in which groups (G, K) of elements of z a value sums ``exp(z)``, and how coarsely; else None."""
    total, rounded = _behind_casts(assembly, divisor)
    node = assembly.nodes[total.node]
    if not isinstance(node, Affine) or len(node.sources) != 1 or node.bias.any() or node.roundings:
        return None
    terms, added = _behind_casts(assembly, Computed(node.sources[0], exponent.shape, total.precision))
    argument = assembly.function_of(terms, "Exp")
    weight = node.weights[0]
    if argument is None or argument.node != exponent.node or not copies(weight).all():
        return None
    try:
        row = broadcast_index(total, exponent.shape)
    except ValueError:
        return None
    inside = dense(weight)[row] != 0  # (N, N): what is summed for each element
    sets, member = np.unique(inside, axis=0, return_inverse=True)
    counts = sets.sum(axis=1)
    own = sets[member.ravel(), np.arange(len(inside))]
    if not own.all() or (counts != counts[0]).any() or (sets.sum(axis=0) != 1).any():
        return None
    groups = np.nonzero(sets)[1].reshape(len(sets), int(counts[0]))
    return groups, max(rounded, added, key=UNIT_ROUNDOFF.__getitem__)


def _softmax_of_parts(assembly: Assembly, exponent: Computed, groups: Indices, name: str) -> Computed:
    """Add a softmax or its logarithm, with a guard unless the largest of each group was subtracted.

    Notes
    -----
    **Sound:** without that subtraction exponentials err by ``16 max(1, |z|)`` roundings, which move a share y by
    ``2 y (1 - y)`` times as much. The logarithm of their sum errs by as much, and by 4 roundings of its own size, at
    most ``max |z| + log K``. The result also reads the exponents, with weight 0 and magnitudes that give at least that.
    Where the largest exponent is within b of 0, ``max |z|`` counts from there on, so that b takes its place; the sum is
    at least ``exp(-b)``, so that what is flushed to zero weighs ``exp(b)`` times as much.
    """
    precision, count = exponent.precision, groups.shape[1]
    highest = math.log(LARGEST[precision] / count) - 1.0
    least = math.log(SMALLEST_NORMAL[precision]) + 1.0
    share = 8.0 if name == "Softmax" else 32.0
    away = _largest_from_zero(assembly, exponent, groups)
    if away == 0.0:
        return softmax_of(assembly, exponent, groups, name)
    if away <= min(highest, _NEAR):
        flushed = 2 * count * SMALLEST_NORMAL[precision] / UNIT_ROUNDOFF[precision] * math.exp(away)
        result = softmax_of(assembly, exponent, groups, name)
        lost = np.full(
            result.size, (share * away + flushed) / 3
        )  # a copy with a constant has three roundings
        terms = [Term(result, np.eye(result.size))]
        return assembly.affine(
            terms, np.zeros(result.size), result.shape, result.precision, bias_magnitude=lost
        )
    guarded = _guarded(assembly, exponent, least, highest)
    result = softmax_of(assembly, guarded, groups, name)
    magnitudes = np.zeros((result.size, result.size))
    for group in groups:
        magnitudes[np.ix_(group, group)] = share / (count + 2)
    terms = [Term(result, np.eye(result.size)), Term(guarded, np.zeros_like(magnitudes), magnitudes)]
    return assembly.affine(terms, np.zeros(result.size), result.shape, result.precision)


def _largest_from_zero(assembly: Assembly, exponent: Computed, groups: Indices) -> float:
    """Return how far from 0 the largest exponent of a group may be, infinite where nothing is known.

    It is 0 in ``x - max(x)``, by whatever positive numbers the elements are multiplied; a constant moves it by no more
    than itself.
    """
    if _are_below_largest(assembly, exponent, groups):
        return 0.0
    node = assembly.nodes[exponent.node]
    if isinstance(node, Cast):
        return _largest_from_zero(assembly, replace(exponent, node=node.source), groups)
    if not isinstance(node, Affine) or len(node.sources) != 1:
        return math.inf
    if node.merged_weights is not None or node.merged_bias is not None:
        return math.inf
    factors = scale_of(node.weights[0])
    if factors is None:
        return math.inf
    if not (factors > 0).all() or node.roundings * UNIT_ROUNDOFF[node.precision] > _SLIGHTLY:
        return math.inf
    before = _largest_from_zero(assembly, replace(exponent, node=node.sources[0]), groups)
    return float(factors.max() * before + np.abs(node.bias).max()) * (1 + 2 * _SLIGHTLY)


def _are_below_largest(assembly: Assembly, exponent: Computed, groups: Indices) -> bool:
    node = assembly.nodes[exponent.node]
    if not isinstance(node, Affine) or len(node.sources) != 2 or node.bias.any() or node.roundings:
        return False
    for own, other in ((0, 1), (1, 0)):
        if not is_scaling(node.weights[own]):
            continue
        picked = _copied(-dense(node.weights[other]))
        if picked is None:
            return False
        return all(
            _largest_of(assembly, node.sources[other], int(picked[element]), node.sources[own]) == set(group)
            for group in groups.tolist()
            for element in group
        )
    return False


def _largest_of(assembly: Assembly, index: int, element: int, source: int) -> set[int]:
    """Return the elements of a source of which a value is the largest; empty where it is something else."""
    if index == source:
        return {element}
    node = assembly.nodes[index]
    if isinstance(node, Cast):  # one that does not round the elements
        exact = UNIT_ROUNDOFF[node.precision] <= UNIT_ROUNDOFF[assembly.nodes[source].precision]
        return _largest_of(assembly, node.source, element, source) if exact else set()
    if isinstance(node, Maximum):
        sides = [_largest_of(assembly, side, element, source) for side in (node.left, node.right)]
        return sides[0] | sides[1] if all(sides) else set()
    if isinstance(node, Affine) and len(node.sources) == 1 and not node.bias.any() and not node.roundings:
        picked = _copied(dense(node.weights[0]))
        return (
            set() if picked is None else _largest_of(assembly, node.sources[0], int(picked[element]), source)
        )
    return set()


def _copied(weight: Floats) -> Indices | None:
    """Return the column that each row of a weight copies, None where a row does something else."""
    if not np.isin(weight, (0.0, 1.0)).all() or (weight.sum(axis=1) != 1).any():
        return None
    return np.asarray(weight.argmax(axis=1))


def _in_exponential(assembly: Assembly, value: Computed) -> tuple[Computed, float, float] | None:
    """Return z, a and b of ``b + a exp(z)``, None where the value is something else."""
    exponent = assembly.function_of(value, "Exp")
    if exponent is not None:
        return exponent, 1.0, 0.0
    scaling = assembly.scaling_of(value)
    if (
        scaling is None
        or scaling.roundings
        or not (math.isfinite(scaling.factor) and math.isfinite(scaling.offset))
    ):
        return None
    exponent = assembly.function_of(scaling.source, "Exp")
    return None if exponent is None else (exponent, scaling.factor, scaling.offset)


def _sigmoid(assembly: Assembly, exponent: Computed, offset: float) -> Computed:
    """Add ``sigmoid(z + offset)``; away from 0 the exponential of the program errs by 16 roundings of its argument."""
    if offset == 0.0:
        return assembly.activation(exponent, "SpelledSigmoid")
    size = exponent.size
    argument = assembly.affine(
        [Term(exponent, np.eye(size))], np.full(size, offset), exponent.shape, exponent.precision,
        roundings=20, bias_magnitude=np.full(size, max(1.0, abs(offset))),
    )  # fmt: skip
    return assembly.activation(argument, "SpelledSigmoid")


def _guarded(assembly: Assembly, x: Computed, lowest: float, highest: float) -> Computed:
    return assembly.activation(x, activation("Guard", min=lowest, max=highest))
