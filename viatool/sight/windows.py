"""Poses told apart by what a bin reads there: on each side of a jump a reading changes as smoothly as before a wall."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from viatool.arrays import Booleans, Floats, Indices
from viatool.sight.glimpses import Glimpses

_NARROW = 1e-6
"""Metres up to which a gap is none, but rounding."""


@dataclass(frozen=True, eq=False)
class Windows:
    """Which poses of C boxes count: those at which every bin would read, without errors and limits, within bounds.

    Parameters
    ----------
    lower, upper : ndarray
        (C, bins) metres; infinite where any reading will do.
    """

    lower: Floats
    upper: Floats

    def select(self, which: Indices | Booleans) -> Windows:
        """Return those of some of the boxes."""
        return Windows(self.lower[which], self.upper[which])

    def may_read(self, seen: Glimpses, slack: float) -> Glimpses:
        """Return what may be read at poses that count.

        Notes
        -----
        Sound: yes. What is nearer than a bin reads is not met, and what is farther than that is not what it reads.
        """
        least, most = seen.ends
        nearer = most < self.lower.ravel()[seen.row] - slack
        farther = least > self.upper.ravel()[seen.row] + slack
        return seen.select(~(nearer | farther))


@dataclass(frozen=True, eq=False)
class Gaps:
    """What bins of C boxes never read, however they jump: the widest gap of each.

    Parameters
    ----------
    middle, width : ndarray
        (C, bins) metres; no gap has the width 0.
    """

    middle: Floats
    width: Floats

    @classmethod
    def none(cls, count: int, bins: int) -> Gaps:
        """Return no gap at all."""
        return cls(np.zeros((count, bins)), np.zeros((count, bins)))

    @classmethod
    def between(cls, seen: Glimpses, count: int, bins: int, limit: float) -> Gaps:
        """Return the widest gap between what each bin may read, at most a limit.

        Where it lies decides how tightly readings are enclosed and never whether they are.
        """
        found = cls.none(count, bins)
        least, most = seen.ends
        cap = np.full(count * bins, limit)
        np.minimum.at(cap, seen.row[seen.certain], most[seen.certain])
        some = np.flatnonzero(least < cap[seen.row])
        rows = np.concatenate([seen.row[some], np.unique(seen.row)])
        least = np.concatenate([least[some], cap[rows[len(some) :]]])
        most = np.concatenate([np.minimum(most[some], cap[seen.row[some]]), cap[rows[len(some) :]]])
        order = np.lexsort((least, rows))
        rows, least, most = rows[order], least[order], most[order]
        apart = 4.0 * (limit + 1.0) * rows  # of one bin after the other
        reached = np.maximum.accumulate(most + apart) - apart
        width = np.where(rows[1:] == rows[:-1], least[1:] - reached[:-1], 0.0)
        middle = 0.5 * (least[1:] + reached[:-1])
        order = np.argsort(width, kind="stable")  # the widest last, which is kept
        order = order[width[order] > _NARROW]
        found.width.ravel()[rows[1:][order]] = width[order]
        found.middle.ravel()[rows[1:][order]] = middle[order]
        return found


@dataclass(frozen=True, eq=False)
class Sides:
    """The sides of jumps, of sets that have any.

    Parameters
    ----------
    row : ndarray
        (K,) the set of each, ascending: all choices of sides of its jumps, one after the other.
    windows : mapping of str to Windows
        (K, bins) which poses each is about, for each LiDAR.
    """

    row: Indices
    windows: Mapping[str, Windows]

    def in_place_of_sets(self, count: int, parts: int) -> Indices:
        """Return an order of parts, of C sets, of these and of others, with the first side in the place of its set."""
        place = np.arange(count)
        sets, first = np.unique(self.row, return_index=True)
        place[sets] = count + first
        others = np.ones(parts, dtype=bool)
        others[:count], others[place] = False, False
        return np.concatenate([place, np.flatnonzero(others)])


def sides_of(gaps: Mapping[str, Gaps], most: int) -> Sides | None:
    """Return the sides of the widest jumps of each of C sets, so many at most; None where nothing jumps.

    Notes
    -----
    Sound: every pose is on one side of each jump, or on both.
    """
    if not gaps:
        return None
    width = np.concatenate([one.width for one in gaps.values()], axis=1)
    middle = np.concatenate([one.middle for one in gaps.values()], axis=1)
    widest = np.argsort(-width, axis=1, kind="stable")[:, :most]  # (C, J)
    jumps = (np.take_along_axis(width, widest, axis=1) > 0.0).sum(axis=1)
    choices = np.where(jumps > 0, 2**jumps, 0)
    row = np.repeat(np.arange(len(width)), choices)
    if not len(row):
        return None
    choice = np.arange(len(row)) - np.repeat(np.cumsum(choices) - choices, choices)
    lower, upper = np.full((len(row), width.shape[1]), -np.inf), np.full((len(row), width.shape[1]), np.inf)
    for number in range(widest.shape[1]):
        some = np.flatnonzero(number < jumps[row])
        place = widest[row[some], number]
        beyond = (choice[some] >> number) % 2 == 1
        at = middle[row[some], place]
        lower[some, place] = np.where(beyond, at, -np.inf)
        upper[some, place] = np.where(beyond, np.inf, at)
    windows, begin = {}, 0
    for name, one in gaps.items():
        end = begin + one.width.shape[1]
        windows[name] = Windows(lower[:, begin:end], upper[:, begin:end])
        begin = end
    return Sides(row, windows)
