"""Activations that consist of straight lines: their values and ranges, without the intervals of curved ones."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from viatool.arrays import Booleans, Floats, Indices
from viatool.rounding import LAST_PLACE
from viatool.taylor.interval import Interval, step_down, step_up

EVERYWHERE = float(np.finfo(np.float64).max)
"""What is piecewise linear is known wherever a number is."""


@dataclass(frozen=True, eq=False)
class StraightLines:
    """A continuous curve of K straight lines, ``slope x + shift``, from left to right.

    Parameters
    ----------
    breaks : ndarray
        ``(K-1,)`` where lines meet.
    slopes : ndarray
        ``(K,)`` exact.
    lowest, highest : ndarray
        ``(K,)`` bounds of the shifts.
    """

    breaks: Floats
    slopes: Floats
    lowest: Floats
    highest: Floats

    @cached_property
    def _rounded(self) -> Booleans:
        """Tell on which lines a value may be rounded, (K,); not where it is 0, the argument or its negative."""
        exact = np.isin(self.slopes, (-1.0, 0.0, 1.0)) & (self.lowest == 0.0) & (self.highest == 0.0)
        return np.asarray(~exact)

    def enclose(self, x: Floats) -> Interval:
        """Enclose the curve at points. **Sound:** yes."""
        line = self.at(x)
        slope = self.slopes[line]
        moved = np.where(slope == 0.0, 0.0, slope * x)  # also of an unlimited x
        if not self._rounded.any():
            return Interval(moved, moved)
        lower, upper = moved + self.lowest[line], moved + self.highest[line]
        slack = 2.0 * LAST_PLACE * np.minimum(np.abs(moved), EVERYWHERE)
        rounded = self._rounded[line]
        return Interval(
            np.where(rounded, step_down(lower, 2) - slack, lower),
            np.where(rounded, step_up(upper, 2) + slack, upper),
        )

    def range(self, lower: Floats, upper: Floats) -> Interval:
        """Enclose the curve over intervals; everything over one with an end that is no number. **Sound:** yes."""
        edges = () if self._is_increasing else self.breaks
        found = self.enclose(np.stack([lower, upper, *(np.clip(edge, lower, upper) for edge in edges)]))
        known = (lower >= -EVERYWHERE) & (upper <= EVERYWHERE)
        return Interval(
            np.where(known, found.lower.min(axis=0), -np.inf),
            np.where(known, found.upper.max(axis=0), np.inf),
        )

    @cached_property
    def _is_increasing(self) -> bool:
        return bool((self.slopes >= 0.0).all())

    def at(self, x: Floats) -> Indices:
        """Return the line of each point; where two meet, the right one."""
        line = np.zeros(x.shape, dtype=np.intp)
        for edge in self.breaks.tolist():
            line += x >= edge
        return line
