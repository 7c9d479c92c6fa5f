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

    @cached_property
    def directions(self) -> Floats:
        """Unit vectors of the rays in the robot's frame, (2, R), in the order in which ranges are read.

        First rays of all bins, second rays of all bins, ...: a minimum over the first axis is fast.
        """
        lidar = self.lidar
        order = np.arange(lidar.rays).reshape(lidar.bins, lidar.rays // lidar.bins).T.ravel()
        return lidar.directions()[:, order]

    @cached_property
    def quick_directions(self) -> Singles:
        """The same in float32, in which rays are cast in half the time."""
        return self.directions.astype(np.float32)

    def read(self, ranges: Reals) -> Reals:
        """Return the least range of each bin within the LiDAR's limits, (B, bins) m, of ranges (B, R)."""
        lidar = self.lidar
        binned = ranges.reshape(len(ranges), -1, lidar.bins).min(axis=1)
        clipped: Reals = np.clip(binned, lidar.minimum_range, lidar.maximum_range)
        return clipped
