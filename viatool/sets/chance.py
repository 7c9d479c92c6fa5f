"""Random numbers for rows, each from a source of its own: what a row is given does not depend on the rows beside it."""

from __future__ import annotations

import zlib
from collections.abc import Sequence

import numpy as np

from viatool.arrays import Floats


class RowChance:
    """A source of random numbers for each of B rows.

    Parameters
    ----------
    seed : int or sequence of int
        Of all of them.
    *columns : ndarray
        (B, ...) what a row is: rows that are alike get the same numbers, alone or in any batch.
    """

    def __init__(self, seed: int | Sequence[int], *columns: Floats) -> None:
        seeds = [seed] if isinstance(seed, int) else [*seed]
        keys = (zlib.crc32(b"".join(part.tobytes() for part in row)) for row in zip(*columns, strict=True))
        self._sources = [np.random.default_rng([*seeds, key]) for key in keys]

    def __len__(self) -> int:
        """Return B."""
        return len(self._sources)

    def random(self, count: int) -> Floats:
        """Return numbers in [0, 1) for every row, (B, count)."""
        return np.array([source.random(count) for source in self._sources]).reshape(len(self), count)
