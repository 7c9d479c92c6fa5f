"""Parts of a box of starts, and how it is cut into finer ones. However that is done, each start lies in a part."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from viatool.arrays import Booleans, Floats, Indices
from viatool.rounding import SLIGHTLY_MORE
from viatool.sets.forms import Forms


@dataclass(frozen=True, eq=False)
class Starts:
    """P parts of the box of starts.

    Parameters
    ----------
    lower, upper : ndarray
        (P, 3 + K) ends of x, y, theta and what stands behind them.
    """

    lower: Floats
    upper: Floats

    def __len__(self) -> int:
        """Return P."""
        return len(self.lower)

    @property
    def forms(self) -> Forms:
        """Return them as forms, one symbol for each side."""
        centre = 0.5 * (self.lower + self.upper)
        radius = np.maximum(self.upper - centre, centre - self.lower) * SLIGHTLY_MORE
        return Forms(centre, radius[:, :, None] * np.eye(radius.shape[1]), np.zeros_like(centre))

    def are_wide(self, rows: Indices, answers: Floats) -> Booleans:
        """Tell which parts have an extent along the side that is answered to most, (R, 3 + K) answers."""
        return np.asarray((self.upper - self.lower)[rows, answers.argmax(axis=1)] > 0.0)

    def halved(self, rows: Indices, answers: Floats) -> Starts:
        """Return both halves of some parts, each across the side that is answered to most; they meet in the middle."""
        lower, upper = self.lower[rows], self.upper[rows]
        each, middle, axis = np.arange(len(rows)), 0.5 * (lower + upper), answers.argmax(axis=1)
        first, last = lower.copy(), upper.copy()
        last[each, axis] = first[each, axis] = middle[each, axis]
        return Starts(np.concatenate([lower, first]), np.concatenate([last, upper]))

    def gridded(self, answers: Floats, most: int) -> Starts:
        """Cut the only part by a grid of 2 to `most` pieces, finer along sides that are answered to more, (3 + K,).

        In the root of the answers: a compromise between sides, and answers, that are equally long.
        """
        lower, upper = self.lower[0], self.upper[0]
        weight = np.sqrt(np.where(upper > lower, answers / answers.max(), 0.0))
        sides = np.flatnonzero(weight)
        finest = (most / weight[sides].prod()) ** (1.0 / len(sides))
        while (counts := np.maximum(np.round(finest * weight), 1.0).astype(np.int64)).prod() > most:
            finest *= 0.99
        counts[weight.argmax()] = max(counts[weight.argmax()], 2)
        place = np.stack(np.unravel_index(np.arange(counts.prod()), counts), axis=1)
        edges = [np.linspace(low, high, n + 1) for low, high, n in zip(lower, upper, counts, strict=True)]
        for edge, last in zip(edges, upper, strict=True):
            edge[-1] = last
        return Starts(
            np.stack([edge[at] for edge, at in zip(edges, place.T, strict=True)], axis=1),
            np.stack([edge[at + 1] for edge, at in zip(edges, place.T, strict=True)], axis=1),
        )
