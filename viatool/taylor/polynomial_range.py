"""Ranges of polynomials over the cube [-1, 1]^V, each rule sound, the tightest taken."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from viatool.taylor.basis import Basis
from viatool.taylor.rounding import SLIGHTLY_MORE

Floats = NDArray[np.float64]


def range_by_terms(linear: Floats, higher: Floats, basis: Basis) -> tuple[Floats, Floats]:
    """Enclose a polynomial term by term, squares of a variable joined with its linear term.

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
    **Sound:** yes, up to rounding, which the caller counts. A monomial with even powers only lies in [0, 1];
    a z + b z^2 has its exact range.
    """
    exponents = basis.exponents[basis.variables :]
    even = (exponents % 2 == 0).all(axis=1)
    square = even & (exponents.sum(axis=1) == 2)
    lower, upper = range_of_quadratics(linear, higher[:, square])
    rest_even = higher[:, even & ~square]
    odd = np.abs(higher[:, ~even]).sum(axis=1)
    lower = lower.sum(axis=1) + np.minimum(rest_even, 0).sum(axis=1) - odd
    upper = upper.sum(axis=1) + np.maximum(rest_even, 0).sum(axis=1) + odd
    return lower, upper


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
    """Enclose a quadratic: variables in which it is monotone go to their corner, the others are bounded by terms.

    Parameters
    ----------
    linear, higher, basis
        As for `range_by_terms`, order 2 only.

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
    upper = _corner_maximum(linear, higher, basis)
    lower = -_corner_maximum(-linear, -higher, basis)
    return lower, upper


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


def _scattered(values: Floats, target: NDArray[np.intp], variables: int) -> Floats:
    select = np.zeros((variables, target.size))
    select[target, np.arange(target.size)] = 1.0
    return np.asarray(select @ values)
