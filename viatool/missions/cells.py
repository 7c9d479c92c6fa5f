"""Sets of states as parts in cells of pose and previous command: cut where cells end, joined where they meet.

A step turns a part into a set ``q = c + G s + r e``, s and e in [-1, 1], of which plain bounds are known as well. Of
its states whose j-th quantity lies in [a, b], for any number k,

    q_i = k q_j + (q_i - k q_j)  lies in  k [a, b] + c_i - k c_j +- (|G_i - k G_j| + r_i + |k| r_j),

``|.|`` the sum of absolute values. Each side of a cell is such an interval, so every quantity has one bound for each
side, the tightest of which counts; k is the regression of q_i on q_j. A piece whose bounds are crossed holds no state.
What falls into one cell is replaced by the box around it, which is often much smaller than the cell.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from viatool.arrays import Floats, Indices
from viatool.errors import BoundsError
from viatool.missions.directions import BoundedParts, PoseDirections, not_crossed
from viatool.rounding import SLIGHTLY_MORE, SPARE
from viatool.sets.bounds import require_ordered
from viatool.sets.forms import Forms
from viatool.sets.states import POSE

_MOST_NUMBERS = 1_000_000
"""Of coefficients of pieces that are cut together."""


_MOST_PIECES = 2_000_000
_COARSER = 1.5
"""Into which sets are cut in all; where there would be more, cells are so many times longer."""


@dataclass(frozen=True, eq=False)
class CellSides:
    """How long the sides of cells are.

    Parameters
    ----------
    sides : ndarray
        (3 + A,) of x, y, theta and each entry of the previous command; infinite where nothing is cut.
    """

    sides: Floats

    @property
    def cut(self) -> Indices:
        """Return which quantities are cut."""
        return np.flatnonzero(np.isfinite(self.sides))

    def scaled(self, share: float) -> CellSides:
        """Return cells whose sides along x, y and theta are a share of these."""
        return CellSides(self.sides * np.where(np.arange(len(self.sides)) < len(POSE), share, 1.0))

    def divide(
        self, states: Forms, bounds: tuple[Floats, Floats], directions: PoseDirections
    ) -> BoundedParts:
        """Cut sets of states by cells, and join what lies in the same one.

        Parameters
        ----------
        states : Forms
            (C, 3 + A).
        bounds : tuple of ndarray
            (C, 3 + A + M) twice: what else is known of the sets, and of their coordinates.
        directions : PoseDirections
            M that the coordinates are along.

        Returns
        -------
        BoundedParts
            P of them, in different cells.

        Notes
        -----
        Sound: yes, every state of every set is in one of the parts.
        """
        for side in bounds:
            require_ordered("states after an interval", side, side, finite=True)
        bounds = directions.tightened(*bounds)
        there = not_crossed(*bounds)
        states, bounds = states.select(there), (bounds[0][there], bounds[1][there])
        firsts, lasts = self._ranges(bounds)
        pieces = np.prod(lasts - firsts + 1, axis=1)
        most = max(
            _MOST_PIECES, len(firsts) * 2 ** len(self.cut)
        )  # any side may pass the border of two cells
        if np.prod((lasts - firsts + 1).astype(np.float64), axis=1).sum() > most:
            return CellSides(self.sides * _COARSER).divide(states, bounds, directions)
        states = directions.beside(states)
        width = states.centre.shape[1] * (len(self.cut) + 4)
        found: list[tuple[Indices, Floats, Floats]] = []
        begin = 0
        ends = np.cumsum(pieces)
        while begin < len(pieces):
            done = ends[begin - 1] if begin else 0
            end = max(begin + 1, int(np.searchsorted(ends, done + _MOST_NUMBERS // width)))
            rows = np.arange(begin, end)
            found.append(_merged(*self._pieces(states, bounds, directions, rows, firsts, lasts)))
            begin = end
        if not found:
            return BoundedParts(*bounds, directions)
        _, lower, upper = _merged(*(np.concatenate(part) for part in zip(*found, strict=True)))
        require_ordered("parts of a set", lower, upper, finite=True)
        if not len(lower):
            raise BoundsError("no part is left of a set of states")
        return BoundedParts(lower, upper, directions)

    def _ranges(self, bounds: tuple[Floats, Floats]) -> tuple[Indices, Indices]:
        """Return the first and the last cells of sets along each quantity that is cut, (C, D) each."""
        first, last = (np.floor(end[:, self.cut] / self.sides[self.cut]).astype(np.int64) for end in bounds)
        return first, last

    def _pieces(
        self,
        states: Forms,
        bounds: tuple[Floats, Floats],
        directions: PoseDirections,
        rows: Indices,
        firsts: Indices,
        lasts: Indices,
    ) -> tuple[Indices, Floats, Floats]:
        """Return the pieces of some sets: their cells (P, D), and bounds (P, 3 + A + M) twice."""
        counts = lasts[rows] - firsts[rows] + 1
        pieces = counts.prod(axis=1)
        of = np.repeat(rows, pieces)
        rest = np.arange(len(of)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
        cell = np.empty((len(of), len(self.cut)), np.int64)
        for place in range(len(self.cut)):
            each = np.repeat(counts[:, place], pieces)
            cell[:, place] = firsts[of, place] + rest % each
            rest = rest // each
        lower, upper = (end[of].copy() for end in bounds)
        for place, quantity in enumerate(
            self.cut
        ):  # the outermost cells reach to the ends, however these round
            side, which = self.sides[quantity], cell[:, place]
            begins, ends = which * side, (which + 1) * side
            lower[:, quantity] = np.where(which == firsts[of, place], lower[:, quantity], begins)
            upper[:, quantity] = np.where(which == lasts[of, place], upper[:, quantity], ends)
        own = lower[:, self.cut], upper[:, self.cut]
        regressions = [_regression(states, rows, int(quantity)) for quantity in self.cut]
        count = lower.shape[1] - len(directions)
        for some in (
            slice(count),
            slice(count, None),
        ):  # most pieces are empty by what they hold of states alone
            near = of - rows[0]
            for place, parts in enumerate(regressions):
                middle, slope, spread = (part[near, some] for part in parts)
                ends = slope * own[0][:, place, None], slope * own[1][:, place, None]
                np.maximum(lower[:, some], middle + np.minimum(*ends) - spread, out=lower[:, some])
                np.minimum(upper[:, some], middle + np.maximum(*ends) + spread, out=upper[:, some])
            kept = not_crossed(lower[:, some], upper[:, some])
            of, cell, lower, upper = of[kept], cell[kept], lower[kept], upper[kept]
            own = own[0][kept], own[1][kept]
        lower, upper = directions.tightened(lower, upper)
        kept = not_crossed(lower, upper)
        return cell[kept], lower[kept], upper[kept]


def _regression(states: Forms, rows: Indices, quantity: int) -> tuple[Floats, Floats, Floats]:
    """Return ``c_i - k c_j``, k and how far ``q_i - k q_j`` varies, rounding included, (C, 3 + A) each."""
    centre, slopes, rest = states.centre[rows], states.slope[rows], states.rest[rows]
    its = slopes[:, :, quantity]
    variance = np.maximum(np.square(its).sum(axis=1), 1e-300)[:, None]
    slope = np.einsum("cs,csi->ci", its, slopes) / variance
    slope = np.where(np.abs(slope) < 1e6, slope, 0.0)
    apart = np.abs(slopes - slope[:, None] * its[:, :, None]).sum(axis=1)
    apart = apart + rest + np.abs(slope) * rest[:, quantity, None]
    size = np.abs(centre) + np.abs(slope) * (np.abs(centre[:, quantity, None]) + 1.0)
    return centre - slope * centre[:, quantity, None], slope, apart * SLIGHTLY_MORE + SPARE * (size + 1.0)


def _merged(cell: Indices, lower: Floats, upper: Floats) -> tuple[Indices, Floats, Floats]:
    """Return the boxes around all boxes of one cell, for each cell."""
    if not len(cell):
        return cell, lower, upper
    low = cell.min(axis=0)
    spans = (cell.max(axis=0) - low + 1).tolist()
    key = np.zeros(len(cell), np.int64)
    for place, span in enumerate(spans):
        key = key * span + (cell[:, place] - low[place])
    order = np.argsort(key, kind="stable")
    _, first = np.unique(key[order], return_index=True)
    return (
        cell[order][first],
        np.minimum.reduceat(lower[order], first, axis=0),
        np.maximum.reduceat(upper[order], first, axis=0),
    )
