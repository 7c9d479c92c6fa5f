"""Polynomials that stay close to an activation on an interval, each with a proved error.

The polynomial is written about a given centre c: ``p(x) = sum_j coefficients[j] (x - c)^j``. Whatever rule picks the
coefficients, the error is enclosed afterwards from the curve itself, so a poor pick costs width and never soundness.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import comb, factorial
from typing import Literal

import numpy as np

from viatool.arrays import Booleans, Floats
from viatool.errors import EnclosureError
from viatool.rounding import LAST_PLACE
from viatool.taylor.curve import CONSTANT, FALLING, RISING, UNKNOWN, Curve
from viatool.taylor.interval import Interval, step_down, step_up

Approximation = Literal["chebyshev", "bernstein", "taylor"]

_NEWTON_STEPS = 6
_CLOSE = 1e-6
"""Share of an interval: a tangent that is so near to the best one is as good, but for the square of this."""
_GRID = 24


@dataclass(frozen=True, eq=False)
class Polynomial:
    """Polynomials of one variable about their centres, with error bounds.

    Parameters
    ----------
    coefficients : ndarray
        ``(k+1, ...)``, lowest power first.
    error : ndarray
        ``(...)``: ``|f(x) - p(x)| <= error`` on the interval.
    """

    coefficients: Floats
    error: Floats


def approximate_linearly(
    curve: Curve, lower: Floats, upper: Floats, rule: Approximation, centre: Floats
) -> Polynomial:
    """Approximate a curve on intervals by straight lines.

    Parameters
    ----------
    curve : Curve
        The activation.
    lower, upper, centre : ndarray
        ``(K,)`` ends of the intervals and the points about which the lines are written.
    rule : str
        ``chebyshev`` takes the slope of (nearly) least error, ``bernstein`` the chord, ``taylor`` the tangent in the
        middle.

    Returns
    -------
    Polynomial
        Coefficients ``(2, K)``, error ``(K,)``.

    Raises
    ------
    EnclosureError
        If the curve has no finite range on an interval.

    Notes
    -----
    **Sound:** yes. For any slope, the range of ``f(x) - slope*x`` is enclosed: on a convex piece it lies above each of
    its tangents and below its ends; on a concave piece the other way round; on a straight piece between its ends.
    """
    cells = curve.cells(1)
    first, last = cells.locate(lower, upper)
    straight = (first == last) & (cells.kinds[first] == CONSTANT)
    coefficients, error = _straight_lines(curve, lower, upper, cells.table[0][first, first], centre)
    bent = np.flatnonzero(~straight)
    if bent.size:
        coefficients[:, bent], error[bent] = _bent_lines(curve, lower[bent], upper[bent], rule, centre[bent])
    return Polynomial(coefficients, error)


def _straight_lines(
    curve: Curve, lower: Floats, upper: Floats, slope: Floats, centre: Floats
) -> tuple[Floats, Floats]:
    """Continue the straight piece of each interval to the centre; exact but for rounding."""
    middle = lower / 2 + upper / 2
    slope = np.where(np.isfinite(slope), slope, 0.0)
    value = curve.value(middle)
    constant = value + slope * (centre - middle)
    reach = np.abs(centre) + np.abs(middle) + (upper - lower)
    error = 8 * LAST_PLACE * (np.abs(value) + np.abs(slope) * reach)
    return np.stack([constant, slope]), error


def _bent_lines(
    curve: Curve, lower: Floats, upper: Floats, rule: Approximation, centre: Floats
) -> tuple[Floats, Floats]:
    slope = pick_slope(curve, lower, upper, rule)
    residual = residual_range(curve, lower, upper, slope)
    if not (np.isfinite(residual.lower).all() and np.isfinite(residual.upper).all()):
        worst = int(np.argmax(~np.isfinite(residual.upper - residual.lower)))
        raise EnclosureError(
            f"{curve.function.name} has no finite range on [{lower[worst]:.6g}, {upper[worst]:.6g}]",
            "make eps smaller, or check the weights before this node",
        )
    offset = residual.lower / 2 + residual.upper / 2
    radius = np.maximum(residual.upper - offset, offset - residual.lower)
    rounding = 4 * LAST_PLACE * (np.abs(offset) + np.abs(slope * centre)) + 1e-300
    return np.stack([offset + slope * centre, slope]), step_up(radius) + rounding


def pick_slope(curve: Curve, lower: Floats, upper: Floats, rule: Approximation) -> Floats:
    """Return slopes of lines that stay close to a curve on intervals, (K,); any finite ones would do."""
    middle, half = lower / 2 + upper / 2, upper / 2 - lower / 2
    if rule == "taylor":
        tangent = curve.value(middle, 1)
        return np.where(np.isfinite(tangent), tangent, 0.0)
    wide = upper - lower > 1e-9 * (np.abs(lower) + np.abs(upper)) + 1e-200
    span = np.where(wide, upper - lower, 1.0)
    chord = (curve.value(upper) - curve.value(lower)) / span
    if rule == "chebyshev" and curve.lines is None:
        first, last = curve.cells(1).locate(lower, upper)
        bends_both_ways = wide & (first != last) & ~_touches(curve.breaks, lower, upper)
        if bends_both_ways.any():
            node = np.sqrt(0.75) * half
            projected = (curve.value(middle + node) - curve.value(middle - node)) / np.where(
                wide, 2 * node, 1.0
            )
            chord = np.where(bends_both_ways, projected, chord)
    slope = chord if wide.all() else np.where(wide, chord, curve.value(middle, 1))
    return np.where(np.isfinite(slope), slope, 0.0)


def _touches(breaks: Floats, lower: Floats, upper: Floats) -> Booleans:
    first = np.searchsorted(breaks, lower, side="left")
    return np.asarray(first != np.searchsorted(breaks, upper, side="right"))


def residual_range(curve: Curve, lower: Floats, upper: Floats, slope: Floats) -> Interval:
    """Enclose ``f(x) - slope*x`` on each interval, cell by cell of constant convexity."""
    if curve.lines is not None:  # straight between the ends and where lines meet
        points = [lower, upper, *(np.clip(edge, lower, upper) for edge in curve.breaks)]
        apart = _tilted(curve, np.stack(points), slope)
        return Interval(apart.lower.min(axis=0), apart.upper.max(axis=0))
    cells = curve.cells(1)
    first, last = cells.locate(lower, upper)
    low, high = np.full(lower.shape, np.inf), np.full(lower.shape, -np.inf)
    for cell in range(int(first.min()), int(last.max()) + 1) if lower.size else ():
        here = (first <= cell) & (cell <= last)
        if not here.any():
            continue
        left = np.maximum(lower[here], cells.edges[cell]) if cell else lower[here]
        right = np.minimum(upper[here], cells.edges[cell + 1]) if cell + 1 < cells.kinds.size else upper[here]
        part = _residual_on_cell(curve, cell, left, right, slope[here])
        low[here] = np.minimum(low[here], part.lower)
        high[here] = np.maximum(high[here], part.upper)
    return Interval(low, high)


def _residual_on_cell(curve: Curve, cell: int, left: Floats, right: Floats, slope: Floats) -> Interval:
    kind = curve.cells(1).kinds[cell]
    if kind == UNKNOWN:
        return _residual_by_slope(curve, left, right, slope)
    line_left, line_right = _tilted(curve, left, slope), _tilted(curve, right, slope)
    low = np.minimum(line_left.lower, line_right.lower)
    high = np.maximum(line_left.upper, line_right.upper)
    if kind == RISING:
        low = np.minimum(low, _tangent_bound(curve, left, right, slope, 1))
    elif kind == FALLING:
        high = np.maximum(high, -_tangent_bound(curve, left, right, slope, -1))
    else:
        assert kind == CONSTANT
    return Interval(low, high)


def _residual_by_slope(curve: Curve, left: Floats, right: Floats, slope: Floats) -> Interval:
    """Enclose ``f(x) - slope*x`` by the mean value theorem from the left end, and by the ranges alone."""
    apart = curve.range(left, right) - Interval(slope, slope) * Interval(left, right)
    rise = curve.range(left, right, 1) - Interval(slope, slope)
    joint = _tilted(curve, left, slope) + rise * Interval(np.zeros_like(left), step_up(right - left))
    return Interval(np.maximum(apart.lower, joint.lower), np.minimum(apart.upper, joint.upper))


def _tilted(curve: Curve, x: Floats, slope: Floats) -> Interval:
    value, line = curve.enclose(x), slope * x
    line = np.where(np.isnan(line), 0.0, line)  # 0 * inf
    return value - Interval(step_down(line), step_up(line))


def _tangent_bound(curve: Curve, left: Floats, right: Floats, slope: Floats, sign: int) -> Floats:
    """Bound ``sign*(f(x) - slope*x)``, convex on ``[left, right]``, from below by one of its tangents."""
    point = _stationary_point(curve, left, right, slope, sign)
    value, derivative = _tilted(curve, point, slope), curve.enclose(point, 1) - Interval(slope, slope)
    if sign < 0:
        value, derivative = -value, -derivative
    ahead, behind = step_up(right - point), step_up(point - left)
    drop = np.minimum(np.minimum(derivative.lower * ahead, -derivative.upper * behind), 0.0)
    return step_down(value.lower + drop, 4)


def _stationary_point(curve: Curve, left: Floats, right: Floats, slope: Floats, sign: int) -> Floats:
    """Approach the point where ``f' = slope`` by Newton steps inside a shrinking bracket."""
    low, high, point = left, right, left / 2 + right / 2
    for _ in range(_NEWTON_STEPS):
        excess = sign * (curve.value(point, 1) - slope)
        low, high = np.where(excess < 0, point, low), np.where(excess > 0, point, high)
        with np.errstate(all="ignore"):
            step = point - excess / (sign * curve.value(point, 2))
        middle, before = low / 2 + high / 2, point
        point = np.where((step >= low) & (step <= high), step, middle)
        if (np.abs(point - before) <= _CLOSE * (right - left)).all():
            break
    return np.clip(point, left, right)


