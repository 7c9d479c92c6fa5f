"""Cells of a lattice, all of one size and numbered: ranges of them, and sets that cover ranges.

A set of cells is a mask. Whether a range of cells, a box of up to five axes, lies in the set is read from sums over
the mask up to each corner (a summed-area table), at a cost that does not depend on the size of the range. Headings go
round; a range of them may pass -pi.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from viatool.arrays import Booleans, Floats, Indices
from viatool.places.findings import CellFindings
from viatool.places.tree import AXES, Lattice
from viatool.rounding import SLIGHTLY_MORE, SPARE
from viatool.sets.bounds import require_ordered
from viatool.sets.forms import PoseBoxes
from viatool.sets.states import StateBoxes

_THETA = 2
_AT_ONCE = 1 << 20
_MOST = np.iinfo(np.int16).max


@dataclass(frozen=True, eq=False)
class Ranges:
    """P ranges of cells.

    Parameters
    ----------
    first, last : ndarray
        (P, 5) int16, both in the range; a heading may be beyond the number of headings by less than a turn.
    """

    first: NDArray[np.int16]
    last: NDArray[np.int16]

    def __len__(self) -> int:
        """Return the number of ranges."""
        return len(self.first)

    def select(self, which: Indices | Booleans | slice) -> Ranges:
        """Return some of the ranges."""
        return Ranges(self.first[which], self.last[which])


@dataclass(frozen=True, eq=False)
class Mesh:
    """Cells of one size, numbered row by row.

    Parameters
    ----------
    origin, size : ndarray
        (5,) lower corner of the first cell, and the extent of a cell.
    count : ndarray
        (5,) int, cells along x, y, theta, v and omega; headings fill a turn.
    beyond : ndarray
        (A - 2, 2) ends of the commands before along further axes, all of which every cell takes.
    """

    origin: Floats
    size: Floats
    count: Indices
    beyond: Floats = field(default_factory=lambda: np.zeros((0, 2)))

    @classmethod
    def of(cls, lattice: Lattice, coarser: int = 0) -> Mesh:
        """Return the cells of a lattice that are `coarser` times halved less along x, y and theta than the smallest.

        A number below 0 gives cells that are halved more often than these.
        """
        level = lattice.deepest - np.array([coarser, coarser, coarser, 0, 0])
        size = lattice.size * np.exp2(-level.astype(np.float64))
        return cls(lattice.origin, size, lattice.count << level, lattice.beyond)

    def __len__(self) -> int:
        """Return the number of cells."""
        return int(np.prod(self.count))

    @property
    def countable(self) -> bool:
        """Tell whether the numbers of `Ranges` suffice, headings for two turns."""
        return int((self.count * np.where(np.arange(len(AXES)) == _THETA, 2, 1)).max()) <= _MOST

    def bounds(self, number: Indices, span: int | Indices = 1) -> tuple[Floats, Floats]:
        """Return lower and upper ends of cells, (C, 5), the same numbers for neighbours, or of as many from them on."""
        index = np.stack(np.unravel_index(number, self.count), axis=1)
        return self.origin + index * self.size, self.origin + (index + span) * self.size

    def boxes(self, lower: Floats, upper: Floats) -> StateBoxes:
        """Return states between two ends (C, 5), poses rounded outward."""
        middle = 0.5 * (lower[:, :3] + upper[:, :3])
        radius = np.maximum(upper[:, :3] - middle, middle - lower[:, :3]) * SLIGHTLY_MORE + SPARE
        rest = (np.broadcast_to(end, (len(lower), len(end))) for end in self.beyond.T)
        before = (
            np.concatenate([end[:, 3:], more], axis=1) for end, more in zip((lower, upper), rest, strict=True)
        )
        return StateBoxes(PoseBoxes(middle, radius), *before)

    def ranges(self, lower: Floats, upper: Floats) -> Ranges:
        """Return the cells that hold every state between two ends (P, 3 + A).

        Notes
        -----
        Sound: yes; a state on the border of two cells is in both, and either will do. What lies beyond the mesh is
        left out, as commands are that no robot carries out.
        """
        require_ordered("states after an interval", lower, upper, finite=True, rounding=SPARE)
        lower, upper = lower[:, : len(AXES)], upper[:, : len(AXES)]
        first = np.floor((lower - self.origin) / self.size)
        first -= self.origin + first * self.size > lower
        last = np.ceil((upper - self.origin) / self.size) - 1.0
        last += self.origin + (last + 1.0) * self.size < upper
        last = np.maximum(first, last)
        ends = np.stack([first, last]).astype(np.int64)  # (2, P, 5)
        plain = [axis for axis in range(len(AXES)) if axis != _THETA]
        ends[:, :, plain] = np.clip(ends[:, :, plain], 0, self.count[plain] - 1)
        headings = self.count[_THETA]
        ends[:, :, _THETA] -= ends[0, :, _THETA] // headings * headings
        whole = ends[1, :, _THETA] - ends[0, :, _THETA] >= headings - 1
        ends[0, whole, _THETA], ends[1, whole, _THETA] = 0, headings - 1
        return Ranges(ends[0].astype(np.int16), ends[1].astype(np.int16))

    def statuses(self, lattice: Lattice, findings: CellFindings) -> NDArray[np.int8]:
        """Return the status of each cell, (N,): the last one of all leaves that it shares; -1 where none is."""
        status = np.full(len(self), -1, np.int8)
        level = np.log2(self.count // lattice.count).astype(np.int64)
        spread = level - findings.level
        for each in np.unique(spread, axis=0):
            members = np.flatnonzero((spread == each).all(axis=1))
            offsets = np.indices(1 << np.maximum(each, 0)).reshape(len(AXES), -1).T
            for some in _pieces(members, max(1, _AT_ONCE // len(offsets))):
                corner = (findings.index[some].astype(np.int64) >> np.maximum(-each, 0)) << np.maximum(
                    each, 0
                )
                index = (corner[:, None] + offsets).reshape(-1, len(AXES))
                number = np.ravel_multi_index(tuple(index.T), tuple(self.count))
                np.maximum.at(status, number, np.repeat(findings.status[some], len(offsets)))
        return status


class CellSet:
    """A set of cells of a mesh, ready for the question which ranges it covers.

    Parameters
    ----------
    mesh : Mesh
        N cells.
    mask : ndarray
        (N,) bool.
    """

    def __init__(self, mesh: Mesh, mask: Booleans) -> None:
        self._axes = [axis for axis in range(len(AXES)) if mesh.count[axis] > 1 or axis == _THETA]
        self._turn, self._place = int(mesh.count[_THETA]), self._axes.index(_THETA)
        members = mask.reshape(
            tuple(mesh.count[self._axes])
        ).copy()  # masks are changed while sets are in use
        sums = np.zeros(tuple(np.array(members.shape) + 1), np.int64 if len(mesh) > 2**30 else np.int32)
        sums[(slice(1, None),) * len(self._axes)] = members
        for axis in range(len(self._axes)):
            np.cumsum(sums, axis=axis, out=sums)
        self._strides = np.array(sums.strides, np.int64) // sums.itemsize
        self._sums = sums.ravel()
        self._steps = np.array(members.strides, np.int64) // members.itemsize
        self._members = members.ravel()

    @property
    def bytes(self) -> int:
        """Return the size of the table."""
        return int(self._sums.nbytes + self._members.nbytes)

    def covers(self, ranges: Ranges) -> Booleans:
        """Tell which ranges lie in the set, (P,)."""
        ends = np.stack([ranges.first, ranges.last])[:, :, self._axes].astype(np.int64)
        corners = ends.copy()
        corners[:, :, self._place] %= self._turn
        found = self._members[corners @ self._steps].all(
            axis=0
        )  # most that are not covered have an end outside
        first, last = ends[:, found]
        found[found] = self._held(first, last) == np.prod(last - first + 1, axis=1)
        return np.asarray(found)

    def share(self, ranges: Ranges) -> Floats:
        """Return the share of the cells of ranges that lie in the set, (P,)."""
        first, last = np.stack([ranges.first, ranges.last])[:, :, self._axes].astype(np.int64)
        return np.asarray(self._held(first, last) / np.prod(last - first + 1, axis=1))

    def _held(self, first: Indices, last: Indices) -> Indices:
        """Count the cells of ranges that are in the set, (P,); headings that pass a turn begin anew."""
        passing = np.flatnonzero(last[:, self._place] >= self._turn)
        if not len(passing):
            return self._summed(first, last)
        end, begin, rest = last.copy(), first[passing], last[passing]
        end[passing, self._place] = self._turn - 1
        begin[:, self._place] = 0
        rest[:, self._place] -= self._turn
        held = self._summed(first, end)
        held[passing] += self._summed(begin, rest)
        return held

    def _summed(self, first: Indices, last: Indices) -> Indices:
        """Count the cells of ranges within a turn that are in the set, (P,)."""
        below, above = first * self._strides, (last + 1) * self._strides
        held = np.zeros(len(first), np.int64)
        for corner in itertools.product((False, True), repeat=len(self._axes)):
            place = sum((above if up else below)[:, axis] for axis, up in enumerate(corner))
            sign = (-1) ** (len(corner) - sum(corner))
            held += sign * self._sums[place].astype(np.int64)
        return held


def _pieces(members: Indices, size: int) -> Iterator[Indices]:
    for first in range(0, len(members), size):
        yield members[first : first + size]
