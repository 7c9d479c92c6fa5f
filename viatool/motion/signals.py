"""One number of a motion over time: held, changed at a held rate until a limit, or approaching what it is told.

A signal is a function x of time that a command and the state before it decide, two entries of what is held. All of
these are monotone in time, in the command and in the state, and never jump.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from viatool.arrays import Floats, Hull
from viatool.motion.straight import StraightSignal, combined
from viatool.rounding import LAST_PLACE, SLIGHTLY_MORE
from viatool.sets.forms import Forms, clip_line


@dataclass(frozen=True)
class MotionSignal(ABC):
    """A number of the motion.

    Parameters
    ----------
    column : int
        Which entry of what is held commands it.
    """

    column: int

    @abstractmethod
    def at(self, held: Floats, time: Floats | float) -> Floats:
        """Return its value (...) after some seconds (...) of what is held (..., H)."""

    @abstractmethod
    def integral(self, held: Floats, time: Floats | float) -> Floats:
        """Return its integral over the first seconds (...), (...)."""

    @abstractmethod
    def kink(self, held: Floats) -> Floats:
        """Return after how many seconds (...) it stays as it is; before it is linear in time."""

    @abstractmethod
    def slope(self, lower: Floats, upper: Floats) -> Floats:
        """Bound how fast it changes, (...) at least 0."""

    @abstractmethod
    def radii(self, half: Floats) -> tuple[Floats, Floats]:
        """Return r and g: any member of boxes within `half` (..., H) is within ``r + g t`` of the centre's after t."""

    @abstractmethod
    def form(self, held: Forms, ends: Hull, time: float) -> Forms:
        """Return its value after some time, (C, 1), in the symbols of what is held, (C, H), between ends (C, H) twice.

        **Sound:** yes.
        """

    def reached(self, lower: Floats, upper: Floats, time: float) -> tuple[Floats, Floats]:
        """Return its least and largest value after some time, over boxes (..., H), rounded outward."""
        low, high = self.at(lower, time), self.at(upper, time)
        return low - self.rounding(lower, time), high + self.rounding(upper, time)

    @abstractmethod
    def rounding(self, held: Floats, time: float) -> Floats:
        """Return by how much `at` may be off, (...)."""

    def ends(self, lower: Floats, upper: Floats, time: float) -> tuple[Floats, Floats]:
        """Return its least and largest value until some time, over boxes (..., H)."""
        first = (self.at(lower, 0.0), self.at(lower, time))
        last = (self.at(upper, 0.0), self.at(upper, time))
        return np.minimum(*first), np.maximum(*last)

    def largest(self, lower: Floats, upper: Floats, time: float) -> Floats:
        """Bound its size until some time, over boxes (..., H)."""
        low, high = self.ends(lower, upper, time)
        return np.maximum(np.abs(low), np.abs(high))

    def last(self, lower: Floats, upper: Floats, time: float) -> Floats:
        """Bound its size after some time, over boxes (..., H)."""
        return np.maximum(np.abs(self.at(lower, time)), np.abs(self.at(upper, time)))


@dataclass(frozen=True)
class HeldSignal(MotionSignal):
    """What is commanded, at once."""

    def at(self, held: Floats, time: Floats | float) -> Floats:
        """See `MotionSignal`."""
        return held[..., self.column] + 0.0 * np.asarray(time)

    def integral(self, held: Floats, time: Floats | float) -> Floats:
        """See `MotionSignal`."""
        return np.asarray(held[..., self.column] * time)

    def kink(self, held: Floats) -> Floats:
        """Return none."""
        return np.full(held.shape[:-1], np.inf)

    def slope(self, lower: Floats, upper: Floats) -> Floats:
        """Return nothing."""
        return np.zeros(lower.shape[:-1])

    def radii(self, half: Floats) -> tuple[Floats, Floats]:
        """See `MotionSignal`."""
        return half[..., self.column], np.zeros(half.shape[:-1])

    def rounding(self, held: Floats, time: float) -> Floats:
        """Return nothing."""
        return np.zeros(held.shape[:-1])

    def form(self, held: Forms, ends: Hull, time: float) -> Forms:
        """See `MotionSignal`."""
        return self.straight(*ends, time).form(held, time)

    def straight(self, lower: Floats, upper: Floats, until: float) -> StraightSignal:
        """Return it as a straight signal over boxes (C, H)."""
        none = np.zeros(len(lower))
        return StraightSignal(self.column, None, np.ones(len(lower)), none, none)


