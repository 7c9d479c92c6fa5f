"""Exact distances from points and segments to the blocked cells of a grid, row by row.

Cells are unit squares; all lengths are in cells. A row of cells is convex in y, and the distance between a
segment and the points of a row with abscissa x is a convex function of x. So among the blocked cells of a
row, the nearest one is the first to the left or the first to the right of wherever that function is least:
two look-ups settle a row, and rows are visited outwards until they are farther away than what was found.

Sound: under rounding only (float64 to nearest).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viatool.arrays import Booleans, Floats, Indices, Plane
from viatool.world.measurement import segment_edge_squared


@dataclass(frozen=True, eq=False)
class RowTables:
    """The nearest blocked cells to both sides of every cell, in a grid with a blocked rim of one cell.

    Parameters
    ----------
    left, right : ndarray
        (R, C) int16 or int32, column of the first blocked cell at or before, and at or after, each cell.
    """

    left: NDArray[Any]
    right: NDArray[Any]

    @classmethod
    def of(cls, blocked: Booleans) -> RowTables:
        """Return the tables of a grid (R - 2, C - 2), without its rim."""
        inside = np.pad(blocked, 1, constant_values=True)
        width = inside.shape[1]
        columns = np.arange(width, dtype=np.int16 if width < 2**15 else np.int32)
        left = np.where(inside, columns, columns[0])
        np.maximum.accumulate(left, axis=1, out=left)
        right = np.where(inside, columns, columns[-1])
        backward = right[:, ::-1]
        np.minimum.accumulate(backward, axis=1, out=backward)
        return cls(left, right)

    def place(self, points: Plane) -> Plane:
        """Return points (B,) of the grid in the grid with its rim; what is farther out, or NaN, moves into the rim."""
        rows, columns = self.left.shape
        x = np.fmin(np.fmax(points.real + 1.0, 0.0), columns)
        return np.asarray(x + 1j * np.fmin(np.fmax(points.imag + 1.0, 0.0), rows))

    def cell(self, coordinate: Floats, axis: int) -> Indices:
        """Return the row (axis 0) or column (axis 1) of coordinates."""
        return np.clip(np.floor(coordinate).astype(np.int64), 0, self.left.shape[axis] - 1)

    def beside(self, row: Indices, column: Indices) -> tuple[Indices, Indices]:
        """Return the first blocked columns at or before, and at or after, cells; rows are clipped."""
        rows, columns = self.left.shape
        flat = np.clip(row, 0, rows - 1) * columns + column
        return self.left.ravel().take(flat).astype(np.int64), self.right.ravel().take(flat).astype(np.int64)


def point_distances(points: Plane, tables: RowTables) -> Floats:
    """Return the distances from points (B,) to the nearest blocked cell, in cells; 0 within one."""
    at = tables.place(points)
    home = tables.cell(at.imag, 0)
    nearest = _point_row(at, home, tables)
    pending = np.flatnonzero(nearest > 0.0)
    step = 0
    while len(pending):
        step += 1
        here, row, best = at[pending], home[pending], nearest[pending]
        below, above = here.imag - row + (step - 1), row + step - here.imag
        for other, gap in ((row - step, below), (row + step, above)):
            near = np.flatnonzero(gap < best)
            best[near] = np.minimum(best[near], _point_row(here[near], other[near], tables))
        nearest[pending] = best
        pending = pending[np.minimum(below, above) + 1.0 < best]
    return nearest


def _point_row(at: Plane, row: Indices, tables: RowTables) -> Floats:
    """Return the distances from points (B,) to the blocked cells of one row each."""
    x, column = at.real, tables.cell(at.real, 1)
    left, right = tables.beside(row, column)
    along = np.where(left == column, 0.0, np.minimum(x - (left + 1), right - x))
    across = np.maximum(np.maximum(row - at.imag, at.imag - (row + 1)), 0.0)
    return np.asarray(np.hypot(np.maximum(along, 0.0), across))


def segment_distances(starts: Plane, ends: Plane, tables: RowTables) -> Floats:
    """Return the least distances from segments (B,) to a blocked cell, in cells; 0 where one is met."""
    starts, ends = tables.place(starts), tables.place(ends)
    upward = starts.imag <= ends.imag
    low, high = np.where(upward, starts, ends), np.where(upward, ends, starts)
    first, last = tables.cell(low.imag, 0), tables.cell(high.imag, 0)
    nearest = np.full(len(low), np.inf)
    for step in range(int((last - first).max(initial=-1)) + 1):  # the rows that the segments cross
        crossing = np.flatnonzero((first + step <= last) & (nearest > 0.0))
        _visit(nearest, crossing, low, high, first + step, tables)
    pending, step = np.flatnonzero(nearest > 0.0), 0
    while len(pending):
        step += 1
        below = low[pending].imag - first[pending] + (step - 1)
        above = last[pending] + step - high[pending].imag
        _visit(nearest, pending[below < nearest[pending]], low, high, first - step, tables)
        _visit(nearest, pending[above < nearest[pending]], low, high, last + step, tables)
        pending = pending[np.minimum(below, above) + 1.0 < nearest[pending]]
    return nearest


def _visit(
    nearest: Floats, which: Indices, low: Plane, high: Plane, rows: Indices, tables: RowTables
) -> None:
    """Lower the distances of some segments to those of one row of cells each."""
    low, high, row = low[which], high[which], rows[which]
    # A point of the segment where it is nearest to the row: within the row if it crosses it.
    height = np.clip(row + 0.5, low.imag, high.imag)
    rise = high.imag - low.imag
    share = np.where(rise > 0.0, (height - low.imag) / np.where(rise > 0.0, rise, 1.0), 0.0)
    x = low.real + share * (high.real - low.real)
    column = tables.cell(x, 1)
    left, right = tables.beside(row, column)
    across = np.maximum(np.maximum(row - height, height - (row + 1)), 0.0)
    here = left == column
    nearest[which[here]] = np.minimum(nearest[which[here]], across[here])
    smallest, largest = np.minimum(low.real, high.real), np.maximum(low.real, high.real)
    for side, gap in ((left + 1, smallest - (left + 1)), (right, right - largest)):
        near = np.flatnonzero(~here & (np.hypot(np.maximum(gap, 0.0), across) < nearest[which]))
        foot = side[near] + 1j * row[near]
        squared = segment_edge_squared(low[near], high[near], foot, foot + 1j)
        nearest[which[near]] = np.minimum(nearest[which[near]], np.sqrt(squared))


def enclosed_cells(corners: Plane, counts: NDArray[np.int32]) -> Booleans:
    """Tell which outlines surround the middle of a blocked cell.

    Parameters
    ----------
    corners : ndarray
        (n, B) of counter-clockwise outlines, in cells, without a rim.
    counts : ndarray
        (rows, columns + 1) number of blocked cells before each column.

    Returns
    -------
    ndarray
        (B,) bool; an outline that is not finite is taken to surround one.
    """
    known = np.isfinite(corners).all(axis=0)
    corners = np.where(known, corners, 0.0)
    following = np.roll(corners, -1, axis=0)
    rows, columns = counts.shape[0], counts.shape[1] - 1
    lowest = np.maximum(np.floor(corners.imag.min(axis=0)), 0.0).astype(np.int64)
    highest = np.minimum(np.floor(corners.imag.max(axis=0)), rows - 1).astype(np.int64)
    found: Booleans = np.logical_not(known)
    for step in range(int((highest - lowest).max(initial=-1)) + 1):
        row = np.minimum(lowest + step, rows - 1)
        line = row + 0.5
        upward = (corners.imag <= line) & (following.imag > line)
        downward = (following.imag <= line) & (corners.imag > line)
        rise = np.where(upward | downward, following.imag - corners.imag, 1.0)
        x = corners.real + (line - corners.imag) / rise * (following.real - corners.real)
        before = np.clip(np.ceil(x - 0.5), 0, columns).astype(np.int64)
        passed = counts[row, before]
        inside = (passed * upward).sum(axis=0) - (passed * downward).sum(axis=0)
        found |= (inside > 0) & (lowest + step <= highest)
    return found
