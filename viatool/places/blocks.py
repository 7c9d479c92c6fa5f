"""Blocks: cubes of cells along x, y and theta that are followed as one, and halved where that is not enough."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from viatool.arrays import Booleans, Floats, Indices
from viatool.places.mesh import Mesh
from viatool.places.tree import AXES

_CUT = 3


@dataclass(frozen=True, eq=False)
class Blocks:
    """B blocks, of which no two share a cell.

    Parameters
    ----------
    mesh : Mesh
        Of their cells.
    first : ndarray
        (B,) number of the first cell of each block, which names it.
    side : ndarray
        (B,) int8, a power of two: how many cells it has along x, y and theta each.
    """

    mesh: Mesh
    first: Indices
    side: NDArray[np.int8]

    def __len__(self) -> int:
        """Return B."""
        return len(self.first)

    @classmethod
    def cells_of(cls, mesh: Mesh, cells: Indices) -> Blocks:
        """Return single cells as blocks."""
        return cls(mesh, cells, np.ones(len(cells), np.int8))

    @classmethod
    def over(cls, mesh: Mesh, side: int) -> Blocks:
        """Return all blocks of one side."""
        steps = np.where(np.arange(len(AXES)) < _CUT, side, 1)
        index = np.indices(tuple(mesh.count // steps)).reshape(len(AXES), -1)
        first = np.ravel_multi_index(tuple(index * steps[:, None]), tuple(mesh.count))
        return cls(mesh, first.astype(np.int64), np.full(len(first), side, np.int8))

    @classmethod
    def join(cls, one: Blocks, other: Blocks) -> Blocks:
        """Return the blocks of both."""
        return cls(
            one.mesh, *(np.concatenate([getattr(each, name) for each in (one, other)]) for name in _FIELDS)
        )

    def select(self, which: Indices | Booleans | slice) -> Blocks:
        """Return some of the blocks."""
        return Blocks(self.mesh, self.first[which], self.side[which])

    @property
    def cells(self) -> Indices:
        """Return the numbers of all their cells, each once."""
        parts = [numbers.ravel() for _, numbers in self._by_side()]
        return np.concatenate([np.zeros(0, np.int64), *parts])

    def every(self, mask: Booleans) -> Booleans:
        """Tell of which blocks all cells are in a mask (N,), (B,)."""
        found = np.zeros(len(self), bool)
        for which, numbers in self._by_side():
            found[which] = mask[numbers].all(axis=1)
        return found

    def bounds(self) -> tuple[Floats, Floats]:
        """Return lower and upper ends, (B, 5), the same numbers for neighbours."""
        return self.mesh.bounds(self.first, np.where(np.arange(len(AXES)) < _CUT, self.side[:, None], 1))

    def halved(self) -> Blocks:
        """Return the eight blocks of half the side of each, side by side."""
        half = self.side // 2
        first = self.first[:, None] + self._offsets(2) * half[:, None]
        return Blocks(self.mesh, first.ravel(), np.repeat(half, first.shape[1]))

    def _by_side(self) -> Iterator[tuple[Indices, Indices]]:
        """Yield blocks of one side, and the numbers of their cells, (B', side^3)."""
        for side in np.unique(self.side):
            which = np.flatnonzero(self.side == side)
            yield which, self.first[which, None] + self._offsets(int(side))

    def _offsets(self, side: int) -> Indices:
        """Return what to add to the number of the first cell for each cell of a block, (side^3,)."""
        beyond = np.cumprod([1, *self.mesh.count[:0:-1]])[::-1][:_CUT].astype(np.int64)
        return np.asarray(np.indices((side,) * _CUT).reshape(_CUT, -1).T @ beyond)


_FIELDS = ("first", "side")
