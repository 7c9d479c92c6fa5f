"""Ranges of polynomials over the cube [-1, 1]^V, each rule sound, the tightest taken."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from math import comb

import numpy as np

from viatool.arrays import Floats, Indices
from viatool.rounding import SLIGHTLY_MORE
from viatool.taylor.basis import Basis


def range_by_terms(linear: Floats, higher: Floats, basis: Basis) -> tuple[Floats, Floats]:
    """Enclose a polynomial by the ranges of its one-variable parts and of its mixed terms.

    Parameters
    ----------
    linear : ndarray
        ``(B, V, N)``.
    higher : ndarray
        ``(B, M, N)``: degrees 2 to k on `basis`.

    Returns
    -------
    tuple of ndarray
        Lower and upper bounds, (B, N), without rounding.

    Notes
    -----
    **Sound:** yes, up to rounding, which the caller counts. All powers of one variable go together, see
    `range_of_univariates`; a mixed term with even powers only lies in [0, 1] times its coefficient.
    """
    exponents = basis.exponents[basis.variables :]
    pure = (exponents > 0).sum(axis=1) == 1
    degrees = exponents.sum(axis=1)
    powers = [linear, *(higher[:, pure & (degrees == degree)] for degree in range(2, basis.order + 1))]
    lower, upper = range_of_univariates(powers)
    even = (exponents % 2 == 0).all(axis=1)
    even_terms, odd_terms = higher[:, even & ~pure], np.abs(higher[:, ~even & ~pure]).sum(axis=1)
    lower = lower.sum(axis=1) + np.minimum(even_terms, 0).sum(axis=1) - odd_terms
    upper = upper.sum(axis=1) + np.maximum(even_terms, 0).sum(axis=1) + odd_terms
    return lower, upper


def range_of_univariates(powers: Sequence[Floats]) -> tuple[Floats, Floats]:
    """Enclose ``powers[0] z + powers[1] z^2 + ...`` on [-1, 1], elementwise.

    Notes
    -----
    **Sound:** yes, up to rounding. Up to degree 2 the range is exact; above, it is the hull of the Bernstein
    coefficients, met with the range of the quadratic part plus the other terms.
    """
    if len(powers) == 1:
        return -np.abs(powers[0]), np.abs(powers[0])
    lower, upper = range_of_quadratics(powers[0], powers[1])
    if len(powers) == 2:
        return lower, upper
    for degree, coefficient in enumerate(powers[2:], start=3):
        lower = lower - (np.abs(coefficient) if degree % 2 else np.maximum(-coefficient, 0))
        upper = upper + (np.abs(coefficient) if degree % 2 else np.maximum(coefficient, 0))
    control = np.tensordot(_to_bernstein(len(powers))[:, 1:], np.stack(powers), axes=1)
    return np.maximum(lower, control.min(axis=0)), np.minimum(upper, control.max(axis=0))


@lru_cache(maxsize=16)
def _to_bernstein(degree: int) -> Floats:
    """Return the matrix from coefficients of powers of z to Bernstein coefficients on [-1, 1]."""
    columns = []
    for power in range(degree + 1):  # z = 2 t - 1; coefficients of t^i; b_j = sum_i C(j,i)/C(k,i) a_i
        shifted = [comb(power, i) * 2**i * (-1) ** (power - i) for i in range(power + 1)]
        columns.append(
            [sum(a * comb(j, i) / comb(degree, i) for i, a in enumerate(shifted)) for j in range(degree + 1)]
        )
    return np.array(columns).T


def range_of_quadratics(linear: Floats, square: Floats) -> tuple[Floats, Floats]:
    """Return the exact range of ``linear z + square z^2`` on [-1, 1], elementwise."""
    ends_high = square + np.abs(linear)
    ends_low = square - np.abs(linear)
    with np.errstate(divide="ignore", invalid="ignore"):
        vertex = -(linear**2) / (4 * square)
    inside = np.abs(linear) < 2 * np.abs(square)
    lower = np.where(inside & (square > 0), vertex, ends_low)
    upper = np.where(inside & (square < 0), vertex, ends_high)
    return lower, upper


def range_by_corners(linear: Floats, higher: Floats, basis: Basis) -> tuple[Floats, Floats]:
    """Enclose a polynomial: variables in which it is monotone go to their corner, the others are bounded by terms.

    Parameters
    ----------
    linear, higher, basis
        As for `range_by_terms`.

    Returns
    -------
    tuple of ndarray
        Lower and upper bounds, (B, N), without rounding.

    Notes
    -----
    **Sound:** yes, up to rounding. Where ``|L_i| > 2|Q_ii| + sum_j |Q_ij|`` the derivative in z_i keeps its sign, so
    either extremum lies on a face z_i = +-1; cross terms with it then act linearly on the others. Repeated, since fixed
    variables make others monotone.
    """
    maximum = _corner_maximum if basis.order == 2 else _corner_maximum_of_any_order
    return -maximum(-linear, -higher, basis), maximum(linear, higher, basis)


def _corner_maximum(linear: Floats, higher: Floats, basis: Basis) -> Floats:
    first, second = basis.factors[1].T
    diagonal = first == second
    square, cross = higher[:, diagonal], higher[:, ~diagonal]
    left, right = first[~diagonal], second[~diagonal]
    incidence = np.zeros((basis.variables, left.size))
    incidence[left, np.arange(left.size)] = incidence[right, np.arange(left.size)] = 1.0
    total = np.zeros((linear.shape[0], linear.shape[2]))
    free = np.ones_like(linear)
    for _ in range(2):
        spread = incidence @ np.abs(cross) + 2 * np.abs(square)
        fixed = (free > 0) & (np.abs(linear) >= spread * SLIGHTLY_MORE)
        corner = np.where(fixed, np.where(linear >= 0, 1.0, -1.0), 0.0)
        total = total + (linear * corner + square * np.abs(corner)).sum(axis=1)
        corner_left, corner_right = corner[:, left], corner[:, right]
        total = total + (cross * corner_left * corner_right).sum(axis=1)
        moved_right = cross * corner_left * (1 - np.abs(corner_right))
        moved_left = cross * corner_right * (1 - np.abs(corner_left))
        linear = np.where(fixed, 0.0, linear)
        linear[:, :] += _scattered(moved_right, right, basis.variables) + _scattered(
            moved_left, left, basis.variables
        )
        cross = cross * (corner_left == 0) * (corner_right == 0)
        square = np.where(fixed, 0.0, square)
        free = np.where(fixed, 0.0, free)
    rest: Floats = range_of_quadratics(linear, square)[1].sum(axis=1) + np.abs(cross).sum(axis=1)
    return total + rest


def _corner_maximum_of_any_order(linear: Floats, higher: Floats, basis: Basis) -> Floats:
    exponents = basis.exponents
    coefficients = np.concatenate([linear, higher], axis=1)
    spread = np.einsum("mv,bmn->bvn", exponents[basis.variables :].astype(float), np.abs(higher))
    fixed = np.abs(linear) >= spread * SLIGHTLY_MORE
    corner = np.where(fixed, np.where(linear >= 0, 1.0, -1.0), 1.0)
    value = coefficients.copy()
    has_free, has_odd = np.zeros(value.shape, dtype=bool), np.zeros(value.shape, dtype=bool)
    for variable in range(basis.variables):
        used, odd = exponents[:, variable] > 0, exponents[:, variable] % 2 == 1
        value[:, odd] *= corner[:, variable, None]
        has_free[:, used] |= ~fixed[:, variable, None]
        has_odd[:, odd] |= ~fixed[:, variable, None]
    loose = np.where(has_odd, np.abs(coefficients), np.maximum(value, 0.0))
    return np.asarray(np.where(has_free, loose, value).sum(axis=1))


def _scattered(values: Floats, target: Indices, variables: int) -> Floats:
    select = np.zeros((variables, target.size))
    select[target, np.arange(target.size)] = 1.0
    return np.asarray(select @ values)
