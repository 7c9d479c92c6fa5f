"""Ranges of polynomials over the cube against dense evaluation, and where they must be exact."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from viatool.taylor.basis import Basis, monomial_basis
from viatool.taylor.polynomial_range import range_by_corners, range_by_terms, range_of_univariates

Floats = NDArray[np.float64]
Rule = Callable[[Floats, Floats, Basis], tuple[Floats, Floats]]


def values(linear: Floats, higher: Floats, basis: Basis, points: Floats) -> Floats:
    """Evaluate B polynomials of N neurons at P points of the cube: (B, P, N)."""
    monomials = np.prod(points[:, None, :] ** basis.exponents[None], axis=2)
    return np.einsum("pm,bmn->bpn", monomials, np.concatenate([linear, higher], axis=1))


def cube(variables: int, count: int = 4000) -> Floats:
    random = np.random.default_rng(0)
    corners = random.choice([-1.0, 1.0], (count, variables))
    return np.concatenate([corners, random.uniform(-1, 1, (count, variables))])


@pytest.mark.parametrize("rule", [range_by_terms, range_by_corners])
@pytest.mark.parametrize(("variables", "order"), [(1, 2), (1, 5), (2, 3), (3, 4), (4, 2)])
@pytest.mark.parametrize("scale", [0.02, 1.0])
def test_every_value_lies_in_the_range(rule: Rule, variables: int, order: int, scale: float) -> None:
    random, basis = np.random.default_rng(variables + 10 * order), monomial_basis(variables, order)
    linear = random.normal(size=(20, variables, 3))
    higher = scale * random.normal(size=(20, basis.size - variables, 3))
    lower, upper = rule(linear, higher, basis)
    found = values(linear, higher, basis, cube(variables))
    assert (found.max(axis=1) <= upper + 1e-12).all()
    assert (found.min(axis=1) >= lower - 1e-12).all()


@pytest.mark.parametrize(("variables", "order"), [(3, 2), (3, 3), (2, 4)])
def test_a_polynomial_that_is_monotone_in_every_variable_has_its_exact_range(
    variables: int, order: int
) -> None:
    random, basis = np.random.default_rng(7), monomial_basis(variables, order)
    linear = random.choice([-1.0, 1.0], (10, variables, 2))
    higher = 0.3 / basis.size * random.uniform(-1, 1, (10, basis.size - variables, 2))
    lower, upper = range_by_corners(linear, higher, basis)
    corners = np.stack(np.meshgrid(*[[-1.0, 1.0]] * variables), axis=-1).reshape(-1, variables)
    found = values(linear, higher, basis, corners)
    np.testing.assert_allclose(upper, found.max(axis=1), rtol=1e-12)
    np.testing.assert_allclose(lower, found.min(axis=1), rtol=1e-12)


def test_bernstein_coefficients_see_that_powers_of_one_variable_cancel() -> None:
    # z + z^2 - z^3 - z^4 = z (1 + z) (1 - z^2): between -0.12 and 0.62 on [-1, 1]; term by term it is -2.25 to 3
    powers = [np.array([c]) for c in (1.0, 1.0, -1.0, -1.0)]
    lower, upper = range_of_univariates(powers)
    assert -1.5 < lower[0] <= -0.11
    assert 0.61 <= upper[0] < 2.5
