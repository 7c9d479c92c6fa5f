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

    def choices(self, most: int, weight: Floats | None = None) -> Iterator[ObservationSets]:
        """Cut the sets by which entries are elsewhere.

        Parameters
        ----------
        most : int
            So many sets may take the place of one.
        weight : ndarray, optional
            (n,) how much each entry counts: those that count more come first, after that in which none is elsewhere.

        Returns
        -------
        iterator of ObservationSets
            B sets each, that together hold the given ones. Where there are not too many choices of entries, one for
            each: no entry of it may be elsewhere, those that are have their own bounds. Else one for each choice of
            blocks of entries, among which up to `count` may be.
        """
        alone = prod(few.subsets for few in self.few) <= most
        share = max(2, int(most ** (1.0 / max(len(self.few), 1))))
        every = list(product(*(_each(few) if alone else _blocks(few, share) for few in self.few)))
        if weight is not None:
            counts = [
                sum(_largest(weight[some], few.count) for some, few in zip(chosen, self.few, strict=True))
                if any(map(len, chosen))
                else np.inf
                for chosen in every
            ]
            every = [every[number] for number in np.argsort(-np.array(counts), kind="stable")]
        for chosen in every:
            if alone:
                yield self._moved(chosen)
            else:
                few = tuple(few.among(some) for few, some in zip(self.few, chosen, strict=True))
                yield replace(self, few=few)

    def _moved(self, chosen: Sequence[Indices]) -> ObservationSets:
        """Return the sets in which certain columns of each `Few` are elsewhere, and no other."""
        centre, slope, rest = (getattr(self.forms, name).copy() for name in ("centre", "slope", "rest"))
        lower, upper = self.lower.copy(), self.upper.copy()
        for few, some in zip(self.few, chosen, strict=True):
            which = np.flatnonzero(np.isin(few.columns, some))
            columns = few.columns[which]
            lower[:, columns], upper[:, columns] = few.lower[:, which], few.upper[:, which]
            middle = 0.5 * (few.lower[:, which] + few.upper[:, which])
            centre[:, columns], slope[:, :, columns] = middle, 0.0
            half = np.maximum(few.upper[:, which] - middle, middle - few.lower[:, which])
            rest[:, columns] = np.nextafter(half, np.inf)
        return ObservationSets(Forms(centre, slope, rest), lower, upper)


def _each(few: Few) -> list[Indices]:
    """Return the columns of every choice of entries, that of none first."""
    sizes = range(few.count + 1)
    return [
        few.columns[list(chosen)] for size in sizes for chosen in combinations(range(len(few.columns)), size)
    ]


def _largest(weight: Floats, count: int) -> float:
    """Return the sum of the largest numbers."""
    return float(np.sort(weight)[::-1][:count].sum())


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
