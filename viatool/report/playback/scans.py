"""Observations as laser scans: what each bin of a LiDAR reads, in the direction in which it looks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from viatool.arrays import Floats, Indices
from viatool.report.playback.messages import ROBOT, RosMessage, header

if TYPE_CHECKING:
    from viatool.channels import Inputs, Quantities
    from viatool.world import Lidar

_EVEN = 0.01  # of the angle between bins, by which that angle may vary
_BEYOND = 1.0 - 1e-6  # of the largest range, from which on a reading is that nothing is there


@dataclass(frozen=True, eq=False)
class LidarScan:
    """How the inputs of a network show one LiDAR as a scan.

    Parameters
    ----------
    inputs : Inputs
        Of the network; n numbers.
    columns : ndarray
        (bins,) inputs that hold the present readings, from right to left.
    angles : ndarray
        (bins,) where they look, in radians counter-clockwise from straight ahead.
    lidar : Lidar
        That reads them.
    topic : str
        What follows the name of what is shown.
    """

    inputs: Inputs
    columns: Indices
    angles: Floats
    lidar: Lidar
    topic: str = "/scan"

    def ranges(self, observation: Floats) -> Floats:
        """Return what is read in an observation (n,), (bins,) metres; infinite where nothing is met.

        A number at the end of a clip stands for every reading beyond, and is shown as that end.
        """
        least, most = (end[0, self.columns] for end in self.inputs.readings(observation[None], within=True))
        found = np.where(np.isfinite(least), least, most)
        nothing = found >= _BEYOND * self.lidar.maximum_range
        if self.lidar.no_return is not None:
            nothing |= np.abs(found - self.lidar.no_return) <= 1.0 - _BEYOND
        return np.where(nothing, np.inf, found)

    def message(self, stamp: int, whose: str, observation: Floats | None, robot: str = ROBOT) -> RosMessage:
        """Return a scan of what is read in an observation (n,); without one, a scan that holds nothing."""
        count = len(self.columns)
        ranges = np.full(count, np.nan) if observation is None else self.ranges(observation)
        fields = {
            "header": header(stamp, robot),
            "angle_min": float(self.angles[0]),
            "angle_max": float(self.angles[-1]),
            "angle_increment": float(self.angles[-1] - self.angles[0]) / max(count - 1, 1),
            "time_increment": 0.0,
            "scan_time": 0.0,
            "range_min": 0.0,  # an error may be below what the sensor gives
            "range_max": float(self.lidar.maximum_range),
            "ranges": ranges.astype(np.float32),
            "intensities": np.zeros(0, np.float32),
        }
        return RosMessage(stamp, f"{whose}{self.topic}", "sensor_msgs/msg/LaserScan", fields)


def scan_views(quantities: Quantities) -> list[LidarScan]:
    """Return how each LiDAR is shown; one whose bins do not look evenly around is not, as no scan can say so."""
    found: list[LidarScan] = []
    for one, _ in quantities.lidars:
        if not one.described:
            continue
        angles, columns = looks(one.sensor), quantities.inputs.newest(one.channel.name)
        if angles[0] > angles[-1]:
            angles, columns = angles[::-1], columns[::-1]
        if _even(angles):
            topic = f"/scan_{len(found) + 1}" if found else "/scan"
            found.append(LidarScan(quantities.inputs, columns, angles, one.sensor, topic))
    return found


def looks(lidar: Lidar) -> Floats:
    """Return where each bin looks: the middle of its rays, or the first if only that counts; (bins,) radians."""
    rays = np.unwrap(lidar.angles()).reshape(lidar.bins, lidar.each)
    return np.asarray(rays[:, 0] if lidar.reduce == "first" else rays.mean(axis=1))


def _even(angles: Floats) -> bool:
    """Tell whether directions that ascend are evenly apart."""
    apart = np.diff(angles)
    return len(apart) < 2 or bool(np.ptp(apart) <= _EVEN * apart.mean())
