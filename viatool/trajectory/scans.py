"""Laser scans to the bins that a policy observes."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from viatool.arrays import Floats, Indices, Singles
from viatool.errors import TrajectoryError
from viatool.world import Lidar

if TYPE_CHECKING:
    from viatool.policy import LidarSpecification

_ALIKE = 1e-6
"""Radians by which rays that look the same way may be written differently."""


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


def bin_scans(scans: Scans, described: LidarSpecification, yaw: float, side: int, seen: Readings) -> Floats:
    """Return what the policy observes of scans, as the simulated sensor does.

    Parameters
    ----------
    scans : Scans
        S scans.
    described : LidarSpecification
        What the policy observes. The least distance of a bin is that of all recorded rays that look where one of its
        rays looks; of a mean, or of a first ray, the recorded ray that is nearest to each specified one counts.
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
    lidar = described.lidar()
    binned = np.empty((len(scans), lidar.bins))
    shapes = np.column_stack([scans.geometry, [len(ranges) for ranges in scans.ranges]])
    kinds, kind = np.unique(shapes, axis=0, return_inverse=True)
    for index, (first, step, least, largest, rays) in enumerate(kinds):
        rows = np.flatnonzero(kind.reshape(-1) == index)
        chosen, bins = _rays_of_bins(side * (first + step * np.arange(int(rays))) + yaw, lidar)
        _check_bins(bins, lidar, first, step, int(rays))
        starts = np.searchsorted(bins, np.arange(lidar.bins))
        ranges = np.stack([scans.ranges[row][chosen] for row in rows.tolist()], dtype=np.float64)
        binned[rows] = _reduced(_clean(ranges, least, largest, lidar, seen), starts, lidar)
        seen.rays.add(int(rays))
        seen.least, seen.largest = max(seen.least, float(least)), min(seen.largest, float(largest))
    return binned


def _rays_of_bins(angles: Floats, lidar: Lidar) -> tuple[Indices, Indices]:
    """Return recorded rays, of all that have directions (R,), and the bin that each belongs to; ordered by bin."""
    bearing, order = lidar.around
    around = angles - 2.0 * np.pi * np.floor((angles + np.pi) / (2.0 * np.pi))
    ring = np.concatenate([bearing[-1:] - 2.0 * np.pi, bearing, bearing[:1] + 2.0 * np.pi])
    at = np.clip(np.searchsorted(ring, around), 1, len(ring) - 1)
    at -= around - ring[at - 1] < ring[at] - around  # the nearest specified ray
    apart = np.abs(around - ring[at])
    ray = order[(at - 1) % lidar.rays]
    gaps = np.diff(ring)
    spacing = float(np.median(gaps[gaps > _ALIKE])) if lidar.rays > 1 else lidar.field_of_view or 0.0
    recorded = np.flatnonzero(apart <= 0.5 * spacing + _ALIKE)
    if lidar.reduce != "minimum":
        recorded = recorded[np.lexsort((apart[recorded], ray[recorded]))]
        recorded = recorded[np.unique(ray[recorded], return_index=True)[1]]
        if lidar.reduce == "first":
            recorded = recorded[ray[recorded] % lidar.each == 0]
    recorded = recorded[np.argsort(ray[recorded] // lidar.each, kind="stable")]
    return recorded, ray[recorded] // lidar.each


def _reduced(distances: Floats, starts: Indices, lidar: Lidar) -> Floats:
    """Return the bins (S, bins) of distances (S, R) in the order of the bins; NaN where nothing was measured."""
    if lidar.reduce != "mean":
        return np.asarray(np.fmin.reduceat(distances, starts, axis=1))
    known = ~np.isnan(distances)
    total, count = (
        np.add.reduceat(part, starts, axis=1)
        for part in (np.where(known, distances, 0.0), known.astype(float))
    )
    return np.where(count > 0, total / np.maximum(count, 1.0), np.nan)


def _check_bins(bins: Indices, lidar: Lidar, first: float, step: float, rays: int) -> None:
    """Refuse a sensor that leaves a bin without a ray."""
    empty = np.setdiff1d(np.arange(lidar.bins), bins)
    if empty.size:
        raise TrajectoryError(
            f"the scans have {rays} rays from {np.degrees(first):.1f} to "
            f"{np.degrees(first + step * max(rays - 1, 0)):.1f} degrees, which leaves bin {empty[0]} of the "
            f"policy's {lidar.bins} ({lidar.words}) without a ray",
            "record a LiDAR that covers the policy's field of view, or correct the specification's lidar",
        )


def _clean(ranges: Floats, least: float, largest: float, lidar: Lidar, seen: Readings) -> Floats:
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
    distances = np.clip(distances, lidar.minimum_range, lidar.maximum_range)
    if lidar.no_return is None:
        return distances
    return np.where(distances >= lidar.maximum_range, lidar.no_return, distances)
