"""Sums, means and extremes along axes, and the softmax."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from viatool.arrays import Floats, Indices
from viatool.policy.activations import activation
from viatool.policy.assembly import Computed, Refusal, Term
from viatool.policy.operators.registry import Call, Value, reads
from viatool.policy.operators.variance import mean_of_squares

Shape = tuple[int, ...]

_LARGEST_SOFTMAX = 64


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
    """Read ``-log sum_j exp(x_j - x_i)``."""
    total, order = _exponential_sums(call)
    logarithm = call.assembly.scaled(call.assembly.activation(total, "Log"), -1.0)
    return [_reordered(call, logarithm, order)]


@reads("Softmax", 1, 11, 13, treatment="enclosed", note=f"over at most {_LARGEST_SOFTMAX} values")
def read_softmax(call: Call) -> Sequence[Value]:
    """Read ``1 / sum_j exp(x_j - x_i)``, which needs no maximum to be subtracted."""
    total, order = _exponential_sums(call)
    return [_reordered(call, call.assembly.activation(total, "Reciprocal"), order)]


def _exponential_sums(call: Call) -> tuple[Computed, Indices]:
    """Add ``sum_j exp(x_j - x_i)`` for every element; return it and where each element of x stands in it.

    Notes
    -----
    The program subtracts the maximum m instead: its rounding of ``x_i - m`` is within that of the largest
    term here, whose weight in the sum is at least 1/K; hence 3 K roundings for each difference.
    """
    x = call.computed(0)
    (axis,) = normalised_axes([call.integer("axis")], x)
    rank = len(x.shape)
    axes = [axis] if call.version == 13 else list(range(axis, rank))  # older ones flatten the rest
    others = [a for a in range(rank) if a not in axes]
    count = math.prod(x.shape[a] for a in axes)
    if count > _LARGEST_SOFTMAX:
        raise Refusal(f"is a softmax over {count} values, where at most {_LARGEST_SOFTMAX} are read")
    numbers = np.arange(x.size).reshape(x.shape).transpose(*others, *axes).reshape(-1, count)  # (G, K)
    rows = np.broadcast_to(numbers[:, None, :], (len(numbers), count, count)).reshape(-1)  # x_j
    columns = np.broadcast_to(numbers[:, :, None], (len(numbers), count, count)).reshape(-1)  # x_i
    assembly = call.assembly
    assembly.reserve(rows.size, x.size)
    weight = np.zeros((rows.size, x.size))
    np.add.at(weight, (np.arange(rows.size), rows), 1.0)
    np.add.at(weight, (np.arange(rows.size), columns), -1.0)
    shape = (*numbers.shape, count)
    difference = assembly.affine(
        [Term(x, weight)], np.zeros(rows.size), shape, x.precision, roundings=3 * count
    )
    total = summed(call, assembly.activation(difference, activation("Exp")), [2], keep=False)
    return total, np.argsort(numbers.ravel())


def _reordered(call: Call, value: Computed, order: Indices) -> Computed:
    shape = call.computed(0).shape
    return call.assembly.copies([(value, order)], np.zeros(order.size), shape, value.precision)
