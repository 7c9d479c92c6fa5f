"""The rays of one LiDAR channel, and its readings."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from viatool.arrays import Floats, Reals, Singles
from viatool.world import Lidar


@dataclass(frozen=True, eq=False)
class Fan:
    """The rays of one LiDAR channel.

    Parameters
    ----------
    lidar : Lidar
        Its field of view, rays, bins and limits.
    """

    lidar: Lidar

    def __len__(self) -> int:
        """Return R, the number of rays that are cast."""
        return int(self.directions.shape[1])

    @cached_property
    def directions(self) -> Floats:
        """Unit vectors of the rays in the robot's frame, (2, R), in the order in which ranges are read.

        First rays of all bins, second rays of all bins, ...: a minimum over the first axis is fast. Where the first ray
        of a bin alone counts, no others are cast.
        """
        lidar = self.lidar
        by_bin = np.arange(lidar.rays).reshape(lidar.bins, lidar.each)
        if lidar.reduce == "first":
            by_bin = by_bin[:, :1]
        return lidar.directions()[:, by_bin.T.ravel()]

    @cached_property
    def quick_directions(self) -> Singles:
        """The same in float32, in which rays are cast in half the time."""
        return self.directions.astype(np.float32)

    def read(self, ranges: Reals) -> Reals:
        """Return what is observed of ranges (B, R): the readings of the bins within the LiDAR's limits, (B, bins) m."""
        lidar = self.lidar
        least, most = lidar.minimum_range, lidar.maximum_range
        if lidar.no_return is not None:
            missed = np.asarray(lidar.no_return, ranges.dtype)
            ranges = np.where(ranges < most, np.maximum(ranges, least), missed)
            least, most = -np.inf, np.inf
        elif lidar.reduce == "mean":
            ranges = np.clip(ranges, least, most)
        by_bin = ranges.reshape(len(ranges), -1, lidar.bins)
        binned: Reals = by_bin.mean(axis=1) if lidar.reduce == "mean" else by_bin.min(axis=1)
        return binned if np.isinf(most) else np.clip(binned, least, most)
