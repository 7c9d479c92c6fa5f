"""Linear forms in error symbols: how far errors that are known by name move the neurons of a layer.

Every symbol is in [-1, 1]. A form holds what S of them do to N neurons, for B states at once; those of one node stay
together, so that they cancel wherever the network subtracts them. Symbols begin as a `Diagonal`, one neuron each. What
one affine map makes of that is kept as it arises: the map beside the diagonal (`Fanned`), or, of a sparse map, what is
not zero (`Scattered`). After the next map of a `Fanned` every symbol has a coefficient for every neuron (`Dense`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from viatool.arrays import Floats, Indices
from viatool.policy.weights import Sparse, Weights, dense
from viatool.rounding import SLIGHTLY_MORE

MOST_SYMBOLS = 2048
"""Symbols that a model takes through an affine map."""

_FLOATS_AT_ONCE = 2**21
"""Coefficients whose absolute values are added up together."""

_TOUCHED = 16.0
"""Multiplications of a product of matrices that take as long as to write one coefficient and to read it again."""


@dataclass(frozen=True, eq=False)
class Diagonal:
    """Linear forms in which symbol s moves one neuron only.

    Parameters
    ----------
    index : ndarray
        ``(B, S)``: the neuron that each symbol moves; distinct within a state.
    radius : ndarray
        ``(B, S)``: by how much.
    size : int
        N neurons.
    """

    index: Indices
    radius: Floats
    size: int

    def mapped(self, weight: Weights, size: Weights | None = None) -> Fanned | Scattered:
        """Apply ``weight`` of shape ``(N', N)``, of absolute values `size` if these are at hand."""
        if isinstance(weight, Sparse):
            rows = weight.T.array[self.index.ravel()]
            rows.data *= np.repeat(self.radius.ravel(), np.diff(rows.indptr))
            return Scattered(rows, len(self.index))
        return Fanned(self, weight, np.abs(weight) if size is None else dense(size))

    def scaled(self, factor: Floats) -> Diagonal:
        """Multiply neuron by neuron with ``factor``, (B, N)."""
        return Diagonal(self.index, self.radius * np.take_along_axis(factor, self.index, axis=1), self.size)

    def norms(self) -> Floats:
        """Return the L1 norm of each neuron's form, (B, N)."""
        norms = np.zeros((self.radius.shape[0], self.size))
        np.put_along_axis(norms, self.index, np.abs(self.radius), axis=1)
        return norms

    def rows(self, which: Indices) -> Diagonal:
        """Return some of the states."""
        return Diagonal(self.index[which], self.radius[which], self.size)

    @property
    def symbols(self) -> int:
        """Return S."""
        return int(self.index.shape[1])

    def moved_neurons(self) -> Indices:
        """Return the neuron that each symbol moves, (B, S)."""
        return self.index

    def columns(self, neurons: Indices) -> Floats:
        """Return the forms of C neurons (B, C) in each state, (B, C, S)."""
        return np.where(self.index[:, None, :] == neurons[:, :, None], self.radius[:, None, :], 0.0)

    def dense(self) -> Floats:
        """Return the coefficients (B, S, N)."""
        coefficients = np.zeros((*self.index.shape, self.size))
        np.put_along_axis(coefficients, self.index[:, :, None], self.radius[:, :, None], axis=2)
        return coefficients


@dataclass(frozen=True, eq=False)
class Dense:
    """Linear forms ``(B, S, N)`` in S symbols."""

    coefficients: Floats

    def mapped(self, weight: Weights, size: Weights | None = None) -> Dense:
        """Apply ``weight`` of shape ``(N', N)``."""
        batch, symbols, neurons = self.coefficients.shape
        flat = self.coefficients.reshape(batch * symbols, neurons) @ weight.T
        return Dense(flat.reshape(batch, symbols, weight.shape[0]))

    def scaled(self, factor: Floats) -> Dense:
        """Multiply neuron by neuron with ``factor``, (B, N)."""
        return Dense(self.coefficients * factor[:, None, :])

    def norms(self) -> Floats:
        """Return the L1 norm of each neuron's form, (B, N)."""
        batch, symbols, size = self.coefficients.shape
        step = max(1, _FLOATS_AT_ONCE // max(batch * size, 1))
        if symbols <= step:
            return np.asarray(np.abs(self.coefficients).sum(axis=1))
        parts = (slice(start, start + step) for start in range(0, symbols, step))
        return sum(
            (np.abs(self.coefficients[:, part]).sum(axis=1) for part in parts), np.zeros((batch, size))
        )

    def rows(self, which: Indices) -> Dense:
        """Return some of the states."""
        return Dense(self.coefficients[which])

    @property
    def symbols(self) -> int:
        """Return S."""
        return int(self.coefficients.shape[1])

    def moved_neurons(self) -> Indices:
        """Refuse: a dense form moves every neuron."""
        raise TypeError("only the symbols of a Diagonal move one neuron each")

    def columns(self, neurons: Indices) -> Floats:
        """Return the forms of C neurons (B, C) in each state, (B, C, S)."""
        return np.swapaxes(np.take_along_axis(self.coefficients, neurons[:, None, :], axis=2), 1, 2)

    def dense(self) -> Floats:
        """Return the coefficients (B, S, N)."""
        return self.coefficients


@dataclass(frozen=True, eq=False)
class Fanned:
    """A `Diagonal` behind an affine map, and after that times a factor for each neuron.

    Parameters
    ----------
    source : Diagonal
        S symbols over n neurons.
    weight, size : ndarray
        ``(N, n)``: what it went through, and the absolute values of that.
    factor : ndarray or None
        ``(B, N)``; None for 1.
    """

    source: Diagonal
    weight: Floats
    size: Floats
    factor: Floats | None = None

    def mapped(self, weight: Weights, size: Weights | None = None) -> Dense:
        """Apply ``weight`` of shape ``(N', N)``: to every coefficient, or, if that is less, to the map before it.

        The products are the same, and so is what is allowed for their rounding.
        """
        symbols, before, after = self.symbols, self.source.size, weight.shape[0]
        if isinstance(weight, Sparse) or symbols * (after + _TOUCHED) <= after * (before + _TOUCHED):
            return Dense(self.dense()).mapped(weight)
        through = weight @ self.weight if self.factor is None else self._pulled_back(weight)
        rows = np.swapaxes(np.broadcast_to(through, (len(self.source.index), after, before)), 1, 2)
        if symbols != before:
            rows = np.take_along_axis(rows, self.source.index[:, :, None], axis=1)
        return Dense(np.ascontiguousarray(rows) * self.source.radius[:, :, None])

    def _pulled_back(self, weight: Floats) -> Floats:
        """Return ``weight`` times what is before it in each state, (B, N', n)."""
        assert self.factor is not None
        scaled = (weight * self.factor[:, None, :]).reshape(-1, weight.shape[1])
        return (scaled @ self.weight).reshape(len(self.factor), weight.shape[0], -1)

    def scaled(self, factor: Floats) -> Fanned:
        """Multiply neuron by neuron with ``factor``, (B, N)."""
        product = factor if self.factor is None else self.factor * factor
        return Fanned(self.source, self.weight, self.size, product)

    def norms(self) -> Floats:
        """Return the L1 norm of each neuron's form, (B, N)."""
        norms = self.source.norms() @ self.size.T
        return norms if self.factor is None else norms * np.abs(self.factor)

    def rows(self, which: Indices) -> Fanned:
        """Return some of the states."""
        factor = None if self.factor is None else self.factor[which]
        return Fanned(self.source.rows(which), self.weight, self.size, factor)

    @property
    def symbols(self) -> int:
        """Return S."""
        return self.source.symbols

    def moved_neurons(self) -> Indices:
        """Refuse: each symbol moves every neuron."""
        raise TypeError("only the symbols of a Diagonal move one neuron each")

    def columns(self, neurons: Indices) -> Floats:
        """Return the forms of C neurons (B, C) in each state, (B, C, S)."""
        columns = (
            self.weight[neurons[:, :, None], self.source.index[:, None, :]] * self.source.radius[:, None, :]
        )
        if self.factor is not None:
            columns *= np.take_along_axis(self.factor, neurons, axis=1)[:, :, None]
        return np.asarray(columns)

    def dense(self) -> Floats:
        """Return the coefficients (B, S, N)."""
        if self.symbols == self.source.size:  # every neuron, in order
            coefficients = self.source.radius[:, :, None] * self.weight.T
        else:
            coefficients = np.ascontiguousarray(self.weight.T)[self.source.index]
            coefficients *= self.source.radius[:, :, None]
        if self.factor is not None:
            coefficients *= self.factor[:, None, :]
        return np.asarray(coefficients)


@dataclass(frozen=True, eq=False)
class Scattered:
    """Linear forms in which every symbol moves few neurons, as behind convolutions.

    Parameters
    ----------
    array : scipy.sparse.csr_array
        ``(B S, N)``: the coefficients of each state's symbols, those of a state after those of the one before.
    batch : int
        B.
    """

    array: Any
    batch: int

    def mapped(self, weight: Weights, size: Weights | None = None) -> Scattered | Dense:
        """Apply ``weight`` of shape ``(N', N)``."""
        if isinstance(weight, Sparse):
            return Scattered(self.array @ weight.T.array, self.batch)
        return Dense((self.array @ weight.T).reshape(self.batch, self.symbols, weight.shape[0]))

    @cached_property
    def _places(self) -> Indices:
        """Where the neuron of each coefficient stands among those of all states, b N + n."""
        ends = self.array.indptr[np.arange(self.batch + 1) * self.symbols]
        state = np.repeat(np.arange(self.batch), np.diff(ends))
        return np.asarray(state * self.array.shape[1] + self.array.indices)

    def _with(self, data: Floats, places: Indices, columns: int) -> Any:
        from scipy.sparse import csr_array

        shape = (self.array.shape[0], columns)
        return csr_array((data, places, self.array.indptr), shape=shape, copy=False)

    def scaled(self, factor: Floats) -> Scattered:
        """Multiply neuron by neuron with ``factor``, (B, N)."""
        data = self.array.data * factor.ravel()[self._places]
        scaled = Scattered(self._with(data, self.array.indices, self.array.shape[1]), self.batch)
        scaled.__dict__["_places"] = self._places
        return scaled

    def norms(self) -> Floats:
        """Return the L1 norm of each neuron's form, (B, N)."""
        size = self.array.shape[1]
        sums = np.bincount(self._places, np.abs(self.array.data), minlength=self.batch * size)
        return np.asarray(sums, dtype=np.float64).reshape(self.batch, size)

    def rows(self, which: Indices) -> Scattered:
        """Return some of the states."""
        states = np.arange(self.batch)[which]
        rows = states[:, None] * self.symbols + np.arange(self.symbols)
        return Scattered(self.array[rows.ravel()], len(states))

    @property
    def symbols(self) -> int:
        """Return S."""
        return int(self.array.shape[0] // max(self.batch, 1))

    def moved_neurons(self) -> Indices:
        """Refuse: a symbol moves several neurons."""
        raise TypeError("only the symbols of a Diagonal move one neuron each")

    def columns(self, neurons: Indices) -> Floats:
        """Return the forms of C neurons (B, C) in each state, (B, C, S)."""
        from scipy.sparse import csr_array

        (batch, count), size = neurons.shape, self.array.shape[1]
        wanted = np.arange(batch)[:, None] * size + neurons
        among = np.tile(np.arange(count), batch)
        chosen = csr_array((np.ones(batch * count), (wanted.ravel(), among)), shape=(batch * size, count))
        columns = self._with(self.array.data, self._places, batch * size) @ chosen
        return np.swapaxes(columns.toarray().reshape(batch, self.symbols, count), 1, 2)

    def dense(self) -> Floats:
        """Return the coefficients (B, S, N)."""
        return np.asarray(self.array.toarray().reshape(self.batch, self.symbols, self.array.shape[1]))


@dataclass(frozen=True, eq=False)
class Stacked:
    """Linear forms in the symbols of one form, and after them those of another."""

    first: Form
    second: Form

    def mapped(self, weight: Weights, size: Weights | None = None) -> Form:
        """Apply ``weight`` of shape ``(N', N)``."""
        first, second = self.first.mapped(weight, size), self.second.mapped(weight, size)
        if isinstance(first, Dense) and isinstance(second, Dense):
            return Dense(np.concatenate([first.coefficients, second.coefficients], axis=1))
        return Stacked(first, second)

    def scaled(self, factor: Floats) -> Stacked:
        """Multiply neuron by neuron with ``factor``, (B, N)."""
        return Stacked(self.first.scaled(factor), self.second.scaled(factor))

    def norms(self) -> Floats:
        """Return the L1 norm of each neuron's form, (B, N)."""
        return self.first.norms() + self.second.norms()

    def rows(self, which: Indices) -> Stacked:
        """Return some of the states."""
        return Stacked(self.first.rows(which), self.second.rows(which))

    @property
    def symbols(self) -> int:
        """Return S."""
        return self.first.symbols + self.second.symbols

    def moved_neurons(self) -> Indices:
        """Refuse: a symbol may move several neurons."""
        raise TypeError("only the symbols of a Diagonal move one neuron each")

    def columns(self, neurons: Indices) -> Floats:
        """Return the forms of C neurons (B, C) in each state, (B, C, S)."""
        return np.concatenate([self.first.columns(neurons), self.second.columns(neurons)], axis=2)

    def dense(self) -> Floats:
        """Return the coefficients (B, S, N)."""
        return np.concatenate([self.first.dense(), self.second.dense()], axis=1)


Form = Diagonal | Dense | Fanned | Scattered | Stacked


def fold_symbols(symbols: Mapping[int, Form], remainder: Floats) -> tuple[Mapping[int, Form], Floats]:
    """Fold the symbols of whole nodes, those that weigh least, into the remainder until few enough are left.

    Without it the work on a layer grows with all layers before it. **Sound:** yes, ``|form(e)|`` is at most its norm.
    """
    excess = sum(form.symbols for form in symbols.values()) - MOST_SYMBOLS
    if excess <= 0:
        return symbols, remainder
    norms = {key: form.norms() for key, form in symbols.items()}
    kept = dict(symbols)
    for key in sorted(norms, key=lambda key: float(norms[key].sum())):
        if excess > 0:
            excess -= kept.pop(key).symbols
            remainder = (remainder + norms[key]) * SLIGHTLY_MORE
    return kept, remainder


def join_forms(left: Form | None, right: Form) -> Form:
    """Return the sum of two forms in the same symbols; None is no form."""
    return right if left is None else Dense(left.dense() + right.dense())
