"""Laser scans to the bins that a policy observes."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from viatool.arrays import Floats, Indices, Singles
from viatool.errors import TrajectoryError

if TYPE_CHECKING:
    from viatool.policy import LidarSpecification


@dataclass(frozen=True, eq=False)
class Scans:
    """S laser scans in the order of recording: some of a bag, so that not all of its ranges are in memory at once.

    Parameters
    ----------
    stamps, received : ndarray
        (S,) nanoseconds: when measured, and when recorded.
    ranges : tuple of ndarray
        S arrays of readings in metres, float32 as recorded.
    geometry : ndarray
        (S, 4) angle of the first ray and between rays in radians, least and largest range in metres.
    frame : str
        In which they were measured.
    """

    stamps: Indices
    received: Indices
    ranges: tuple[Singles, ...]
    geometry: Floats
    frame: str

    def __len__(self) -> int:
        """Return the number of scans."""
        return len(self.stamps)


@dataclass
class Readings:
    """What was seen of the scans of a bag: readings within the policy's field of view by kind, rays, and ranges."""

    total: int = 0
    absent: int = 0
    beyond: int = 0
    too_near: int = 0
    rays: set[int] = field(default_factory=set)
    least: float = -np.inf
    largest: float = np.inf

    def notes(self, lidar: LidarSpecification) -> list[str]:
        """Say in words what became of readings that are not distances, and how the sensors differ."""
        found = []
        if sorted(self.rays) != [lidar.rays]:
            rays = ", ".join(map(str, sorted(self.rays)))
            found.append(f"scans of {rays} rays binned like the policy's {lidar.rays}")
        if self.absent:
            found.append(
                f"{self.absent:,} of {self.total:,} readings are not measurements (NaN, or below the sensor's "
                f"least range of {self.least:g} m) and were left out"
            )
        if self.beyond:
            found.append(
                f"{self.beyond:,} of {self.total:,} readings without an echo read {lidar.maximum_range:g} m"
            )
        if self.too_near:
            found.append(f"{self.too_near:,} readings of -inf (too near) read {lidar.minimum_range:g} m")
        if self.largest < lidar.maximum_range - 1e-6:
            found.append(
                f"the recorded sensor sees {self.largest:g} m far, the policy's LiDAR {lidar.maximum_range:g} m"
            )
        return found


def bin_scans(scans: Scans, lidar: LidarSpecification, yaw: float, side: int, seen: Readings) -> Floats:
    """Return the least distance in each bin, as the simulated sensor does.

    Parameters
    ----------
    scans : Scans
        S scans.
    lidar : LidarSpecification
        What the policy observes: each recorded ray belongs to the bin of the nearest specified ray.
    yaw : float
        Heading of the sensor on the robot, in radians.
    side : int
        1 for a sensor that stands upright, -1 for one that hangs upside down: its rays then run clockwise.
    seen : Readings
        Counts on.

    Returns
    -------
    ndarray
        (S, bins) metres, clipped to the specified range, NaN for a bin without a measurement.

    Raises
    ------
    TrajectoryError
        If a bin has no ray at all, so that the sensor does not see what the policy observes.
    """
    binned = np.empty((len(scans), lidar.bins))
    shapes = np.column_stack([scans.geometry, [len(ranges) for ranges in scans.ranges]])
    kinds, kind = np.unique(shapes, axis=0, return_inverse=True)
    for index, (first, step, least, largest, rays) in enumerate(kinds):
        rows = np.flatnonzero(kind.reshape(-1) == index)
        bins = _bin_of_rays(side * (first + step * np.arange(int(rays))) + yaw, lidar)
        chosen = np.flatnonzero(bins >= 0)
        chosen = chosen[np.argsort(bins[chosen], kind="stable")]
        _check_bins(bins[chosen], lidar, first, step, int(rays))
        starts = np.searchsorted(bins[chosen], np.arange(lidar.bins))
        ranges = np.stack([scans.ranges[row][chosen] for row in rows.tolist()], dtype=np.float64)
        binned[rows] = np.fmin.reduceat(_clean(ranges, least, largest, lidar, seen), starts, axis=1)
        seen.rays.add(int(rays))
        seen.least, seen.largest = max(seen.least, float(least)), min(seen.largest, float(largest))
    return binned


def _bin_of_rays(angles: Floats, lidar: LidarSpecification) -> Indices:
    """Return the bin of each ray (R,), -1 outside of the field of view."""
    half = 0.5 * lidar.field_of_view
    spacing = lidar.field_of_view / max(lidar.rays - 1, 1)
    middle = angles - np.round(angles / (2.0 * np.pi)) * (2.0 * np.pi)
    ray = (
        np.rint((middle + half) / spacing).astype(np.int64) if lidar.rays > 1 else np.zeros(len(angles), int)
    )
    if lidar.rays == 1:
        ray[np.abs(middle) > half] = -1
    inside = (ray >= 0) & (ray < lidar.rays)
    return np.where(inside, ray // (lidar.rays // lidar.bins), -1)


def _check_bins(bins: Indices, lidar: LidarSpecification, first: float, step: float, rays: int) -> None:
    """Refuse a sensor that leaves a bin without a ray."""
    empty = np.setdiff1d(np.arange(lidar.bins), bins)
    if empty.size:
        raise TrajectoryError(
            f"the scans have {rays} rays from {np.degrees(first):.1f} to "
            f"{np.degrees(first + step * max(rays - 1, 0)):.1f} degrees, which leaves bin {empty[0]} of the "
            f"policy's {lidar.bins} over {np.degrees(lidar.field_of_view):.1f} degrees without a ray",
            "record a LiDAR that covers the policy's field of view, or correct the specification's lidar",
        )


def _clean(ranges: Floats, least: float, largest: float, lidar: LidarSpecification, seen: Readings) -> Floats:
    """Return distances (S, R): NaN for no measurement, the largest range where nothing came back (REP 117)."""
    near = np.isneginf(ranges)
    with np.errstate(invalid="ignore"):
        absent = np.isnan(ranges) | (~near & ((ranges < least - 1e-6) | (ranges <= 0.0)))
        beyond = ~absent & (ranges > largest + 1e-6)
    seen.total += ranges.size
    seen.absent += int(absent.sum())
    seen.beyond += int(beyond.sum())
    seen.too_near += int(near.sum())
    distances = np.where(beyond, lidar.maximum_range, np.where(absent, np.nan, ranges))
    return np.clip(distances, lidar.minimum_range, lidar.maximum_range)