def approximate(
    curve: Curve, lower: Floats, upper: Floats, degree: int, rule: Approximation, centre: Floats
) -> Polynomial:
    """Approximate a curve on intervals by polynomials of a degree.

    Parameters
    ----------
    curve : Curve
        The activation.
    lower, upper, centre : ndarray
        ``(K,)`` ends of the intervals and the points about which the polynomials are written.
    degree : int
        At least 1.
    rule : str
        ``chebyshev`` interpolates at the Chebyshev nodes, ``bernstein`` is the Bernstein polynomial (as POLAR uses),
        ``taylor`` the Taylor polynomial in the middle.

    Returns
    -------
    Polynomial
        Coefficients ``(degree+1, K)``, error ``(K,)``; where a line does better, the line.

    Raises
    ------
    EnclosureError
        If an end is not a number, or the curve has no finite range on an interval.

    Notes
    -----
    **Sound:** yes. For Chebyshev nodes inside one smooth piece the error is the interpolation remainder
    ``max|f^(k+1)| h^(k+1) / (2^k (k+1)!)``; else ``f - p`` is enclosed on a grid, with its curvature between the nodes.
    """
    if np.isnan(lower).any() or np.isnan(upper).any():
        raise EnclosureError(
            f"nothing is known of the argument of {curve.function.name}: its bounds overflowed",
            "make eps smaller, or check the weights before this node",
        )
    line = approximate_linearly(curve, lower, upper, rule, centre)
    if degree == 1 or not lower.size:
        return line
    middle, half = lower / 2 + upper / 2, upper / 2 - lower / 2
    local = _pick_coefficients(curve, middle, half, degree, rule)
    coefficients = _shifted(local, half, centre - middle)
    error = np.full(lower.shape, np.inf)
    if rule == "chebyshev":
        error = _interpolation_error(curve, lower, upper, coefficients, centre, middle, half)
    rest = np.flatnonzero(~(error < line.error))
    if rest.size:
        error[rest] = _grid_error(curve, lower[rest], upper[rest], coefficients[:, rest], centre[rest])
    better = np.isfinite(error) & (error < line.error)
    padded = np.concatenate([line.coefficients, np.zeros((degree - 1, *lower.shape))])
    return Polynomial(np.where(better, coefficients, padded), np.where(better, error, line.error))


