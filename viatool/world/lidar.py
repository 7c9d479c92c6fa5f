"""Planar range finders: in which directions they look, and what they make of the ranges."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from viatool.arrays import Floats, Indices
from viatool.errors import ConfigurationError

_TWICE = 1e-6
"""Radians within which two rays count as one."""


@dataclass(frozen=True)
class Lidar:
    """A planar range finder at the origin of the robot's frame.

    Parameters
    ----------
    field_of_view : float or None
        Angle between the first and the last ray, in radians, symmetric about the forward axis; None where the rays are
        given by `start` and `step` or by `listed`.
    rays : int
        Number of rays; of a field of view evenly spread, both ends included.
    bins : int
        Number of groups of consecutive rays that an observation holds.
    minimum_range, maximum_range : float
        In metres; readings are clipped to them, and a ray that hits nothing reads the maximum.
    noise : float
        Standard deviation of the Gaussian error of every ray that hits something, in metres.
    start, step : float, optional
        Direction of the first ray and the angle to the next, counter-clockwise from forward, in radians.
    listed : tuple of float, optional
        Direction of every ray, in the order in which they are observed.
    order : str
        Which way rays follow each other; "clockwise" reverses a field of view, and the sign of `step`.
    reduce : str
        What is left of a group of rays: their "minimum", their "mean", or the "first" of them.
    no_return : float, optional
        What a ray that hits nothing reads instead of the maximum range.
    """

    field_of_view: float | None = math.pi
    rays: int = 180
    bins: int = 20
    minimum_range: float = 0.2
    maximum_range: float = 7.0
    noise: float = 0.01
    start: float | None = None
    step: float | None = None
    listed: tuple[float, ...] | None = None
    order: Literal["counter_clockwise", "clockwise"] = "counter_clockwise"
    reduce: Literal["minimum", "mean", "first"] = "minimum"
    no_return: float | None = None

    def __post_init__(self) -> None:
        if self.field_of_view is not None and not 0.0 < self.field_of_view <= 2.0 * math.pi + 1e-9:
            raise ConfigurationError(
                f"LiDAR field_of_view is {self.field_of_view} rad, expected more than 0 and at most 2 pi",
                "give the field of view in radians",
            )
        if self.rays < 1 or self.bins < 1 or self.rays % self.bins:
            raise ConfigurationError(
                f"LiDAR has {self.rays} rays in {self.bins} bins, expected equally many rays in each",
                "choose a number of bins that divides the number of rays",
            )
        if not 0.0 <= self.minimum_range < self.maximum_range < math.inf:
            raise ConfigurationError(
                f"LiDAR range is {self.minimum_range} to {self.maximum_range} m, "
                "expected 0 <= minimum < maximum",
                "correct the range limits",
            )
        if not 0.0 <= self.noise < math.inf:
            raise ConfigurationError(
                f"LiDAR noise is {self.noise} m, expected 0 or more", "correct the noise"
            )

    def require_apart(self) -> Lidar:
        """Return the sensor itself; ConfigurationError if rays look the same way, or beyond a full turn."""
        angles = self.angles()
        if not np.ptp(angles) <= 2.0 * np.pi + _TWICE:
            apart = "" if self.step is None else f", {self.step:g} rad apart"
            raise ConfigurationError(
                f"{self.rays} rays from {angles[0]:g} rad on{apart}, span {np.ptp(angles):g} rad, "
                "more than a full turn of 6.28319 rad",
                "give angles in radians, not in degrees, and as many as are cast",
            )
        ends = angles if self.listed is not None else angles[:1]
        if not (np.abs(ends) <= 2.0 * np.pi + _TWICE).all():
            worst = float(ends[np.abs(ends).argmax()])
            raise ConfigurationError(
                f"a ray points at {worst:g} rad, outside of any scan, which is within 6.28319",
                "give angles in radians, not in degrees",
            )
        bearing, ray = self.around
        gaps = np.diff(bearing, append=bearing[:1] + 2.0 * np.pi)
        close = np.flatnonzero(gaps < _TWICE)
        if self.rays > 1 and close.size:
            first, second = sorted((int(ray[close[0]]), int(ray[(close[0] + 1) % self.rays])))
            raise ConfigurationError(
                f"rays {first} and {second} overlap: both point at {float(angles[first]):g} rad",
                "leave out the ray that is there twice; a full turn of N rays has a step of 2 pi / N: docs/lidar.md",
            )
        return self

    def angles(self) -> Floats:
        """Return the directions of the rays in the robot's frame, (rays,) radians, as they are observed."""
        if self.listed is not None:
            return np.array(self.listed)
        side = -1.0 if self.order == "clockwise" else 1.0
        if self.start is not None and self.step is not None:
            return np.asarray(self.start + side * self.step * np.arange(self.rays))
        assert self.field_of_view is not None
        half = 0.5 * self.field_of_view
        return side * np.linspace(-half, half, self.rays) if self.rays > 1 else np.zeros(1)

    @cached_property
    def around(self) -> tuple[Floats, Indices]:
        """The directions within [-pi, pi), from right to left, and which ray each is of, (rays,) each."""
        bearing = self.angles()
        bearing = bearing - 2.0 * np.pi * np.floor((bearing + np.pi) / (2.0 * np.pi))
        order = np.argsort(bearing, kind="stable")
        return bearing[order], order

    def directions(self) -> Floats:
        """Return the unit vectors of the rays in the robot's frame, (2, rays), as they are observed."""
        angles = self.angles()
        return np.stack([np.cos(angles), np.sin(angles)])

    def wedges(self) -> tuple[Floats, Floats]:
        """Return the right and the left edge of what each bin looks at, (bins,) radians each, to be drawn."""
        angles = np.unwrap(self.angles().reshape(self.bins, -1), axis=1)
        gaps = np.diff(self.around[0])
        half = 0.5 * float(np.median(gaps)) if self.rays > 1 else 0.01
        return angles.min(axis=1) - half, angles.max(axis=1) + half

    @property
    def each(self) -> int:
        """Return how many rays a bin has."""
        return self.rays // self.bins

    @property
    def unreduced(self) -> Lidar:
        """Return the sensor whose bins are the rays that count: of each bin the first alone, where only that counts."""
        counts = self.angles()[:: self.each] if self.reduce == "first" else self.angles()
        some = tuple(counts.tolist())
        return replace(
            self, field_of_view=None, start=None, step=None, listed=some, rays=len(some), bins=len(some),
            reduce="minimum", no_return=None,
        )  # fmt: skip

    @property
    def words(self) -> str:
        """Return where the rays point, in words, for reports."""
        angles = np.degrees(self.angles())
        if self.rays == 1:
            return f"one ray at {angles[0]:.4g} degrees"
        return f"{self.rays} rays from {angles[0]:.4g} to {angles[-1]:.4g} degrees"


def bin_ranges(ranges: NDArray[np.floating], lidar: Lidar) -> NDArray[np.floating]:
    """Return the minimum of each group of consecutive rays.

    Parameters
    ----------
    ranges : ndarray
        (B, rays) metres.
    lidar : Lidar
        Says how many bins there are.

    Returns
    -------
    ndarray
        (B, bins) metres, of the same kind of float.
    """
    binned: NDArray[np.floating] = ranges.reshape(len(ranges), lidar.bins, lidar.each).min(axis=2)
    return binned
