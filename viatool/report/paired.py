"""By how much two runs differ beyond chance: the same subjects in both side by side, and intervals of differences."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from viatool.arrays import Floats
from viatool.report.sections import Share
from viatool.simulate.statistics import Proportion, sign_test


@dataclass(frozen=True)
class PairedSubjects:
    """Subjects that two runs have in common.

    Parameters
    ----------
    both, before, after, neither : int
        How many hold in both runs, in one alone, and in none; of figures that are more than that, `before` and `after`
        count those that are larger there, and `both` those that are the same.
    holding : bool
        Whether subjects hold or not, so that their share is a rate.
    """

    both: int
    before: int
    after: int
    neither: int
    holding: bool

    @classmethod
    def of(cls, before: Mapping[str, float], after: Mapping[str, float]) -> PairedSubjects:
        """Pair what two runs tell of each subject: a figure of which more is better, 1 and 0 where it holds or not."""
        pairs = [(before[name], after[name]) for name in before if name in after]
        holding = all(figure in (0.0, 1.0) for pair in pairs for figure in pair)
        worse, better = (sum(sign * (new - old) > 0.0 for old, new in pairs) for sign in (-1, 1))
        neither = sum(pair == (0.0, 0.0) for pair in pairs) if holding else 0
        return cls(len(pairs) - worse - better - neither, worse, better, neither, holding)

    @property
    def total(self) -> int:
        """Return how many subjects both runs have."""
        return self.both + self.before + self.after + self.neither

    @property
    def chance(self) -> float:
        """Return the probability of so uneven a count among equals: the exact sign test, of rates McNemar's."""
        return sign_test(self.before, self.after)

    @property
    def interval(self) -> tuple[float, float]:
        """Return the 95 % interval of the difference of both rates.

        Notes
        -----
        Newcombe's tenth method for paired proportions (Statistics in Medicine 17, 1998): Wilson's intervals of both
        rates, joined by how they go together. Subjects are taken for independent of each other.
        """
        old, new = (Proportion(self.both + alone, self.total) for alone in (self.before, self.after))
        return _apart(old, new, self._together)

    @property
    def _together(self) -> float:
        """Return the correlation of both runs, drawn nearer to 0 for small numbers if it is positive."""
        product = self.both * self.neither - self.before * self.after
        sides = (self.both + self.before) * (self.after + self.neither)
        sides *= (self.both + self.after) * (self.before + self.neither)
        if not sides:
            return 0.0
        return (max(product - self.total / 2, 0.0) if product > 0 else product) / math.sqrt(sides)


@dataclass(frozen=True, eq=False)
class PairedGroups:
    """Subjects that two runs have in common, by groups: episodes of states, which are not independent of each other.

    Parameters
    ----------
    gained, size : ndarray
        (G,) by how many subjects more hold in the later run, and how many there are.
    """

    gained: Floats
    size: Floats

    LEAST = 5
    """Groups of which there is an interval."""

    @classmethod
    def of(
        cls, before: Mapping[str, float], after: Mapping[str, float], groups: Mapping[str, str]
    ) -> PairedGroups:
        """Pair subjects that hold (1) or do not (0), by the names of the groups that they are in."""
        gained, size = Counter[str](), Counter[str]()
        for name in (name for name in before if name in after):
            gained[groups[name]] += int(after[name] - before[name])
            size[groups[name]] += 1
        return cls(np.array([gained[name] for name in size], float), np.array([*size.values()], float))

    @property
    def chance(self) -> float:
        """Return the probability of as uneven a count of groups that gain and lose: the exact sign test."""
        return sign_test(int((self.gained < 0).sum()), int((self.gained > 0).sum()))

    @property
    def interval(self) -> tuple[float, float] | None:
        """Return the 95 % interval of the difference of both rates; None of too few groups, or where none differs.

        Notes
        -----
        Whole groups are drawn again, with replacement (the percentile bootstrap, of a fixed seed).
        """
        count = len(self.size)
        if count < self.LEAST or not self.gained.any():
            return None
        drawn = np.random.default_rng(0).integers(count, size=(_DRAWS, count))
        rates = self.gained[drawn].sum(axis=1) / self.size[drawn].sum(axis=1)
        low, high = np.quantile(rates, (0.025, 0.975)).tolist()
        return low, high


_DRAWS = 4000


def interval_of(before: Share, after: Share) -> tuple[float, float]:
    """Return the 95 % interval of the difference of two rates of different subjects (Newcombe's tenth method)."""
    return _apart(Proportion(before.part, before.total), Proportion(after.part, after.total), 0.0)


def _apart(old: Proportion, new: Proportion, together: float) -> tuple[float, float]:
    (old_low, old_high), (new_low, new_high) = old.interval, new.interval
    down, up = (new.rate - new_low, old_high - old.rate), (new_high - new.rate, old.rate - old_low)
    middle = new.rate - old.rate
    below, above = (math.sqrt(max(a * a - 2 * together * a * b + b * b, 0.0)) for a, b in (down, up))
    return max(middle - below, -1.0), min(middle + above, 1.0)


def apart(names: Iterable[str]) -> list[str]:
    """Return names of which none is there twice: later ones are numbered."""
    seen = Counter[str]()
    found = []
    for name in names:
        seen[name] += 1
        found.append(name if seen[name] == 1 else f"{name} ({seen[name]})")
    return found