def _pick_coefficients(
    curve: Curve, middle: Floats, half: Floats, degree: int, rule: Approximation
) -> Floats:
    """Return coefficients ``(degree+1, K)`` in ``t = (x - middle) / half``."""
    if rule == "taylor":
        terms = [curve.value(middle, j) * half**j / factorial(j) for j in range(degree + 1)]
        return np.nan_to_num(np.stack(terms), posinf=0.0, neginf=0.0)
    nodes = _chebyshev_nodes(degree) if rule == "chebyshev" else np.linspace(-1, 1, degree + 1)
    values = np.stack([curve.value(middle + half * node) for node in nodes])
    return _transform(degree, rule) @ values


def _chebyshev_nodes(degree: int) -> Floats:
    return np.cos((2 * np.arange(degree + 1) + 1) * np.pi / (2 * degree + 2))


def _transform(degree: int, rule: Approximation) -> Floats:
    """Return the matrix from values at the nodes to coefficients of t."""
    if rule == "chebyshev":
        return np.asarray(
            np.linalg.inv(np.vander(_chebyshev_nodes(degree), increasing=True)), dtype=np.float64
        )
    columns = []
    for j in range(degree + 1):  # C(k,j) ((1+t)/2)^j ((1-t)/2)^(k-j)
        rising = np.polynomial.polynomial.polypow([0.5, 0.5], j)
        falling = np.polynomial.polynomial.polypow([0.5, -0.5], degree - j)
        columns.append(comb(degree, j) * np.polynomial.polynomial.polymul(rising, falling))
    return np.stack(columns, axis=1)


