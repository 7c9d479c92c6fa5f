"""Bent curves as tables of small polynomials, each with a proved error.

On each cell of a grid a polynomial interpolates the value and another the slope; behind the grid a line takes their
place. So the compiled engine needs no function of a library whose error nobody proved.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from math import factorial

import numpy as np

from viatool.arrays import Floats, Indices
from viatool.policy.formulas import LONG
from viatool.rounding import ENGINE_ROUNDOFF
from viatool.taylor.approximation import residual_range
from viatool.taylor.curve import Curve
from viatool.taylor.interval import Interval, step_up

HALF, STEPS = 32, 64
"""The grid reaches from -HALF to HALF, with so many cells to a unit."""

FAR = 1e6
"""Up to where the lines behind the grid hold."""

_DEGREE, _LOW_DEGREE = 5, 3

_WORST = 1e-6
"""A table that errs by more is none."""


@dataclass(frozen=True, eq=False)
class Tabulated:
    """A curve f and its slope, by their distance t from the middle of a cell.

    Parameters
    ----------
    cells : ndarray
        ``(K, 13)``: six coefficients for f, what they err by; five for f', what they err by; lowest powers first.
    tails : ndarray
        ``(2, 5)``, left and right of the grid: slope and shift of a line, what it errs by; the slopes of f.
    """

    cells: Floats
    tails: Floats


@lru_cache(maxsize=64)
def tabulated(curve: Curve) -> Tabulated | None:
    """Tabulate a curve; None where it has no table that is good enough.

    **Sound:** yes; interpolation at Chebyshev nodes errs by ``max|f^(k+1)| (h/2)^(k+1) / (2^k (k+1)!)``, h the width of
    a cell, and by what the stored polynomial misses at the nodes, times the Lebesgue constant. The derivative is
    enclosed over each cell by interval arithmetic, on the piece to which the cell belongs.
    """
    if (curve.breaks * STEPS != np.round(curve.breaks * STEPS)).any() or (np.abs(curve.breaks) >= HALF).any():
        return None
    degree = _DEGREE if curve.operations(3) <= LONG else _LOW_DEGREE
    middles = (np.arange(2 * HALF * STEPS) + 0.5) / STEPS - HALF
    piece = np.searchsorted(curve.breaks, middles)
    value, missed = _interpolated(curve, 0, degree, middles, piece)
    slope, missed_slope = _interpolated(curve, 1, degree - 1, middles, piece)
    tails = np.array([_tail(curve, -FAR, -float(HALF)), _tail(curve, float(HALF), FAR)])
    if not (missed <= _WORST).all() or not (missed_slope <= _WORST).all() or not np.isfinite(tails).all():
        return None
    if not (tails[:, 2] <= _WORST).all():
        return None
    spare = np.zeros((_DEGREE - degree, middles.size))
    return Tabulated(np.column_stack([*value, *spare, missed, *slope, *spare, missed_slope]), tails)


def _interpolated(
    curve: Curve, derivative: int, degree: int, middles: Floats, piece: Indices
) -> tuple[Floats, Floats]:
    """Return coefficients (degree + 1, K) of f^(derivative) about the middle of each cell, and their error (K,)."""
    half = 0.5 / STEPS
    angles = (2 * np.arange(degree + 1) + 1) * np.pi / (2 * degree + 2)
    nodes = half * np.cos(angles)
    coefficients = np.empty((degree + 1, middles.size))
    error = np.empty(middles.size)
    for one in np.unique(piece).tolist():
        here = piece == one
        middle = middles[here]
        points = middle + nodes[:, None]  # exact: both are multiples of a power of two, or nearly so
        known = curve.enclose_piece(one, Interval(points.ravel(), points.ravel()), derivative)
        low, high = known.lower.reshape(points.shape), known.upper.reshape(points.shape)
        distance = points - middle
        local = np.linalg.solve(np.vander(nodes, increasing=True), low / 2 + high / 2)
        powers = np.abs(local) * half ** np.arange(degree + 1)[:, None]
        at_nodes = sum(local[j] * distance**j for j in range(degree + 1))
        off = np.maximum(high - at_nodes, at_nodes - low).max(axis=0)
        rounding = 16 * ENGINE_ROUNDOFF * powers.sum(axis=0)
        bend = curve.enclose_piece(one, Interval(middle - half, middle + half), derivative + degree + 1)
        largest = np.maximum(np.abs(bend.lower), np.abs(bend.upper))
        remainder = largest * half ** (degree + 1) / (2.0**degree * factorial(degree + 1)) * (1 + 1e-8)
        lebesgue = 2 + 2 / np.pi * np.log(degree + 1)
        coefficients[:, here] = local
        error[here] = step_up(remainder + lebesgue * (off + rounding) + rounding, 16)
    return coefficients, np.where(np.isnan(error), np.inf, error)


def _tail(curve: Curve, lower: float, upper: float) -> tuple[float, float, float, float, float]:
    """Return slope and shift of a line beside the curve on an interval, its error, and the range of the slope."""
    low, high = np.array([lower]), np.array([upper])
    slopes = curve.range(low, high, 1)
    far = high if lower > 0 else low
    slope = curve.value(far, 1)
    with np.errstate(all="ignore"):
        residual = residual_range(curve, low, high, slope)
    shift = residual.lower / 2 + residual.upper / 2
    error = step_up(np.maximum(residual.upper - shift, shift - residual.lower), 4)
    return float(slope[0]), float(shift[0]), float(error[0]), float(slopes.lower[0]), float(slopes.upper[0])
