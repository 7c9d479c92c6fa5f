"""Sensor and pose errors within an error model: drawn evenly, or at its corners."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from viatool.arrays import Floats, Reals
from viatool.channels import Fan, Quantities
from viatool.uncertainty import ErrorModel
from viatool.uncertainty.error_model import PoseTerms, SensorTerms


@dataclass(frozen=True, eq=False)
class SensorFlaws:
    """How the readings of E robots err.

    Parameters
    ----------
    model : ErrorModel
        Its sections `sensor`, `pose` and `start`.
    quantities : Quantities
        What is observed.
    corners : bool
        Whether errors are as large as they may be, instead of evenly spread.

    Notes
    -----
    Everything drawn lies within the model. Rays that meet nothing have no error, as in the rest of the simulators. At
    corners all rays of a bin err alike, since they would else hide behind each other.
    """

    model: ErrorModel
    quantities: Quantities
    corners: bool

    def draw(self, rng: np.random.Generator, *shape: int) -> Floats:
        """Return numbers within -1 and 1, or of both alone."""
        if self.corners:
            return np.asarray(rng.integers(0, 2, shape) * 2.0 - 1.0, dtype=np.float64)
        return np.asarray(rng.uniform(-1.0, 1.0, shape), dtype=np.float64)

    def turn(self, fan: Fan, robots: int, rng: np.random.Generator) -> Floats | None:
        """Return by how much scans are turned, (E,) rad; None if by nothing."""
        terms = self._of(fan)
        if terms is None or not terms.angle:
            return None
        return np.asarray(terms.angle * self.draw(rng, robots), dtype=np.float64)

    def thin(self, fan: Fan) -> float:
        """Return the widest obstacle that rays may pass, in metres; 0 for none."""
        terms = self._of(fan)
        return 0.0 if terms is None else terms.thin or 0.0

    def passing(self, ranges: Reals, past: Reals, fan: Fan, rng: np.random.Generator) -> Reals:
        """Return which of two ranges (E, R) rays have: to what is nearest, or past all that is thin."""
        robots, count = ranges.shape
        alike = self._alike(fan, count)
        passes = np.tile(rng.random((robots, alike)) < 0.5, count // alike)
        return np.asarray(np.where(passes, past, ranges), dtype=ranges.dtype)

    def rays(self, ranges: Reals, fan: Fan, rng: np.random.Generator) -> Reals:
        """Return what rays read whose true ranges are (E, R), in the order of the fan."""
        terms, most = self._of(fan), fan.lidar.maximum_range
        if terms is None:
            return ranges
        robots, count = ranges.shape
        alike = self._alike(fan, count)
        own, share = (np.tile(self.draw(rng, robots, alike), count // alike) for _ in range(2))
        error = (terms.absolute or 0.0) * own + (terms.relative or 0.0) * share * ranges
        error = error + (terms.bias or 0.0) * self.draw(rng, robots, 1)
        read = np.where(ranges < most, np.clip(ranges + error, 0.0, most), ranges)
        if terms.missing:
            lost = np.argsort(rng.random(ranges.shape), axis=1)[:, : terms.missing]
            kept = self.corners or rng.random((robots, terms.missing)) < 0.5
            np.put_along_axis(
                read, lost, np.where(kept, most, np.take_along_axis(read, lost, axis=1)), axis=1
            )
        return np.asarray(read, dtype=ranges.dtype)

    def readings(self, readings: Floats, rng: np.random.Generator) -> Floats:
        """Return readings (E, m) with the errors of all channels that are no LiDAR."""
        found = readings.copy()
        scans = [columns for _, columns in self.quantities.lidars]
        for one, place in zip(self.quantities.each, self.quantities.columns, strict=True):
            terms = self.model.sensor.get(one.channel.name)
            if terms is None or place in scans or one.channel.value is not None:
                continue
            true = readings[:, place]
            found[:, place] += (terms.absolute or 0.0) * self.draw(rng, *true.shape)
            found[:, place] += (terms.relative or 0.0) * np.abs(true) * self.draw(rng, *true.shape)
            found[:, place] += (terms.bias or 0.0) * self.draw(rng, len(true), 1)
        return found

    def believed(self, poses: Floats, rng: np.random.Generator) -> Floats:
        """Return where localisation says that robots at (E, 3) are."""
        return poses + _radii(self.model.pose) * self.draw(rng, *poses.shape)

    def started(self, poses: Floats, rng: np.random.Generator) -> Floats:
        """Return where robots start that should start at (E, 3)."""
        return poses + _radii(self.model.start) * self.draw(rng, *poses.shape)

    def _alike(self, fan: Fan, count: int) -> int:
        """Return how many of the rays that are cast err by themselves: at corners one for each bin."""
        return fan.lidar.bins if self.corners and count % fan.lidar.bins == 0 else count

    def _of(self, fan: Fan) -> SensorTerms | None:
        """Return the terms of the LiDAR that has a fan."""
        names = [lidar.channel.name for lidar, _ in self.quantities.lidars if lidar.fan is fan]
        return self.model.sensor.get(names[0]) if names else None


def _radii(terms: PoseTerms) -> Floats:
    return np.array([terms.x or 0.0, terms.y or 0.0, terms.theta or 0.0])
