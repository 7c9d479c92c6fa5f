"""The shape of an activation: smooth pieces, kinks, and where each derivative rises and falls, all proved.

Everything follows from the declared expression. The real line is cut at the kinks and, for the derivative of each
order, into cells on which that derivative provably rises, provably falls, or (in the tiny cells around an extremum, and
in saturated tails) is enclosed as a whole. The range of a derivative over any interval is then the hull of its values
at the two ends and of one precomputed table entry.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import pairwise

import numpy as np

from viatool.arrays import Booleans, Floats, Indices
from viatool.policy.activation_function import FLOAT_FUNCTIONS, ActivationFunction
from viatool.policy.formulas import Formulas
from viatool.taylor.interval import ENCLOSED_FUNCTIONS, Interval, interval_of, point
from viatool.taylor.straight_lines import EVERYWHERE, StraightLines

REACH = 1e100
"""Pre-activations beyond this magnitude are not enclosed where a function is curved."""

RISING, FALLING, CONSTANT, UNKNOWN = 1, -1, 0, 2

_SPLITS = 60
_MOST_CELLS = 512
_SETTLED = 1e-13
_FEW = 8  # comparing with a few edges beats a binary search


@dataclass(frozen=True, eq=False)
class CurveCells:
    """The real line cut where a derivative turns.

    Parameters
    ----------
    edges : ndarray
        ``(K+1,)``, from one end of the curve's reach to the other.
    kinds : ndarray
        ``(K,)``: `RISING`, `FALLING`, `CONSTANT` or `UNKNOWN` on each cell.
    hulls : tuple of ndarray
        Lower and upper bounds ``(K,)`` of the derivative on each `UNKNOWN` cell.
    table : tuple of ndarray
        ``(K, K)`` lower and upper hull of the derivative over the edges strictly between cell i and cell j, and over
        every unknown or constant cell from i to j.
    """

    edges: Floats
    kinds: Indices
    hulls: tuple[Floats, Floats]
    table: tuple[Floats, Floats]

    def locate(self, lower: Floats, upper: Floats) -> tuple[Indices, Indices]:
        """Return the cells of both ends; an end on an edge counts the edge as inside."""
        inner = self.edges[1:-1]
        if inner.size > _FEW:
            return np.searchsorted(inner, lower, side="left"), np.searchsorted(inner, upper, side="right")
        first, last = np.zeros(lower.shape, dtype=np.intp), np.zeros(upper.shape, dtype=np.intp)
        for edge in inner.tolist():
            first += lower > edge
            last += upper >= edge
        return first, last

    @property
    def is_stepwise(self) -> bool:
        """Whether the derivative is constant on every cell, so that the table alone gives its range."""
        return bool((self.kinds == CONSTANT).all())


class Curve:
    """An activation with proved enclosures of its value and of its derivatives.

    Parameters
    ----------
    function : ActivationFunction
        The declared function.
    """

    def __init__(self, function: ActivationFunction) -> None:
        self.function = function
        self.breaks, self._branches = _smooth_pieces(function.formulas)
        straight = all(function.formulas.branches[index].is_straight for index in self._branches)
        self.reach = EVERYWHERE if straight else REACH
        self._enclosed: dict[int, list[Callable[[Interval], Interval]]] = {}
        self._floats: dict[int, list[Callable[[Floats], Floats]]] = {}
        self._cells: dict[int, CurveCells] = {}

    @property
    def is_increasing(self) -> bool:
        """Whether the function provably never falls; saturated tails may be flat."""
        kinds = self.cells(0).kinds
        tails = kinds[1:-1] if kinds.size > 2 else kinds
        return bool(np.isin(tails, (RISING, CONSTANT)).all() and not (kinds == FALLING).any())

    def value(self, x: Floats, derivative: int = 0) -> Floats:
        """Evaluate a derivative in float64; not a bound."""
        if derivative not in self._floats:
            formulas = self.function.formulas
            self._floats[derivative] = [
                _broadcasting(formulas.derivative(index, derivative, FLOAT_FUNCTIONS))
                for index in self._branches
            ]
        pieces = self._floats[derivative]
        with np.errstate(all="ignore"):
            result = pieces[0](x)
            for edge, piece in zip(self.breaks, pieces[1:], strict=True):
                result = np.where(x >= edge, piece(x), result)
        return result

    def enclose(self, x: Floats, derivative: int = 0) -> Interval:
        """Enclose a derivative at points: ``f^(derivative)(x)``, from both sides at a kink.

        **Sound:** yes.
        """
        if derivative == 0 and self.lines is not None:
            return self.lines.enclose(x)
        pieces = self._pieces(derivative)
        if not self.breaks.size:
            return _checked(pieces[0], Interval(x, x))
        lower, upper = np.full(x.shape, np.inf), np.full(x.shape, -np.inf)
        borders = [-np.inf, *self.breaks.tolist(), np.inf]
        for piece, left, right in zip(pieces, borders[:-1], borders[1:], strict=True):
            here = (x >= left) & (x <= right)
            part = x[here]
            if part.size:
                result = _checked(piece, Interval(part, part))
                lower[here] = np.minimum(lower[here], result.lower)
                upper[here] = np.maximum(upper[here], result.upper)
        return Interval(lower, upper)

    def enclose_piece(self, piece: int, x: Interval, derivative: int = 0) -> Interval:
        """Enclose a derivative over intervals that lie on one smooth piece, by interval arithmetic. **Sound:** yes."""
        return _checked(self._pieces(derivative)[piece], x)

    def operations(self, derivative: int) -> int:
        """Return how many operations the longest expression of a derivative has."""
        branches = self.function.formulas.branches
        return max(branches[index].operations[derivative] for index in self._branches)

    def range(self, lower: Floats, upper: Floats, derivative: int = 0) -> Interval:
        """Enclose a derivative over intervals ``[lower, upper]``.

        **Sound:** yes; a derivative over a jump of the function is the whole line, and so is everything over an
        interval with an end that is not a number.
        """
        if derivative == 0 and self.lines is not None:
            return self.lines.range(lower, upper)
        cells = self.cells(derivative)
        first, last = cells.locate(lower, upper)
        beyond = ~((lower >= -self.reach) & (upper <= self.reach))
        if cells.is_stepwise:
            return Interval(
                np.where(beyond, -np.inf, cells.table[0][first, last]),
                np.where(beyond, np.inf, cells.table[1][first, last]),
            )
        ends = self.enclose(np.stack([lower, upper]), derivative)
        return Interval(
            np.where(beyond, -np.inf, np.minimum(ends.lower.min(axis=0), cells.table[0][first, last])),
            np.where(beyond, np.inf, np.maximum(ends.upper.max(axis=0), cells.table[1][first, last])),
        )

    @cached_property
    def lines(self) -> StraightLines | None:
        """Return what the curve consists of, if that is straight lines without a jump whose slopes are floats."""
        cells = self.cells(1)
        if not cells.is_stepwise or self._jumps(self.breaks, 1).any():
            return None
        middles = [a / 2 + b / 2 for a, b in pairwise([-self.reach, *self.breaks.tolist(), self.reach])]
        first, _ = cells.locate(np.array(middles), np.array(middles))
        low, high = cells.hulls[0][first], cells.hulls[1][first]
        if not ((low == high) & np.isfinite(low)).all():
            return None
        zero = np.zeros(1)
        ends = [_checked(piece, Interval(zero, zero)) for piece in self._pieces(0)]
        shifts = np.array([[end.lower[0], end.upper[0]] for end in ends])
        return StraightLines(self.breaks, low, shifts[:, 0], shifts[:, 1])

    def end_slopes(self, lower: Floats, upper: Floats) -> tuple[tuple[Floats, Floats], Indices]:
        """Return the slopes of a piecewise linear curve at both ends of intervals, and its shape between.

        Returns
        -------
        tuple of ndarray
            Slopes at `lower` and at `upper`.
        ndarray
            1 where the curve is convex on the interval, -1 where concave, 0 where neither is known.
        """
        cells = self.cells(1)
        first, last = cells.locate(lower, upper)
        slopes, bends = self._pieces_and_bends
        return (slopes[first], slopes[last]), bends[first, last]

    @property
    def overall_bend(self) -> int:
        """Return 1 if a piecewise linear curve is convex on the whole line, -1 if concave, else 0."""
        return int(self._pieces_and_bends[1][0, -1])

    @cached_property
    def _pieces_and_bends(self) -> tuple[Floats, Indices]:
        """Slopes (K,) of a piecewise linear curve, and its shape (K, K) from cell to cell."""
        slopes = np.diagonal(self.cells(1).table[0])
        bends = np.zeros((slopes.size, slopes.size), dtype=np.intp)
        if not self._jumps(self.breaks, 1).any():
            for first in range(slopes.size):
                for last in range(first, slopes.size):
                    steps = np.diff(slopes[first : last + 1])
                    bends[first, last] = 1 if (steps >= 0).all() else -1 if (steps <= 0).all() else 0
        return slopes, bends

    def cells(self, derivative: int) -> CurveCells:
        """Return the cells on which ``f^(derivative)`` rises, falls, is constant or is enclosed as a whole."""
        if derivative not in self._cells:
            self._cells[derivative] = self._find_cells(derivative)
        return self._cells[derivative]

    def _pieces(self, derivative: int) -> list[Callable[[Interval], Interval]]:
        if derivative not in self._enclosed:
            formulas = self.function.formulas
            self._enclosed[derivative] = [
                formulas.derivative(index, derivative, ENCLOSED_FUNCTIONS, point) for index in self._branches
            ]
        return self._enclosed[derivative]

    def _find_cells(self, derivative: int) -> CurveCells:
        borders = [-self.reach, *self.breaks.tolist(), self.reach]
        found: list[tuple[float, float, int, float, float]] = []
        for value, slope, left, right in zip(
            self._pieces(derivative), self._pieces(derivative + 1), borders[:-1], borders[1:], strict=True
        ):
            found += _sign_cells(value, slope, left, right)
        edges = np.array([cell[0] for cell in found] + [self.reach])
        kinds = np.array([cell[2] for cell in found], dtype=np.intp)
        hulls = (np.array([cell[3] for cell in found]), np.array([cell[4] for cell in found]))
        nodes = self.enclose(edges[1:-1], derivative)
        if derivative:
            jumps = self._jumps(edges[1:-1], derivative)
            nodes = Interval(np.where(jumps, -np.inf, nodes.lower), np.where(jumps, np.inf, nodes.upper))
        return CurveCells(edges, kinds, hulls, _hull_table(kinds, hulls, nodes))

    def _jumps(self, nodes: Floats, derivative: int) -> Booleans:
        """Find the nodes at which a lower derivative is discontinuous, so that this one is unbounded."""
        jumps = np.zeros(nodes.shape, dtype=bool)
        for lower_derivative in range(derivative):
            pieces = self._pieces(lower_derivative)
            for edge, below, above in zip(self.breaks, pieces[:-1], pieces[1:], strict=True):
                left, right = (_checked(piece, Interval(edge, edge)) for piece in (below, above))
                meet = (left.lower <= right.upper) & (right.lower <= left.upper)
                meet &= np.isfinite(left.upper - left.lower) & np.isfinite(right.upper - right.lower)
                jumps |= (nodes == edge) & ~meet
        return jumps


@lru_cache(maxsize=256)
def curve_of(function: ActivationFunction) -> Curve:
    """Return the analysed curve of a function; equal functions share one."""
    return Curve(function)


def _smooth_pieces(formulas: Formulas) -> tuple[Floats, list[int]]:
    """Cut the real line into breakpoints ``(P-1,)`` and the branches of P smooth pieces, left to right.

    Kinks of a function that is curved somewhere are left out where they are farther away than it is enclosed.
    """
    straight = all(branch.is_straight for branch in formulas.branches)
    reach = EVERYWHERE if straight else REACH
    breaks = sorted(bound for bound in formulas.thresholds() if abs(bound) < reach)
    probes = [a / 2 + b / 2 for a, b in pairwise([-reach, *breaks, reach])]
    return np.array(breaks), [formulas.branch_at(probe) for probe in probes]


def _broadcasting(function: Callable[[Floats], Floats]) -> Callable[[Floats], Floats]:
    def evaluated(x: Floats) -> Floats:
        return _filling(np.asarray(function(x), dtype=np.float64), x.shape)

    return evaluated


def _checked(function: Callable[[Interval], Interval], x: Interval) -> Interval:
    """Evaluate an enclosure; constants are broadcast, undefined results become the whole line."""
    with np.errstate(all="ignore"):
        result = function(x)
    if not isinstance(result, Interval):
        constant = interval_of(float(result))
        return Interval(*(np.full(x.lower.shape, end) for end in (constant.lower, constant.upper)))
    shape = x.lower.shape
    return Interval(
        _filling(np.where(np.isnan(result.lower), -np.inf, result.lower), shape),
        _filling(np.where(np.isnan(result.upper), np.inf, result.upper), shape),
    )


def _filling(values: Floats, shape: tuple[int, ...]) -> Floats:
    """Return values of a shape, repeated where there are fewer."""
    return values if values.shape == shape else np.broadcast_to(values, shape)


def _sign_cells(
    value: Callable[[Interval], Interval], slope: Callable[[Interval], Interval], left: float, right: float
) -> list[tuple[float, float, int, float, float]]:
    """Cut one smooth piece into cells of known sign of the slope, splitting until the rest is negligible."""
    edges = _first_edges(left, right)
    lower, upper = edges[:-1], edges[1:]
    done: list[tuple[float, float, int, float, float]] = []
    for depth in range(_SPLITS + 1):
        sign = _checked(slope, Interval(lower, upper))
        hull = _checked(value, Interval(lower, upper))
        kind = np.where(sign.lower >= 0, RISING, np.where(sign.upper <= 0, FALLING, UNKNOWN))
        kind = np.where((sign.lower == 0) & (sign.upper == 0), CONSTANT, kind)
        with np.errstate(invalid="ignore"):
            width = hull.upper - hull.lower
            scale = _SETTLED * (1 + np.minimum(np.abs(hull.lower), np.abs(hull.upper)))
        middle = lower + (upper - lower) / 2
        stuck = (middle <= lower) | (middle >= upper)
        undefined = np.isneginf(hull.lower) & np.isposinf(hull.upper)
        hopeless = stuck | undefined | (depth == _SPLITS) | (lower.size > _MOST_CELLS)
        settled = (kind != UNKNOWN) | (width <= scale) | hopeless
        done += list(
            zip(
                lower[settled].tolist(),
                upper[settled].tolist(),
                kind[settled].tolist(),
                hull.lower[settled].tolist(),
                hull.upper[settled].tolist(),
                strict=True,
            )
        )
        lower, middle, upper = lower[~settled], middle[~settled], upper[~settled]
        if not lower.size:
            break
        lower, upper = np.concatenate([lower, middle]), np.concatenate([middle, upper])
    return _merged(sorted(done))


def _first_edges(left: float, right: float) -> Floats:
    powers = 2.0 ** np.arange(-20, 100)
    steps = np.linspace(-16, 16, 65)
    inside = np.unique(np.concatenate([-powers, steps, powers]))
    return np.concatenate([[left], inside[(inside > left) & (inside < right)], [right]])


def _merged(
    cells: list[tuple[float, float, int, float, float]],
) -> list[tuple[float, float, int, float, float]]:
    merged = [cells[0]]
    for lower, upper, kind, low, high in cells[1:]:
        start, _, last, last_low, last_high = merged[-1]
        pole_between = not np.isfinite([low, high, last_low, last_high]).all()
        if kind == last and not pole_between:
            merged[-1] = (start, upper, kind, min(low, last_low), max(high, last_high))
        else:
            merged.append((lower, upper, kind, low, high))
    return merged


def _hull_table(kinds: Indices, hulls: tuple[Floats, Floats], nodes: Interval) -> tuple[Floats, Floats]:
    count = kinds.size
    lowest, highest = np.full((count, count), np.inf), np.full((count, count), -np.inf)
    for first in range(count):
        low, high = math.inf, -math.inf
        for last in range(first, count):
            if last > first:
                low, high = min(low, nodes.lower[last - 1]), max(high, nodes.upper[last - 1])
            if kinds[last] in (UNKNOWN, CONSTANT):
                low, high = min(low, hulls[0][last]), max(high, hulls[1][last])
            lowest[first, last], highest[first, last] = low, high
    return lowest, highest
