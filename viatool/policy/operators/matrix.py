"""Matrix products with weights on either side."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from viatool.arrays import Floats
from viatool.policy.assembly import Computed, Counted, Refusal, Term
from viatool.policy.operators.linear import scattered
from viatool.policy.operators.registry import Call, Value, counted, reads
from viatool.policy.tensors import Constant

Shape = tuple[int, ...]


@reads("MatMul", 1, 9, 13, treatment="exact", note="enclosed between two computed values")
def read_matmul(call: Call) -> Sequence[Value]:
    """Read a product of two tensors as numpy's matmul, vectors and batches of matrices included."""
    left, right = call.value(0), call.value(1)
    shape = np.matmul(np.broadcast_to(0.0, left.shape), np.broadcast_to(0.0, right.shape)).shape
    left_rows = _promoted(left, 0) if len(left.shape) == 1 else left
    right_columns = _promoted(right, 1) if len(right.shape) == 1 else right
    return [matrix_product(call, left_rows, right_columns).reshaped(shape)]


def matrix_product(
    call: Call, left: Value, right: Value, factor: float = 1.0, roundings: int = 0
) -> Computed:
    """Add ``factor * left @ right`` of tensors of rank 2 or more."""
    batch = np.broadcast_shapes(left.shape[:-2], right.shape[:-2])
    if left.shape[-1] != right.shape[-2]:
        raise Refusal(f"multiplies the shapes {list(left.shape)} and {list(right.shape)}")
    shape: Shape = (*batch, left.shape[-2], right.shape[-1])
    if isinstance(left, Computed) and isinstance(right, Computed):
        return _bilinear(call, left, right, shape, factor, roundings)
    term, inexact = _weight_term(call, left, right, factor, shape)
    bias = np.zeros(math.prod(shape))
    return call.assembly.affine([term], bias, shape, term.source.precision, roundings + inexact)


def _bilinear(
    call: Call, left: Computed, right: Computed, shape: Shape, factor: float, roundings: int
) -> Computed:
    """Add a product of two computed matrices: all products of elements, then their sums."""
    inner = left.shape[-1]
    terms: Shape = (*shape, inner)
    if math.prod(terms) * max(left.size, right.size) > 2**22:
        raise Refusal(
            f"multiplies two computed tensors {list(left.shape)} and {list(right.shape)}, which is too large"
        )
    rows = left.reshaped((*left.shape[:-1], 1, inner))
    order = np.moveaxis(np.arange(right.size).reshape(right.shape), -2, -1)  # (..., columns, inner)
    columns = call.assembly.copies(
        [(right, order.ravel())], np.zeros(right.size), order.shape, right.precision
    )
    columns = columns.reshaped((*right.shape[:-2], 1, *order.shape[-2:]))
    products = call.assembly.product(rows, columns)
    return call.assembly.linear(
        products, lambda basis: factor * basis.sum(axis=-1), shape, roundings=roundings
    )


@reads("Gemm", 6, 7, 9, 11, 13, treatment="exact", note="enclosed where A and B are both computed")
def read_gemm(call: Call) -> Sequence[Value]:
    """Read ``alpha * A' @ B' + beta * C``."""
    alpha, beta = call.number("alpha"), call.number("beta")
    left, right = (_matrix(call, index, call.flag(name)) for index, name in ((0, "transA"), (1, "transB")))
    roundings = 2 * int(abs(alpha) != 1.0 or abs(beta) != 1.0)
    shape: Shape = (left.shape[0], right.shape[1])
    bias, magnitude = np.zeros(math.prod(shape)), np.zeros(math.prod(shape))
    terms: list[Term] = []
    if call.has(2):
        addend = call.value(2)
        if np.broadcast_shapes(addend.shape, shape) != shape:
            raise Refusal(f"adds the shape {list(addend.shape)} to {list(shape)}")
        if isinstance(addend, Constant):
            constant = counted(addend, "bias")
            bias = beta * np.broadcast_to(constant.values, shape).ravel()
            magnitude = abs(beta) * np.broadcast_to(constant.magnitudes, shape).ravel()
            roundings += constant.roundings
        else:
            terms.append(Term(addend, scattered(call, addend, shape, np.full(bias.size, beta))))
    if isinstance(left, Constant) and isinstance(right, Constant):
        product_of_constants = _constant_product(left, right)
        bias = bias + alpha * product_of_constants.values.ravel()
        magnitude = magnitude + abs(alpha) * product_of_constants.magnitudes.ravel()
        roundings += product_of_constants.roundings
    elif isinstance(left, Computed) and isinstance(right, Computed):
        product = matrix_product(call, left, right, alpha, roundings)
        terms.append(Term(product, np.eye(product.size)))
    else:
        term, inexact = _weight_term(call, left, right, alpha, shape)
        terms.append(term)
        roundings += inexact
    precision = terms[-1].source.precision
    return [call.assembly.affine(terms, bias, shape, precision, roundings, bias_magnitude=magnitude)]


def _weight_term(call: Call, left: Value, right: Value, factor: float, shape: Shape) -> tuple[Term, int]:
    """Return ``factor * left @ right``, one of them constant, as a term, and the roundings of its weights."""
    x, constant = (left, right) if isinstance(left, Computed) else (right, left)
    assert isinstance(x, Computed)
    assert isinstance(constant, Constant)
    weight = counted(constant, "weight")
    source = x.reshaped(_padded(x.shape, len(shape)))

    def mapped(numbers: Floats) -> Floats:
        if x is left and source.size == source.shape[-1] and numbers.ndim == 2:
            return np.ascontiguousarray(numbers.T)  # one row times a matrix
        return call.assembly.matrix(
            source, lambda basis: basis @ numbers if x is left else numbers @ basis, shape
        )

    magnitudes = mapped(abs(factor) * weight.magnitudes) if weight.roundings else None
    return Term(source, mapped(factor * weight.values), magnitudes), weight.roundings


def _constant_product(left: Constant, right: Constant) -> Counted:
    """Return the product of two constant matrices."""
    first, second = counted(left, "weight"), counted(right, "weight")
    roundings = first.roundings + second.roundings + left.shape[-1]
    return Counted(first.values @ second.values, first.magnitudes @ second.magnitudes, roundings)


def _matrix(call: Call, index: int, transposed: bool) -> Value:
    value = call.value(index)
    if len(value.shape) != 2:
        raise Refusal(f"multiplies a tensor of shape {list(value.shape)}, where a matrix is expected")
    if not transposed:
        return value
    if isinstance(value, Constant):
        return value.rearranged(np.transpose)
    order = np.arange(value.size).reshape(value.shape).T
    return call.assembly.copies([(value, order.ravel())], np.zeros(value.size), order.shape, value.precision)


def _promoted(value: Value, axis: int) -> Value:
    shape = (1, *value.shape) if axis == 0 else (*value.shape, 1)
    if isinstance(value, Constant):
        return value.rearranged(lambda array: array.reshape(shape))
    return value.reshaped(shape)


def _padded(shape: Shape, rank: int) -> Shape:
    """Return the shape with leading ones, so that a basis axis in front does not meet a batch axis."""
    return (1,) * (rank - len(shape)) + shape
