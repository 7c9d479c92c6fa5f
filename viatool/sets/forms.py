"""Boxes of poses, and linear forms over them: what a quantity is at every pose of a box."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viatool.arrays import Booleans, Floats, Indices, Plane
from viatool.rounding import FEW_ROUNDINGS
from viatool.sets.bounds import require_ordered


@dataclass(frozen=True, eq=False)
class PoseBoxes:
    """C boxes of poses.

    Parameters
    ----------
    centre : ndarray
        (C, 3) x, y, theta; metres and radians.
    radius : ndarray
        (C, 3) half-widths.
    """

    centre: Floats
    radius: Floats

    def __len__(self) -> int:
        """Return the number of boxes."""
        return len(self.centre)

    def select(self, which: NDArray[Any] | slice) -> PoseBoxes:
        """Return some of the boxes."""
        return PoseBoxes(self.centre[which], self.radius[which])

    def checked(self) -> PoseBoxes:
        """Return the boxes themselves; BoundsError if one of them is empty, unbounded or NaN."""
        require_ordered("half-widths of poses", np.zeros_like(self.radius), self.radius, finite=True)
        require_ordered("poses", self.centre, self.centre, finite=True)
        return self

    def distinct(self) -> tuple[PoseBoxes, Indices]:
        """Return boxes none of which is there twice, and which of them each one is, (C,)."""
        ends = np.concatenate([self.centre, self.radius], axis=1)
        first, which = np.unique(ends, axis=0, return_index=True, return_inverse=True)[1:]
        return self.select(first), which.reshape(-1)

    @property
    def places(self) -> Plane:
        """Return the middle places x + iy, (C,)."""
        return np.asarray(self.centre[:, 0] + 1j * self.centre[:, 1])

    @property
    def corners(self) -> Floats:
        """Return the outermost places x, y of boxes, (C, 4, 2)."""
        signs = np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])
        return np.asarray(self.centre[:, None, :2] + signs * self.radius[:, None, :2])

    @property
    def extent(self) -> Floats:
        """Return how far any place of a box is from its middle at most, (C,) metres."""
        return np.hypot(self.radius[:, 0], self.radius[:, 1])

    @property
    def turn(self) -> Floats:
        """Return how far any heading of a box is from its middle at most, (C,) radians."""
        return self.radius[:, 2]


@dataclass(frozen=True, eq=False)
class Forms:
    """K quantities of each of C boxes: ``centre + slope . (pose - middle) + [-rest, rest]``.

    Parameters
    ----------
    centre : ndarray
        (C, K).
    slope : ndarray
        (C, 3, K) change with x, y and theta, scaled by the half-widths: what the full half-width adds.
    rest : ndarray
        (C, K) at least 0; a different number for each pose and quantity.
    """

    centre: Floats
    slope: Floats
    rest: Floats

    @classmethod
    def between(cls, lower: Floats, upper: Floats) -> Forms:
        """Return quantities of which nothing is known but their bounds, (C, K) each."""
        middle = 0.5 * (lower + upper)
        return cls(
            middle, np.zeros((len(middle), 3, middle.shape[1])), np.maximum(upper - middle, middle - lower)
        )

    def checked(self) -> Forms:
        """Return the forms themselves; BoundsError if one of them is unbounded or NaN, or its rest negative."""
        require_ordered("rests of linear forms", np.zeros_like(self.rest), self.rest, finite=True)
        require_ordered("linear forms", self.lower, self.upper, finite=True)
        return self

    def select(self, which: NDArray[Any] | slice) -> Forms:
        """Return those of some of the boxes."""
        return Forms(self.centre[which], self.slope[which], self.rest[which])

    @classmethod
    def concatenate(cls, parts: Sequence[Forms]) -> Forms:
        """Return the boxes of all parts one after the other."""
        return cls(
            *(np.concatenate([getattr(part, name) for part in parts]) for name in ("centre", "slope", "rest"))
        )

    @classmethod
    def beside(cls, *parts: Forms) -> Forms:
        """Return the quantities of all parts, one beside the other; symbols beyond those that a part has leave it."""
        symbols = max(part.slope.shape[1] for part in parts)
        slopes = [
            np.pad(part.slope, ((0, 0), (0, symbols - part.slope.shape[1]), (0, 0)))
            if part.slope.shape[1] < symbols
            else part.slope
            for part in parts
        ]
        return cls(
            np.concatenate([part.centre for part in parts], axis=1),
            np.concatenate(slopes, axis=2),
            np.concatenate([part.rest for part in parts], axis=1),
        )

    @classmethod
    def choose(cls, holds: Booleans, form: Forms, other: Forms) -> Forms:
        """Return one form or the other for each box, by what holds for it, (C,)."""
        return cls.where(np.broadcast_to(holds[:, None], form.centre.shape), form, other)

    @classmethod
    def where(cls, holds: Booleans, form: Forms, other: Forms) -> Forms:
        """Return one form or the other for each quantity of each box, by what holds for it, (C, K)."""
        return cls(
            np.where(holds, form.centre, other.centre),
            np.where(holds[:, None], form.slope, other.slope),
            np.where(holds, form.rest, other.rest),
        )

    @property
    def lower(self) -> Floats:
        """Return lower bounds, (C, K)."""
        return np.asarray(self.centre - np.abs(self.slope).sum(axis=1) - self.rest)

    @property
    def upper(self) -> Floats:
        """Return upper bounds, (C, K)."""
        return np.asarray(self.centre + np.abs(self.slope).sum(axis=1) + self.rest)

    def clipped(self, low: float | Floats, high: float | Floats) -> Forms:
        """Keep quantities within ranges, (C, K) or one; where they may leave it, take the chord's share of their slope.

        Notes
        -----
        Sound: yes, also of a clip in float32.
        """
        lower, upper = self.lower, self.upper
        if ((lower >= low) & (upper <= high)).all():
            return self
        share, middle, radius = clip_line(lower, upper, low, high)
        known = (np.where(np.isfinite(end), np.abs(end), 0.0) for end in (low, high))
        spare = FEW_ROUNDINGS * (1.0 + sum(known))
        return Forms(
            share * self.centre + middle, share[:, None] * self.slope, radius + share * self.rest + spare
        )


def clip_line(
    lower: Floats, upper: Floats, low: float | Floats, high: float | Floats
) -> tuple[Floats, Floats, Floats]:
    """Return a, b and r so that ``clip(x, low, high)`` is within r of ``a x + b`` for x between bounds (...)."""
    ends = np.clip(lower, low, high), np.clip(upper, low, high)
    width = upper - lower
    share = np.where(width > 0.0, (ends[1] - ends[0]) / np.where(width > 0.0, width, 1.0), 0.0)
    # of clip(x) - share x on [lower, upper]: piecewise linear, with corners at both ends of the range
    corners = [lower, upper, np.clip(low, lower, upper), np.clip(high, lower, upper)]
    left = np.stack([np.clip(corner, low, high) - share * corner for corner in corners])
    least, most = left.min(axis=0), left.max(axis=0)
    return share, 0.5 * (least + most), 0.5 * (most - least)
