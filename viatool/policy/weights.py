"""Weights of affine nodes: dense matrices, or sparse ones where they are large and nearly all zero.

A convolution over a scan of 512 rays is a matrix of many millions of entries of which one in a hundred is not zero. A
`Sparse` one takes the place of an array wherever rows of values are multiplied by weights (``values @ weights.T``,
``adjoint @ weights``); what else is asked of weights is one function here each, for both.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from viatool.arrays import Booleans, Floats, Indices

LARGEST_DENSE = 2**20
"""Entries up to which a matrix is dense in any case."""

_SPARSE = 1 / 8
"""Largest share of entries that are not zero in a sparse matrix."""

_FLOATS_AT_ONCE = 2**19
"""Numbers that are multiplied together, so that they stay in the cache."""


@dataclass(frozen=True, eq=False)
class Sparse:
    """A matrix ``(N, M)`` that keeps what is not zero.

    Parameters
    ----------
    array : scipy.sparse.csr_array
        In rows, sorted, without entries that are stored and zero.
    """

    array: Any

    __array_ufunc__ = None  # so that an array leaves ``values @ weights`` to `__rmatmul__`

    @property
    def shape(self) -> tuple[int, int]:
        """Return N and M."""
        rows, columns = self.array.shape
        return int(rows), int(columns)

    @property
    def size(self) -> int:
        """Return how many entries are kept."""
        return int(self.array.nnz)

    @cached_property
    def T(self) -> Sparse:  # noqa: N802  # as numpy calls it
        """Return the transpose (M, N)."""
        transposed = Sparse(self.array.T.tocsr())
        transposed.__dict__["T"] = self
        return transposed

    def __rmatmul__(self, values: Floats) -> Floats:
        """Return ``values @ self`` of rows of values (..., N), (..., M)."""
        rows, by_column = values.reshape(-1, self.shape[0]), self.T.array
        result = np.empty((len(rows), self.shape[1]))
        step = max(1, _FLOATS_AT_ONCE // self.shape[0])
        for start in range(0, len(rows), step):
            some = slice(start, start + step)
            result[some] = (by_column @ np.ascontiguousarray(rows[some].T)).T
        return result.reshape(*values.shape[:-1], self.shape[1])

    def __abs__(self) -> Sparse:
        """Return the absolute values."""
        return Sparse(abs(self.array))

    def dense(self) -> Floats:
        """Return the array (N, M)."""
        return np.asarray(self.array.toarray())

    def rows(self, index: Indices) -> Floats:
        """Return some rows as arrays, index (..., S) to (..., S, M)."""
        some = self.array[index.ravel()].toarray()
        return np.asarray(some.reshape(*index.shape, self.shape[1]))


Weights = Floats | Sparse


def placed(rows: Indices, columns: Indices, values: Floats, shape: tuple[int, int]) -> Weights:
    """Return the matrix with numbers at some places, each named once, and zeros elsewhere."""
    if shape[0] * shape[1] > LARGEST_DENSE and len(values) <= _SPARSE * shape[0] * shape[1]:
        from scipy.sparse import coo_array

        return _sparse(coo_array((values.astype(np.float64), (rows, columns)), shape=shape))
    matrix = np.zeros(shape)
    matrix[rows, columns] = values
    return matrix


def diagonal(values: Floats) -> Weights:
    """Return the matrix with numbers on its diagonal."""
    places = np.arange(len(values))
    return placed(places, places, values, (len(values), len(values)))


def _sparse(array: Any) -> Sparse:
    rows = array.tocsr()
    rows.sum_duplicates()
    rows.eliminate_zeros()
    return Sparse(rows)


def dense(weights: Weights) -> Floats:
    """Return weights as an array."""
    return weights.dense() if isinstance(weights, Sparse) else weights


def absolute(weights: Weights) -> Weights:
    """Return the absolute values of weights."""
    return abs(weights) if isinstance(weights, Sparse) else np.abs(weights)


def contiguous(weights: Weights) -> Weights:
    """Return weights as float64 numbers that stand row after row in memory."""
    return weights if isinstance(weights, Sparse) else np.ascontiguousarray(weights, dtype=np.float64)


def is_zero(weights: Weights) -> bool:
    """Whether all entries are zero."""
    return weights.size == 0 if isinstance(weights, Sparse) else not weights.any()


def terms(weights: Weights) -> Indices:
    """Return how many entries of each row are not zero, (N,)."""
    if isinstance(weights, Sparse):
        return np.asarray(np.diff(weights.array.indptr), dtype=np.int64)
    return np.asarray(np.count_nonzero(weights, axis=1), dtype=np.int64)


def copies(weights: Weights) -> Booleans:
    """Return which rows hold nothing but zeros and ones, (N,)."""
    if isinstance(weights, Sparse):
        return _in_all(weights, weights.array.data == 1.0)
    return np.asarray(np.isin(weights, (0.0, 1.0)).all(axis=1))


def positive_in(weights: Weights, columns: Booleans) -> Booleans:
    """Return which rows (N,) have positive entries alone, and those in some columns (M,) alone, beside zeros."""
    if isinstance(weights, Sparse):
        return _in_all(weights, (weights.array.data > 0) & columns[weights.array.indices])
    return np.asarray(((weights == 0) | ((weights > 0) & columns)).all(axis=1))


def _in_all(weights: Sparse, holds: Booleans) -> Booleans:
    """Return in which rows (N,) something holds for every entry that is kept."""
    failing = np.concatenate([[0], np.cumsum(~holds)])
    starts = weights.array.indptr
    return np.asarray(failing[starts[1:]] == failing[starts[:-1]])


def scale_of(weights: Weights) -> Floats | None:
    """Return the diagonal (N,) of a square matrix that has nothing else, None of any other."""
    if weights.shape[0] != weights.shape[1]:
        return None
    values = np.asarray(weights.array.diagonal() if isinstance(weights, Sparse) else np.diag(weights))
    if isinstance(weights, Sparse):
        return values if weights.size == np.count_nonzero(values) else None
    return values.copy() if np.array_equal(weights, np.diag(values)) else None


def is_scaling(weights: Weights, factor: float = 1.0) -> bool:
    """Whether a matrix multiplies every number by the same factor, and does nothing else."""
    factors = scale_of(weights)
    return factors is not None and bool((factors == factor).all())


def added(first: Weights, second: Weights) -> Weights:
    """Return the sum of two matrices."""
    if isinstance(first, Sparse) and isinstance(second, Sparse):
        return _sparse(first.array + second.array)
    return dense(first) + dense(second)


def overlap(first: Weights, second: Weights) -> bool:
    """Whether both have an entry that is not zero at the same place."""
    if isinstance(first, Sparse) and isinstance(second, Sparse):
        return bool(abs(first.array).multiply(abs(second.array)).nnz)
    return bool(((dense(first) != 0) & (dense(second) != 0)).any())


def same(first: Weights, second: Weights) -> bool:
    """Whether two matrices hold the same numbers."""
    if isinstance(first, Sparse) and isinstance(second, Sparse):
        return first.shape == second.shape and (first.array != second.array).nnz == 0
    return np.array_equal(dense(first), dense(second))


def digest(weights: Weights) -> tuple[object, ...]:
    """Return what compares equal for two matrices of the same kind if they are the same, bit for bit."""
    if isinstance(weights, Sparse):
        kept = weights.array
        parts = (kept.indptr.astype(np.int64), kept.indices.astype(np.int64), kept.data)
        return weights.shape, hashlib.sha256(b"".join(part.tobytes() for part in parts)).hexdigest()
    return weights.shape, hashlib.sha256(np.ascontiguousarray(weights).tobytes()).hexdigest()
