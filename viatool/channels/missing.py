"""Rays that return nothing, and what bins read of which they are some."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from viatool.arrays import Floats, Hull, Indices
from viatool.world import Lidar


@dataclass(frozen=True, eq=False)
class Missing:
    """Bins of one scan of which up to `count` have a ray that returns nothing.

    Parameters
    ----------
    count : int
        How many rays at once.
    columns : ndarray
        (E,) the inputs that hold the bins.
    lidar : Lidar
        Says how rays make bins.
    """

    count: int
    columns: Indices
    lidar: Lidar

    @property
    def reading(self) -> float:
        """Return what a ray reads that returns nothing."""
        lidar = self.lidar
        return lidar.maximum_range if lidar.no_return is None else lidar.no_return

    @property
    def is_one(self) -> bool:
        """Tell whether a bin is one ray, so that its reading is known when the ray returns nothing."""
        return self.lidar.each == 1 or self.lidar.reduce == "first"

    def bounds(
        self, lower: Floats, upper: Floats, beyond: Floats | float = 0.0, others: Floats | None = None
    ) -> Hull:
        """Bound what bins (B, E) read of which a ray returns nothing, of bounds of what they read else.

        Rays that are left may read beyond the limits of the LiDAR, and beyond what is read where nothing is met, by
        (E,) m. `others` (B, E) bounds what is read at most of the rays that are left, where that is known.

        Notes
        -----
        Sound: yes. Of the least of several rays that were recorded nothing is known of the others: they may read
        anything up to the maximum. A mean changes by what a ray reads then instead of anything within the limits, once
        for each.
        """
        lidar, reading = self.lidar, self.reading
        if self.is_one:
            return np.full_like(lower, reading), np.full_like(upper, reading)
        least, most = lidar.minimum_range - beyond, lidar.maximum_range + beyond
        ends = np.minimum(least, reading - beyond), np.maximum(most, reading + beyond)
        if lidar.reduce == "minimum":
            known = ends[1] if others is None else np.minimum(others, ends[1])
            return np.minimum(lower, reading), np.maximum(upper, known)
        share = min(self.count, lidar.each) / lidar.each
        down = share * np.minimum(reading - most, 0.0)
        up = share * np.maximum(reading - least, 0.0)
        return np.maximum(lower + down, np.minimum(lower, ends[0])), np.minimum(
            upper + up, np.maximum(upper, ends[1])
        )
