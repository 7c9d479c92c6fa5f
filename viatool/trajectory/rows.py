"""Rows of numbers that grow in place, for files that are read some rows at a time."""

from __future__ import annotations

from array import array
from typing import Any

import numpy as np
from numpy.typing import NDArray


class Rows:
    """A table to which rows are added; it is never in memory twice.

    Parameters
    ----------
    width : int
        Columns.
    kind : type
        `numpy.float64` or `numpy.int64`.
    """

    def __init__(self, width: int, kind: type = np.float64) -> None:
        self.width, self.kind = width, kind
        self._numbers: array[Any] = array("q" if kind is np.int64 else "d")

    def add(self, rows: NDArray[Any]) -> None:
        """Add rows (B, width)."""
        self._numbers.frombytes(np.ascontiguousarray(rows, dtype=self.kind).tobytes())

    def table(self) -> NDArray[Any]:
        """Return all rows, (N, width), which share their memory; nothing can be added from now on."""
        count = len(self._numbers) // self.width if self.width else 0
        if not count:
            return np.zeros((count, self.width), dtype=self.kind)
        return np.frombuffer(self._numbers, dtype=self.kind).reshape(count, self.width)