def _shifted(local: Floats, half: Floats, shift: Floats) -> Floats:
    """Rewrite a polynomial of ``t = (x - middle)/half`` about the centre ``middle + shift``."""
    degree = local.shape[0] - 1
    scale = np.where(half > 0, half, 1.0)
    powers = [local[j] / scale**j for j in range(degree + 1)]
    return np.stack(
        [
            sum(powers[j] * comb(j, i) * shift ** (j - i) for j in range(i, degree + 1))
            for i in range(degree + 1)
        ]
    )


def _horner(coefficients: Floats, x: Interval) -> Interval:
    result = Interval(coefficients[-1], coefficients[-1])
    for coefficient in coefficients[-2::-1]:
        result = result * x + Interval(coefficient, coefficient)
    return result


def _derived(coefficients: Floats) -> Floats:
    return coefficients[1:] * np.arange(1, coefficients.shape[0]).reshape(
        -1, *([1] * (coefficients.ndim - 1))
    )


def _grid_error(curve: Curve, lower: Floats, upper: Floats, coefficients: Floats, centre: Floats) -> Floats:
    """Bound ``|f - p|``: enclosed at the nodes of a grid, and between them by the curvature or, over a kink, the slope.

    Between nodes a distance w apart, ``|e| <= max(ends) + min(w^2/8 max|e''|, w/2 max|e'|)``.
    """
    fractions = np.linspace(0, 1, _GRID + 1)[:, None]
    nodes = np.clip(lower + (upper - lower) * fractions, lower, upper)  # (G+1, K)
    nodes[-1] = upper
    copies = np.broadcast_to(coefficients[:, None], (coefficients.shape[0], *nodes.shape))
    offset = Interval(nodes, nodes) - Interval(centre, centre)
    at_nodes = _magnitude(curve.enclose(nodes) - _horner(copies, offset))
    left, right = nodes[:-1], nodes[1:]
    width = step_up(right - left)
    span = Interval(left, right) - Interval(centre, centre)
    slope = _magnitude(curve.range(left, right, 1) - _horner(_derived(copies[:, :-1]), span))
    bend = _magnitude(curve.range(left, right, 2) - _horner(_derived(_derived(copies[:, :-1])), span))
    with np.errstate(invalid="ignore"):
        between = np.fmin(width * width / 8 * bend, width / 2 * slope)
    between = np.where(np.isnan(between), np.inf, between)
    return step_up((np.maximum(at_nodes[:-1], at_nodes[1:]) + step_up(between, 8)).max(axis=0))


def _interpolation_error(
    curve: Curve, lower: Floats, upper: Floats, coefficients: Floats, centre: Floats,
    middle: Floats, half: Floats,
) -> Floats:  # fmt: skip
    """Bound ``|f - p|`` by the remainder of interpolation plus what rounding moved at the nodes.

    The stored polynomial p interpolates ``f + d`` with d enclosed at the nodes, so ``|f - p|`` is at most the remainder
    of f plus the Lebesgue constant times ``max|d|``. The stored nodes sit within 1e-9 half-widths of the
    Chebyshev nodes, which the last factor of the remainder covers.
    """
    degree = coefficients.shape[0] - 1
    smooth = ~_touches(curve.breaks, lower, upper) & (half > 1e-6 * np.abs(middle))  # nodes well apart
    remainder = _magnitude(curve.range(lower, upper, degree + 1)) * step_up(half, 4) ** (degree + 1)
    remainder = step_up(remainder / (2.0**degree * factorial(degree + 1)), 16) * (1 + 1e-8)
    nodes = middle + half * _chebyshev_nodes(degree)[:, None]  # (k+1, K)
    copies = np.broadcast_to(coefficients[:, None], (degree + 1, *nodes.shape))
    moved = _magnitude(
        curve.enclose(nodes) - _horner(copies, Interval(nodes, nodes) - Interval(centre, centre))
    )
    lebesgue = 2 + 2 / np.pi * np.log(degree + 1)
    with np.errstate(invalid="ignore"):
        error = step_up(remainder + lebesgue * moved.max(axis=0), 8)
    return np.where(smooth & np.isfinite(error), error, np.inf)


def _magnitude(x: Interval) -> Floats:
    return np.maximum(np.abs(x.lower), np.abs(x.upper))
