"""Sums, means and extremes along axes, and the softmax."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from viatool.arrays import Floats, Indices
from viatool.policy.activations import activation
from viatool.policy.assembly import Assembly, Computed, Refusal, Term
from viatool.policy.operators.registry import Call, Value, reads
from viatool.policy.operators.variance import mean_of_squares

Shape = tuple[int, ...]

_LARGEST_SOFTMAX = 64
_LOGARITHM, _EXPONENTS = 64.0, 32.0
"""Roundings that the logarithm of a sum of exponentials errs by: of 1, for each term, and of all exponents."""


def reduced_axes(call: Call, x: Computed) -> tuple[int, ...]:
    """Return the axes of a reduction, from its attribute or, in younger opsets, from its second input."""
    axes = call.integers("axes")
    if call.has(1):
        axes = tuple(int(axis) for axis in call.constant(1, "axes").array.ravel())
    if not axes:
        return () if call.flag("noop_with_empty_axes") else tuple(range(len(x.shape)))
    return normalised_axes(axes, x)


def normalised_axes(axes: Sequence[int], x: Computed) -> tuple[int, ...]:
    """Return axes counted from the front.

    Raises
    ------
    Refusal
        If one is out of range or given twice.
    """
    rank = len(x.shape)
    counted = tuple(axis + rank if axis < 0 else axis for axis in axes)
    if len(set(counted)) != len(counted) or not all(0 <= axis < rank for axis in counted):
        raise Refusal(f"has the axes {list(axes)} for a tensor of rank {rank}")
    return counted


def summed(call: Call, x: Computed, axes: Sequence[int], *, keep: bool, mean: bool = False) -> Computed:
    """Add the sum or the mean of x along axes."""
    weights = means(call, x, axes) if mean else _sums(call, x, axes)
    shape = _reduced_shape(x, axes, keep)
    return call.assembly.affine(
        [Term(x, weights)], np.zeros(len(weights)), shape, x.precision, roundings=int(mean)
    )


def means(call: Call, x: Computed, axes: Sequence[int]) -> Floats:
    """Return the matrix ``(G, x.size)`` of the means along axes; rounded once where they are divided."""
    count = math.prod(x.shape[axis] for axis in axes)
    return _sums(call, x, axes) / count


def _sums(call: Call, x: Computed, axes: Sequence[int]) -> Floats:
    after_basis = tuple(axis + 1 for axis in axes)

    def total(basis: Floats) -> Floats:
        return np.asarray(basis.sum(axis=after_basis))

    return call.assembly.matrix(x, total, _reduced_shape(x, axes, keep=True))


def _reduced_shape(x: Computed, axes: Sequence[int], keep: bool) -> Shape:
    if keep:
        return tuple(1 if axis in axes else size for axis, size in enumerate(x.shape))
    return tuple(size for axis, size in enumerate(x.shape) if axis not in axes)


def _arguments(call: Call) -> tuple[Computed, tuple[int, ...], bool]:
    x = call.computed(0)
    return x, reduced_axes(call, x), call.flag("keepdims")


@reads("ReduceSum", 1, 11, 13, treatment="exact")
def read_reduce_sum(call: Call) -> Sequence[Value]:
    """Read a sum along axes."""
    x, axes, keep = _arguments(call)
    return [summed(call, x, axes, keep=keep)]


@reads("ReduceMean", 1, 11, 13, 18, treatment="exact")
def read_reduce_mean(call: Call) -> Sequence[Value]:
    """Read a mean along axes."""
    x, axes, keep = _arguments(call)
    shape = _reduced_shape(x, axes, keep)
    squares = mean_of_squares(call.assembly, x, means(call, x, axes), shape)
    return [squares or summed(call, x, axes, keep=keep, mean=True)]


@reads("ReduceSumSquare", 1, 11, 13, 18, treatment="enclosed")
def read_reduce_sum_square(call: Call) -> Sequence[Value]:
    """Read a sum of squares along axes."""
    x, axes, keep = _arguments(call)
    return [summed(call, call.assembly.product(x, x), axes, keep=keep)]


@reads("ReduceL2", 1, 11, 13, 18, treatment="enclosed", note="away from zero, where its slope is unbounded")
def read_reduce_l2(call: Call) -> Sequence[Value]:
    """Read a Euclidean norm along axes."""
    x, axes, keep = _arguments(call)
    return [call.assembly.activation(summed(call, call.assembly.product(x, x), axes, keep=keep), "Sqrt")]


@reads("ReduceL1", 1, 11, 13, 18, treatment="enclosed")
def read_reduce_l1(call: Call) -> Sequence[Value]:
    """Read a sum of magnitudes along axes."""
    x, axes, keep = _arguments(call)
    return [summed(call, call.assembly.activation(x, "Abs"), axes, keep=keep)]


@reads("ReduceMax", 1, 11, 12, 13, 18, 20, treatment="enclosed")
def read_reduce_max(call: Call) -> Sequence[Value]:
    """Read a largest value along axes."""
    return [_extreme(call, call.assembly.maximum)]


@reads("ReduceMin", 1, 11, 12, 13, 18, 20, treatment="enclosed")
def read_reduce_min(call: Call) -> Sequence[Value]:
    """Read a smallest value along axes."""
    return [_extreme(call, call.assembly.minimum)]


def _extreme(call: Call, combine: Callable[[Computed, Computed], Computed]) -> Computed:
    x, axes, keep = _arguments(call)
    kept = [axis for axis in range(len(x.shape)) if axis not in axes]
    order = np.arange(x.size).reshape(x.shape).transpose(*axes, *kept)
    count = math.prod(x.shape[axis] for axis in axes)
    return tournament(call, x, order.reshape(count, -1), combine).reshaped(_reduced_shape(x, axes, keep))


def tournament(
    call: Call,
    x: Computed,
    rows: Indices,
    combine: Callable[[Computed, Computed], Computed],
) -> Computed:
    """Add the extreme over the first axis of ``(K, size)`` element numbers, pair by pair."""
    if rows.shape[0] == 0:
        raise Refusal("has nothing to compare")
    if rows.shape[0] == 1:
        flat = rows[0]
        return call.assembly.copies([(x, flat)], np.zeros(flat.size), (flat.size,), x.precision)
    half = rows.shape[0] // 2
    return combine(tournament(call, x, rows[:half], combine), tournament(call, x, rows[half:], combine))


@reads("LogSoftmax", 1, 11, 13, treatment="enclosed", note=f"over at most {_LARGEST_SOFTMAX} values")
def read_log_softmax(call: Call) -> Sequence[Value]:
    """Read ``log sigmoid(x_i - log sum_j exp(x_j))`` over all j but i."""
    return [_along_axes(call, "LogSoftmax")]


@reads("Softmax", 1, 11, 13, treatment="enclosed", note=f"over at most {_LARGEST_SOFTMAX} values")
def read_softmax(call: Call) -> Sequence[Value]:
    """Read ``sigmoid(x_i - log sum_j exp(x_j))`` over all j but i."""
    return [_along_axes(call, "Softmax")]


def _along_axes(call: Call, name: str) -> Computed:
    x = call.computed(0)
    (axis,) = normalised_axes([call.integer("axis")], x)
    rank = len(x.shape)
    axes = [axis] if call.version == 13 else list(range(axis, rank))  # older ones flatten the rest
    others = [a for a in range(rank) if a not in axes]
    count = math.prod(x.shape[a] for a in axes)
    groups = np.arange(x.size).reshape(x.shape).transpose(*others, *axes).reshape(-1, count)
    return softmax_of(call.assembly, x, groups, name)


@reads("ReduceLogSumExp", 1, 11, 13, 18, treatment="enclosed", note=f"over at most {_LARGEST_SOFTMAX} values")
def read_reduce_log_sum_exp(call: Call) -> Sequence[Value]:
    """Read the logarithm of a sum of exponentials along axes."""
    x, axes, keep = _arguments(call)
    rest = [axis for axis in range(len(x.shape)) if axis not in axes]
    numbers = np.arange(x.size).reshape(x.shape).transpose([*rest, *axes])
    groups = numbers.reshape(math.prod(x.shape[axis] for axis in rest), -1)
    return [_log_sum_exp(call.assembly, x, groups, _reduced_shape(x, axes, keep))]


def _log_sum_exp(assembly: Assembly, x: Computed, numbers: Indices, shape: Shape) -> Computed:
    """Add ``log sum exp(z)`` over groups (G, K) of elements of x.

    Notes
    -----
    **Sound:** exponentials that err by 16 roundings of ``max(1, |z|)`` of their value move the logarithm of their sum
    by as much at most. After a shift by the largest element they err by 17 of ``max(1, |z - max z|)``, of which the
    mean is less than ``1 + K / e``. The sum adds K roundings, the logarithm 16 of ``max(1, |result|)`` or, shifted, of
    ``max(1, log K)``, and the shift back one of the result. Counted are ``K + 2`` times one of the result and 64, and
    32 of all ``|z|`` together, which are at least the result less ``log K``.
    """
    groups, count = numbers.shape
    if count > _LARGEST_SOFTMAX:
        raise Refusal(f"goes over {count} values, where at most {_LARGEST_SOFTMAX} are read")
    values = _selected(assembly, x, numbers)
    while values.shape[1] > 1:
        own = np.arange(values.size).reshape(values.shape)
        pairs = values.shape[1] // 2
        first, second = (_selected(assembly, values, own[:, side : 2 * pairs : 2]) for side in (0, 1))
        values = _interleaved(assembly, _soft_maximum(assembly, first, second), values, own[:, 2 * pairs :])
    magnitudes = np.zeros((groups, x.size))
    np.put_along_axis(magnitudes, numbers, _EXPONENTS / (count + 2), axis=1)
    terms = [Term(values, np.eye(groups)), Term(x, np.zeros_like(magnitudes), magnitudes)]
    return assembly.affine(
        terms, np.zeros(groups), shape, x.precision, bias_magnitude=np.full(groups, _LOGARITHM)
    )


def softmax_of(assembly: Assembly, x: Computed, numbers: Indices, name: str) -> Computed:
    """Add the softmax or its logarithm over groups (G, K) of elements of x, each of which is in one group.

    It is a function of the log-odds of every element, which increases and saturates. The log-odds are not what the
    program computes, so they carry no rounding of its precision; that of the program, which subtracts the maximum, is
    the error of the named activation.

    Raises
    ------
    Refusal
        If the groups are too large.
    """
    count = numbers.shape[1]
    if count > _LARGEST_SOFTMAX:
        raise Refusal(f"is a softmax over {count} values, where at most {_LARGEST_SOFTMAX} are read")
    if count == 1:
        return assembly.constant(float(name == "Softmax"), x.shape, x.precision)
    rest = _logarithms_of_others(assembly, _selected(assembly, x, numbers))
    assembly.reserve(x.size, x.size)
    back = np.eye(x.size)[np.argsort(numbers.ravel())]
    terms = [Term(x, np.eye(x.size)), Term(rest, -back)]
    odds = assembly.affine(terms, np.zeros(x.size), x.shape, "float64")
    return assembly.activation(replace(odds, precision=x.precision), activation(name, terms=float(count)))


def _logarithms_of_others(assembly: Assembly, x: Computed) -> Computed:
    """Add for every element of ``(G, K)`` the logarithm of the sum of the exponentials of the others of its row."""
    groups, count = x.shape
    numbers = np.arange(x.size).reshape(x.shape)
    if count == 2:
        return _selected(assembly, x, numbers[:, ::-1])
    pairs = count // 2
    first, second = numbers[:, 0 : 2 * pairs : 2], numbers[:, 1 : 2 * pairs : 2]
    joined = _soft_maximum(assembly, _selected(assembly, x, first), _selected(assembly, x, second))
    odd = count % 2
    halves = _interleaved(assembly, joined, x, numbers[:, count - odd :])
    outside = _logarithms_of_others(assembly, halves)  # of every pair
    places = np.arange(halves.size).reshape(halves.shape)
    around = _selected(assembly, outside, np.repeat(places[:, :pairs], 2, axis=1))
    siblings = np.stack([second, first], axis=2).reshape(groups, 2 * pairs)
    result = _soft_maximum(assembly, _selected(assembly, x, siblings), around)
    return _interleaved(assembly, result, outside, places[:, pairs:])


def _soft_maximum(assembly: Assembly, left: Computed, right: Computed) -> Computed:
    """Add ``log(exp(left) + exp(right)) = right + softplus(left - right)``."""
    unit, zero = np.eye(left.size), np.zeros(left.size)
    assembly.reserve(left.size, left.size)
    excess = assembly.affine([Term(left, unit), Term(right, -unit)], zero, left.shape, "float64")
    bent = assembly.activation(excess, "Softplus")
    return assembly.affine([Term(right, unit), Term(bent, unit)], zero, left.shape, "float64")


def _selected(assembly: Assembly, x: Computed, numbers: Indices) -> Computed:
    """Add copies of the elements of the given numbers, in their shape."""
    zero = np.zeros(numbers.size)
    return replace(
        assembly.copies([(x, numbers.ravel())], zero, numbers.shape, "float64"), precision="float64"
    )


def _interleaved(assembly: Assembly, x: Computed, last: Computed, numbers: Indices) -> Computed:
    """Add x, ``(G, K)``, with more columns that copy elements of another value."""
    if not numbers.size:
        return x
    own = np.arange(x.size).reshape(x.shape)
    left = np.concatenate([own, np.full(numbers.shape, -1)], axis=1)
    right = np.concatenate([np.full(own.shape, -1), numbers], axis=1)
    terms = [(x, left.ravel()), (last, right.ravel())]
    return assembly.copies(terms, np.zeros(left.size), left.shape, "float64")
