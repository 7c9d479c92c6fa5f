"""Every kind of linear form says what its coefficients say, however it came about."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import csr_array

from viatool.policy.weights import Sparse
from viatool.taylor.forms import Dense, Diagonal, Fanned, Scattered, Stacked

BATCH, BEFORE, BETWEEN = 3, 7, 9


def diagonal(rng, symbols):
    """Symbols of some neurons of each state, of all of them in order."""
    every = [
        np.arange(BEFORE) if symbols == BEFORE else rng.permutation(BEFORE)[:symbols] for _ in range(BATCH)
    ]
    return Diagonal(np.stack(every), rng.random((BATCH, symbols)), BEFORE)


def matrix(rng, rows, columns):
    """A matrix with many zeros."""
    return rng.normal(size=(rows, columns)) * (rng.random((rows, columns)) < 0.5)


def assert_says(form, coefficients, rng):
    """Compare all that a form tells with its coefficients (B, S, N)."""
    neurons = rng.integers(0, coefficients.shape[2], (BATCH, 4))
    some = np.array([2, 0, 0])
    assert form.symbols == coefficients.shape[1]
    np.testing.assert_allclose(form.dense(), coefficients, atol=1e-14)
    np.testing.assert_allclose(form.norms(), np.abs(coefficients).sum(axis=1), atol=1e-14)
    for state, wanted in enumerate(neurons):
        np.testing.assert_allclose(form.columns(neurons)[state], coefficients[state][:, wanted].T, atol=1e-14)
    np.testing.assert_allclose(form.rows(some).dense(), coefficients[some], atol=1e-14)
    np.testing.assert_allclose(form.rows(some).norms(), np.abs(coefficients[some]).sum(axis=1), atol=1e-14)


@pytest.mark.parametrize("after", [1, 40])
@pytest.mark.parametrize("kept", [np.asarray, lambda weight: Sparse(csr_array(weight))])
@pytest.mark.parametrize("stacked", [False, True])
@pytest.mark.parametrize("symbols", [0, 3, BEFORE])
def test_forms_through_maps_and_factors_say_what_their_coefficients_say(symbols, stacked, kept, after):
    rng = np.random.default_rng(symbols)
    form = diagonal(rng, symbols)
    form = Stacked(Dense(rng.normal(size=(BATCH, 2, BEFORE))), form) if stacked else form
    first, second = matrix(rng, BETWEEN, BEFORE), matrix(rng, after, BETWEEN)
    factor = rng.normal(size=(BATCH, BETWEEN))
    coefficients = form.dense()
    assert_says(form, coefficients, rng)
    through = form.mapped(kept(first))
    coefficients = coefficients @ first.T
    assert_says(through, coefficients, rng)
    assert_says(through.mapped(second), coefficients @ second.T, rng)
    for _ in range(2):
        through, coefficients = through.scaled(factor), coefficients * factor[:, None]
        assert_says(through, coefficients, rng)
        assert_says(through.mapped(second), coefficients @ second.T, rng)
        assert_says(through.mapped(kept(second)), coefficients @ second.T, rng)


def test_what_one_map_makes_of_symbols_is_not_written_out():
    rng = np.random.default_rng(1)
    weight = matrix(rng, BETWEEN, BEFORE)
    assert isinstance(diagonal(rng, 3).mapped(weight), Fanned)
    sparse = diagonal(rng, 3).mapped(Sparse(csr_array(weight)))
    assert isinstance(sparse, Scattered)
    assert sparse.array.nnz < BATCH * 3 * BETWEEN
    assert isinstance(sparse.mapped(Sparse(csr_array(matrix(rng, 4, BETWEEN)))), Scattered)


def test_only_symbols_of_one_neuron_tell_which_they_move():
    through = diagonal(np.random.default_rng(2), 3).mapped(np.ones((2, BEFORE)))
    for form in (through, Stacked(through, through), Dense(through.dense())):
        with pytest.raises(TypeError, match="Diagonal"):
            form.moved_neurons()
