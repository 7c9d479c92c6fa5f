"""Linear forms in error symbols: how far errors that are known by name move the neurons of a layer.

Every symbol is in [-1, 1]. A form holds what S of them do to N neurons, for B states at once; those of one node stay
together, so that they cancel wherever the network subtracts them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from viatool.arrays import Floats, Indices
from viatool.policy.weights import Sparse, Weights
from viatool.rounding import SLIGHTLY_MORE

MOST_SYMBOLS = 2048
"""Symbols that a model takes through an affine map."""

_FLOATS_AT_ONCE = 2**21
"""Coefficients whose absolute values are added up together."""


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

    def mapped(self, weight: Weights) -> Dense:
        """Apply ``weight`` of shape ``(N', N)``."""
        if isinstance(weight, Sparse):
            rows = weight.T.rows(self.index)
        elif self.index.shape[1] == self.size:  # every neuron, in order
            return Dense(self.radius[:, :, None] * weight.T)
        else:
            rows = np.ascontiguousarray(weight.T)[self.index]
        rows *= self.radius[:, :, None]
        return Dense(rows)

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

    def mapped(self, weight: Weights) -> Dense:
        """Apply ``weight`` of shape ``(N', N)``."""
        batch, symbols, size = self.coefficients.shape
        flat = self.coefficients.reshape(batch * symbols, size) @ weight.T
        return Dense(flat.reshape(batch, symbols, weight.shape[0]))

    def scaled(self, factor: Floats) -> Dense:
        """Multiply neuron by neuron with ``factor``, (B, N)."""
        return Dense(self.coefficients * factor[:, None, :])

    def norms(self) -> Floats:
        """Return the L1 norm of each neuron's form, (B, N)."""
        batch, symbols, size = self.coefficients.shape
        step = max(1, _FLOATS_AT_ONCE // (batch * size))
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


Form = Diagonal | Dense


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