@dataclass(frozen=True)
class IntegratedSignal(MotionSignal):
    """What grows at the rate that is commanded, and stops changing at its limits.

    Parameters
    ----------
    state : int
        Which entry of what is held it begins with.
    low, high : float
        Its limits, infinite where there are none.

    Notes
    -----
    ``x(t) = clip(x_0 + r t, min(low, x_0), max(high, x_0))``: what begins beyond a limit goes no further, and comes
    back. The result of a clip is no further from another one than its three arguments are, so the radii are those of
    ``x_0 + r t``.
    """

    state: int
    low: float = -np.inf
    high: float = np.inf

    def at(self, held: Floats, time: Floats | float) -> Floats:
        """See `MotionSignal`."""
        begin, rate = held[..., self.state], held[..., self.column]
        low, high = np.minimum(self.low, begin), np.maximum(self.high, begin)
        return np.asarray(np.clip(begin + rate * time, low, high))

    def integral(self, held: Floats, time: Floats | float) -> Floats:
        """See `MotionSignal`."""
        begin, rate = held[..., self.state], held[..., self.column]
        growing = np.minimum(time, self.kink(held))
        rest = np.maximum(np.asarray(time) - growing, 0.0)
        return np.asarray(begin * growing + 0.5 * rate * growing * growing + self.at(held, growing) * rest)

    def kink(self, held: Floats) -> Floats:
        """See `MotionSignal`."""
        begin, rate = held[..., self.state], held[..., self.column]
        far = np.where(rate > 0.0, np.maximum(self.high, begin), np.minimum(self.low, begin)) - begin
        moving = rate != 0.0  # true of NaN
        return np.where(moving, far / np.where(moving, rate, 1.0), np.inf)

    def slope(self, lower: Floats, upper: Floats) -> Floats:
        """See `MotionSignal`."""
        return np.maximum(np.abs(lower[..., self.column]), np.abs(upper[..., self.column]))

    def radii(self, half: Floats) -> tuple[Floats, Floats]:
        """See `MotionSignal`."""
        return half[..., self.state], half[..., self.column]

    def reached(self, lower: Floats, upper: Floats, time: float) -> tuple[Floats, Floats]:
        """See `MotionSignal`; what is at its limit is not rounded beyond it."""
        least, most = super().reached(lower, upper, time)
        return (
            np.maximum(least, np.minimum(self.low, lower[..., self.state])),
            np.minimum(most, np.maximum(self.high, upper[..., self.state])),
        )

    def rounding(self, held: Floats, time: float) -> Floats:
        """Return some roundings of its parts; what does not change is exact."""
        way = np.abs(held[..., self.column] * time)
        return np.where(way > 0.0, 4.0 * LAST_PLACE * (np.abs(held[..., self.state]) + way), 0.0)

    def form(self, held: Forms, ends: Hull, time: float) -> Forms:
        """See `MotionSignal`."""
        return self._between(*ends, time, time).form(held, time)

    def straight(self, lower: Floats, upper: Floats, until: float) -> StraightSignal:
        """Return it as a straight signal over boxes (C, H) at any time until then."""
        return self._between(lower, upper, 0.0, until)

    def _between(self, lower: Floats, upper: Floats, since: float, until: float) -> StraightSignal:
        """Return it as a straight signal between two times.

        Limits that lie beyond, where the number begins, are no further from the usual ones than it begins from these.
        """
        least, most = (
            [end[..., self.state] + end[..., self.column] * time for time in (since, until)]
            for end in (lower, upper)
        )
        share, shift, radius = clip_line(np.minimum(*least), np.maximum(*most), self.low, self.high)
        beyond = np.maximum(upper[..., self.state] - self.high, self.low - lower[..., self.state])
        radius = (radius + np.maximum(beyond, 0.0)) * SLIGHTLY_MORE
        return StraightSignal(self.state, self.column, share, shift, radius)


@dataclass(frozen=True)
class ApproachingSignal(MotionSignal):
    """What goes to the value that is commanded at a rate of its own, and stays there.

    Parameters
    ----------
    state : int
        Which entry of what is held it begins with.
    rate : float
        How fast, positive.

    Notes
    -----
    ``x(t) = clip(x*, x_0 - rate t, x_0 + rate t)``, so the radius is the larger one of both.
    """

    state: int
    rate: float

    def at(self, held: Floats, time: Floats | float) -> Floats:
        """See `MotionSignal`."""
        begin, way = held[..., self.state], self.rate * np.asarray(time)
        return np.asarray(np.clip(held[..., self.column], begin - way, begin + way))

    def integral(self, held: Floats, time: Floats | float) -> Floats:
        """See `MotionSignal`."""
        begin, moving = held[..., self.state], np.minimum(time, self.kink(held))
        mean = 0.5 * (begin + self.at(held, moving))
        return np.asarray(mean * moving + held[..., self.column] * (np.asarray(time) - moving))

    def kink(self, held: Floats) -> Floats:
        """See `MotionSignal`."""
        return np.asarray(np.abs(held[..., self.column] - held[..., self.state]) / self.rate)

    def slope(self, lower: Floats, upper: Floats) -> Floats:
        """See `MotionSignal`."""
        return np.full(lower.shape[:-1], self.rate)

    def radii(self, half: Floats) -> tuple[Floats, Floats]:
        """See `MotionSignal`."""
        return np.maximum(half[..., self.state], half[..., self.column]), np.zeros(half.shape[:-1])

    def reached(self, lower: Floats, upper: Floats, time: float) -> tuple[Floats, Floats]:
        """See `MotionSignal`; it is never beyond both of where it begins and where it goes."""
        least, most = super().reached(lower, upper, time)
        both = [self.state, self.column]
        return np.maximum(least, lower[..., both].min(axis=-1)), np.minimum(
            most, upper[..., both].max(axis=-1)
        )

    def rounding(self, held: Floats, time: float) -> Floats:
        """Return some roundings of its parts: the way is at most from one to the other."""
        return 4.0 * LAST_PLACE * (np.abs(held[..., self.state]) + np.abs(held[..., self.column]))

    def form(self, held: Forms, ends: Hull, time: float) -> Forms:
        """See `MotionSignal`: ``x_0 + clip(x* - x_0, -rate t, rate t)``."""
        both = np.zeros_like(held.centre)
        both[:, self.column], both[:, self.state] = 1.0, -1.0
        none, way = np.zeros(len(both)), self.rate * time
        missing = combined(held, both, none, none)
        least = np.maximum(missing.lower[:, 0], ends[0][:, self.column] - ends[1][:, self.state])
        most = np.minimum(missing.upper[:, 0], ends[1][:, self.column] - ends[0][:, self.state])
        share, shift, radius = clip_line(np.minimum(least, most), np.maximum(least, most), -way, way)
        both[:, self.column], both[:, self.state] = share, 1.0 - share
        return combined(held, both, shift, radius)
