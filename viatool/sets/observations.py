"""Sets of observations that are no boxes: errors that entries have in common, and some entries that are elsewhere."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product
from math import comb, prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viatool.arrays import Floats, Hull, Indices
from viatool.sets.forms import Forms


@dataclass(frozen=True, eq=False)
class Few:
    """Entries of which up to `count`, whichever they are, lie somewhere else.

    Parameters
    ----------
    count : int
        How many at once.
    columns : ndarray
        (E,) indices of the entries.
    lower, upper : ndarray
        (B, E) where an entry is that is elsewhere.
    """

    count: int
    columns: Indices
    lower: Floats
    upper: Floats

    def select(self, which: NDArray[Any]) -> Few:
        """Return those of some of the sets."""
        return replace(self, lower=self.lower[which], upper=self.upper[which])

    @classmethod
    def concatenate(cls, parts: Sequence[Few]) -> Few:
        """Return the same entries of several sets of sets, one after the other."""
        return replace(
            parts[0],
            lower=np.concatenate([part.lower for part in parts]),
            upper=np.concatenate([part.upper for part in parts]),
        )

    def among(self, columns: Indices) -> Few:
        """Return the same of some of the entries alone, given by their columns."""
        there = np.flatnonzero(np.isin(self.columns, columns))
        return replace(
            self, columns=self.columns[there], lower=self.lower[:, there], upper=self.upper[:, there]
        )

    @property
    def subsets(self) -> int:
        """Return how many choices of entries there are, with that of none."""
        return sum(comb(len(self.columns), size) for size in range(self.count + 1))


@dataclass(frozen=True, eq=False)
class ObservationSets:
    """B sets of observations.

    Parameters
    ----------
    forms : Forms
        (B, n) in S common symbols; what an entry has to itself is in the rest.
    lower, upper : ndarray
        (B, n) what else bounds each entry.
    few : tuple of Few
        Entries that may be somewhere else, beyond forms and bounds; no column is in two of them.

    Notes
    -----
    An observation is in a set if there are values of the symbols for which every entry keeps to its form and its
    bounds, but for up to `count` entries of each `Few`, which keep to theirs.
    """

    forms: Forms
    lower: Floats
    upper: Floats
    few: tuple[Few, ...] = ()

    def __len__(self) -> int:
        """Return B."""
        return len(self.lower)

    def select(self, which: NDArray[Any]) -> ObservationSets:
        """Return some of the sets."""
        forms = self.forms
        return ObservationSets(
            Forms(forms.centre[which], forms.slope[which], forms.rest[which]),
            self.lower[which],
            self.upper[which],
            tuple(few.select(which) for few in self.few),
        )

    def among(self, columns: Indices) -> ObservationSets:
        """Return what is known of some of the entries, (k,) ascending."""
        forms = self.forms
        kept = [few.among(columns) for few in self.few]
        return ObservationSets(
            Forms(forms.centre[:, columns], forms.slope[:, :, columns], forms.rest[:, columns]),
            self.lower[:, columns],
            self.upper[:, columns],
            tuple(
                replace(few, columns=np.searchsorted(columns, few.columns))
                for few in kept
                if few.columns.size
            ),
        )

    @property
    def shares(self) -> bool:
        """Tell whether entries have anything in common."""
        return bool(self.forms.slope.any())

    @property
    def hull(self) -> Hull:
        """Return the boxes around the sets, (B, n) each."""
        lower, upper = self.lower.copy(), self.upper.copy()
        for few in self.few:
            if few.count:
                lower[:, few.columns] = np.minimum(lower[:, few.columns], few.lower)
                upper[:, few.columns] = np.maximum(upper[:, few.columns], few.upper)
        return lower, upper

    def choices(self, most: int) -> Iterator[ObservationSets]:
        """Cut the sets by which entries are elsewhere.

        Parameters
        ----------
        most : int
            So many sets may take the place of one.

        Returns
        -------
        iterator of ObservationSets
            B sets each, that together hold the given ones. Where there are not too many choices of entries, one for
            each: no entry of it may be elsewhere, those that are have their own bounds. Else one for each choice of
            blocks of entries, among which up to `count` may be.
        """
        if prod(few.subsets for few in self.few) <= most:
            every = [
                [
                    chosen
                    for size in range(few.count + 1)
                    for chosen in combinations(range(len(few.columns)), size)
                ]
                for few in self.few
            ]
            for chosen in product(*every):
                yield self._moved(chosen)
        else:
            share = max(2, int(most ** (1.0 / len(self.few))))
            for blocks in product(*(_blocks(few, share) for few in self.few)):
                some = tuple(few.among(block) for few, block in zip(self.few, blocks, strict=True))
                yield replace(self, few=some)

    def _moved(self, chosen: tuple[tuple[int, ...], ...]) -> ObservationSets:
        """Return the sets in which certain entries of each `Few` are elsewhere, and no other."""
        centre, slope, rest = (getattr(self.forms, name).copy() for name in ("centre", "slope", "rest"))
        lower, upper = self.lower.copy(), self.upper.copy()
        for few, entries in zip(self.few, chosen, strict=True):
            columns, which = few.columns[list(entries)], list(entries)
            lower[:, columns], upper[:, columns] = few.lower[:, which], few.upper[:, which]
            middle = 0.5 * (few.lower[:, which] + few.upper[:, which])
            centre[:, columns], slope[:, :, columns] = middle, 0.0
            half = np.maximum(few.upper[:, which] - middle, middle - few.lower[:, which])
            rest[:, columns] = np.nextafter(half, np.inf)
        return ObservationSets(Forms(centre, slope, rest), lower, upper)


def _blocks(few: Few, most: int) -> list[Indices]:
    """Return unions of blocks of columns, at most about `most`, so that any `count` columns lie in one of them."""
    size = len(few.columns)
    count = min(few.count, size)
    if count == 0:
        return [few.columns[:0]]
    blocks = count
    while blocks < size and comb(blocks + 1, count) <= most:
        blocks += 1
    parts = np.array_split(few.columns, blocks)
    return [np.concatenate(some) for some in combinations(parts, count)]
