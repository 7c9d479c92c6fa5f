"""How well readings of a specification do, each by itself and two against each other."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from viatool.arrays import Booleans, Floats
from viatool.simulate import Proportion
from viatool.simulate.statistics import sign_test

_GOOD = 0.95
"""Share of goals reached from which on nobody looks for a reading with more changes."""
_SOME, _FARTHER = 0.1, 0.1
"""Shares of the goals reached, and of the way that is closed, which are more than a stray drive."""
_ALIKE = 0.01
"""Of the range of an action: differences of commands that come from rounding, timing and sensor noise."""
_NOT_RIGHT = 0.5
"""A reading that explains commands clearly better leaves at most this share of the difference."""


@dataclass(frozen=True)
class Paired:
    """Two readings on the same N scenarios or states.

    Parameters
    ----------
    better, worse : int
        In how many the first one did better than the second, and worse.
    """

    better: int
    worse: int

    @property
    def chance(self) -> float:
        """Return the probability of so uneven a count, to either side, among equals: the exact sign test."""
        return sign_test(self.better, self.worse)


class Evidence(Protocol):
    """What was found of a reading."""

    @property
    def merit(self) -> float:
        """Return what readings are ranked by; more is better."""
        ...

    @property
    def is_known(self) -> bool:
        """Tell whether anything could be found."""
        ...

    @property
    def is_good(self) -> bool:
        """Tell whether a specification that does so well may well be right."""
        ...

    def against(self, other: Evidence) -> Paired:
        """Return how it does against another one."""
        ...

    def surpasses(self, other: Evidence) -> bool:
        """Tell whether it is so much better than another one that it matters, apart from chance."""
        ...

    @property
    def gets_somewhere(self) -> bool:
        """Tell whether it does better than what happens to be right now and then."""
        ...

    def leads(self, other: Evidence, chance: float) -> bool:
        """Tell whether it gets somewhere, or farther than another one beyond so much chance."""
        ...


@dataclass(frozen=True, eq=False)
class Driven:
    """How a policy fared in N scenarios.

    Parameters
    ----------
    outcomes : ndarray
        (N,) success, collision or timeout.
    closed : ndarray
        (N,) share of the way to the goal that was closed at the end, in [0, 1].
    """

    outcomes: NDArray[np.str_]
    closed: Floats
    is_known: ClassVar[bool] = True

    @property
    def reached(self) -> Booleans:
        """Return which goals were reached, (N,)."""
        return np.asarray(self.outcomes == "success")

    def share(self, outcome: str) -> Proportion:
        """Return in how many scenarios the drive ended so."""
        return Proportion(int((self.outcomes == outcome).sum()), len(self.outcomes))

    @property
    def merit(self) -> float:
        """Return the share of goals reached, and half of the way closed where they were not."""
        return float(np.where(self.reached, 1.0, 0.5 * self.closed).mean())

    @property
    def is_good(self) -> bool:
        """Tell whether nearly all goals are reached."""
        return self.share("success").rate >= _GOOD

    def against(self, other: Evidence) -> Paired:
        """Return in how many scenarios one of both alone reached the goal."""
        assert isinstance(other, Driven)
        better, worse = self.reached & ~other.reached, other.reached & ~self.reached
        return Paired(int(better.sum()), int(worse.sum()))

    def surpasses(self, other: Evidence) -> bool:
        """Tell whether more goals are reached."""
        paired = self.against(other)
        return paired.better > paired.worse

    @property
    def gets_somewhere(self) -> bool:
        """Tell whether a tenth of the goals is reached."""
        return self.share("success").rate >= _SOME

    def leads(self, other: Evidence, chance: float) -> bool:
        """Tell whether some goals are reached, or clearly more of the way is closed in clearly more scenarios."""
        assert isinstance(other, Driven)
        if self.gets_somewhere:
            return True
        farther = self.closed - other.closed
        better, worse = int((farther > _FARTHER).sum()), int((farther < -_FARTHER).sum())
        return better > worse and Paired(better, worse).chance < chance


@dataclass(frozen=True, eq=False)
class Compared:
    """How far recorded commands are from what a policy commands.

    Parameters
    ----------
    differences : ndarray
        (N,) the largest over the numbers of a command, each as a share of its range; NaN where nothing is known.
    axes : tuple of str
        Names of the numbers of a command.
    each : ndarray
        (N, A) the differences of each, in its unit.
    """

    differences: Floats
    axes: tuple[str, ...]
    each: Floats

    def quantile(self, share: float) -> float:
        """Return the difference that a share of the states stay within, in ranges of the actions."""
        return float(np.nanquantile(self.differences, share))

    @property
    def is_known(self) -> bool:
        """Tell whether anything could be compared: a reading may need rays that were not recorded."""
        return bool(np.isfinite(self.differences).any())

    @property
    def explained(self) -> int:
        """Return in how many states the policy gives the recorded command, up to what timing and noise make of it."""
        return int((self.differences <= _ALIKE).sum())

    @property
    def merit(self) -> float:
        """Return how small the mean difference is."""
        return -float(np.nanmean(self.differences)) if self.is_known else -np.inf

    @property
    def is_good(self) -> bool:
        """Tell whether the commands of nearly all states are explained."""
        return self.is_known and self.quantile(0.9) <= 2.0 * _ALIKE

    def against(self, other: Evidence) -> Paired:
        """Return in how many states one of both is clearly nearer to the recorded command."""
        assert isinstance(other, Compared)
        nearer = other.differences - self.differences
        return Paired(int((nearer > _ALIKE).sum()), int((nearer < -_ALIKE).sum()))

    def surpasses(self, other: Evidence) -> bool:
        """Tell whether the mean difference is at most half as large: states of one drive are alike."""
        return self.merit >= _NOT_RIGHT * other.merit

    @property
    def gets_somewhere(self) -> bool:
        """Return true: how near commands are is told by figures."""
        return True

    def leads(self, other: Evidence, chance: float) -> bool:
        """Return true: recorded commands are compared quickly, however many readings there are."""
        return True
