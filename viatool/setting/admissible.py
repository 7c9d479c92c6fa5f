"""Observations that sensors may make within an error model: sets to search, random ones, and the check of a single one.

What is found here proves nothing by itself: an observation counts as a counterexample if `explain` gives the errors
that make it of what was recorded. That check shares no code with the bounds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from viatool.arrays import Floats, Hull, Indices
from viatool.channels.missing import Missing
from viatool.channels.reading_errors import ReadingErrors
from viatool.rounding import AS_RECEIVED


@dataclass(frozen=True, eq=False)
class AdmissibleSets:
    """B sets of observations as an error model allows them, to be searched; as `Box` is for errors that are a box.

    Parameters
    ----------
    errors : ReadingErrors
        Of n inputs.
    inputs : ndarray
        (B, n) what was recorded.
    drifted : ndarray, optional
        (B, n) by how much readings differ because the robot believes another pose.
    """

    errors: ReadingErrors
    inputs: Floats
    drifted: Floats | None = None

    def rows(self, which: Indices) -> AdmissibleSets:
        """Return some of the sets."""
        drifted = None if self.drifted is None else self.drifted[which]
        return replace(self, inputs=self.inputs[which], drifted=drifted)

    @cached_property
    def recorded_inputs(self) -> Floats:
        """What the network takes without an error but that of the pose, (B, n)."""
        return self.inputs if self.drifted is None else self._received(self._recorded[0])

    @cached_property
    def _hull(self) -> Hull:
        return self.errors.sets(self.recorded_inputs).hull

    @property
    def lower(self) -> Floats:
        """Return lower ends of the boxes around the sets, (B, n)."""
        return self._hull[0]

    @property
    def upper(self) -> Floats:
        """Return upper ends of the boxes around the sets, (B, n)."""
        return self._hull[1]

    @cached_property
    def _placed(self) -> tuple[Floats, Hull]:
        """What was recorded, with what changed it, and its limits; where a clip hides a reading, the one at its end."""
        least, most = self.errors.inputs.readings(self.inputs, within=True)
        seen = np.where(np.isfinite(least), least, most)
        limits = self.errors.kept(seen, seen)
        if self.drifted is not None:
            seen = seen + self.drifted
            turns = np.where(self.errors.angles & (np.abs(seen) > np.pi), np.round(seen / (2.0 * np.pi)), 0.0)
            seen = seen - 2.0 * np.pi * turns
        return seen, limits

    @property
    def _recorded(self) -> Hull:
        """What was recorded, with what changed it, (B, n) twice."""
        return self._placed[0], self._placed[0]

    @cached_property
    def _own(self) -> Hull:
        """Ends of the readings with what each errs by itself, with room for the rounding of what is received."""
        least, most = self.errors.own(*self._recorded)
        middle = 0.5 * (least + most)
        half = np.maximum(0.5 * (most - least) - AS_RECEIVED * (1.0 + np.abs(middle)), 0.0)
        return middle - half, middle + half

    def corner(self, slope: Floats, point: Floats) -> Floats:
        """Return the observations (B, n) at which a linear function of a slope (B, n) about is the largest.

        Where it is flat, what was recorded stays. `point` (B, n) tells where encodings are taken as linear.
        """
        steep = slope * self._steepness(point)
        low, high = self._own
        readings = np.where(steep > 0.0, high, np.where(steep < 0.0, low, self._recorded[0]))
        common = np.zeros_like(readings)
        for scan in np.unique(self.errors.scan[self.errors.bias > 0.0]):
            columns = np.flatnonzero(self.errors.scan == scan)
            common[:, columns] = np.sign(steep[:, columns].sum(axis=1, keepdims=True)) * self._bias(columns)
        inputs = self._received(readings + common)
        for missing in self.errors.missing:
            inputs = self._without(missing, inputs, slope)
        return inputs

    def random_corner(self, generator: np.random.Generator) -> Floats:
        """Return an observation of each set at the ends of all its errors, (B, n)."""
        slope = generator.choice([-1.0, 1.0], size=self.inputs.shape) * generator.random(self.inputs.shape)
        return self.corner(slope, self.inputs)

    def nearest(self, points: Floats) -> Floats:
        """Return observations of the sets near points (B, n), without a ray that returns nothing."""
        least, most = self.errors.inputs.readings(points, within=True)
        readings = np.where(np.isfinite(least), least, most)
        (low, high), common = self._own, np.zeros_like(readings)
        for scan in np.unique(self.errors.scan[self.errors.bias > 0.0]):
            columns = np.flatnonzero(self.errors.scan == scan)
            off = np.median(
                readings[:, columns] - np.clip(readings[:, columns], low[:, columns], high[:, columns]),
                axis=1,
                keepdims=True,
            )
            common[:, columns] = np.clip(off, -self._bias(columns), self._bias(columns))
        return self._received(np.clip(readings, low + common, high + common))

    def _bias(self, columns: Indices) -> float:
        return float(self.errors.bias[columns[0]]) * (1.0 - AS_RECEIVED)

    def _steepness(self, inputs: Floats) -> Floats:
        """Return by how much an input changes with its reading, about, (B, n)."""
        steep = np.ones_like(inputs)
        for number, channel in enumerate(self.errors.inputs.channels):
            columns = np.flatnonzero(self.errors.inputs.channel == number)
            steep[:, columns] = channel.scale
            if channel.reciprocal:
                steep[:, columns] = (
                    -np.square(inputs[:, columns] - channel.offset) / channel.scale - channel.scale * 1e-12
                )
        return steep

    def _received(self, readings: Floats) -> Floats:
        """Return what the network takes of readings (B, n), kept within the limits of their sensors."""
        kept = np.clip(readings, *self._placed[1])
        found = kept.copy()
        for number, channel in enumerate(self.errors.inputs.channels):
            columns = np.flatnonzero(self.errors.inputs.channel == number)
            found[:, columns] = channel.encoding.apply(kept[:, columns])
        return found

    def _without(self, missing: Missing, inputs: Floats, slope: Floats) -> Floats:
        """Let those rays return nothing that gain most along a slope (B, n)."""
        columns, rows = missing.columns, np.arange(len(inputs))[:, None]
        usual = self._recorded[0][:, columns]
        ends = missing.bounds(usual, usual)
        channel = self.errors.inputs.channels[int(self.errors.inputs.channel[columns[0]])]
        seen = np.stack([channel.encoding.apply(end) for end in ends])
        gains = slope[:, columns] * (seen - inputs[:, columns])
        best = gains.argmax(axis=0)
        gain, value = (np.take_along_axis(part, best[None], axis=0)[0] for part in (gains, seen))
        chosen = np.argsort(-gain, axis=1, kind="stable")[:, : missing.count]
        inputs = inputs.copy()
        at = columns[chosen]
        inputs[rows, at] = np.where(gain[rows, chosen] > 0.0, value[rows, chosen], inputs[rows, at])
        return inputs


def explain(
    errors: ReadingErrors, recorded: Floats, observed: Floats, drifted: Floats | None = None
) -> dict[str, Any] | None:
    """Find errors within their bounds that make an observation of what was recorded.

    Parameters
    ----------
    errors : ReadingErrors
        Of n inputs.
    recorded, observed : ndarray
        (n,) each.
    drifted : ndarray, optional
        (n,) by how much readings differ because the robot believes another pose.

    Returns
    -------
    dict or None
        By channel: its ``bias``, and the entries whose rays are ``missing``; None if there are no such errors.

    Notes
    -----
    Sound: yes, under rounding to float64 only. It goes entry by entry through what the error model says: between which
    biases the entry is explained, and whether it is by a ray that returns nothing; then it looks for a bias that leaves
    no more entries unexplained than rays may be missing.
    """
    found: dict[str, Any] = {}
    off = np.zeros(len(recorded)) if drifted is None else drifted
    for scan in np.unique(errors.scan).tolist():
        columns = np.flatnonzero(errors.scan == scan)
        channel = errors.inputs.channels[int(errors.inputs.channel[columns[0]])]
        ends = [
            _biases(errors, int(column), float(recorded[column]), float(observed[column]), float(off[column]))
            for column in columns
        ]
        allowed = float(errors.bias[columns[0]])
        missing = next((one for one in errors.missing if int(one.columns[0]) in columns.tolist()), None)
        lost = [
            missing is not None
            and _is_lost(errors, missing, int(column), float(recorded[column]), float(observed[column]))
            for column in columns
        ]
        count = 0 if missing is None else missing.count
        tried = [0.0, allowed, -allowed, *(end for pair in ends for end in pair if abs(end) <= allowed)]
        for bias in tried:
            left = [row for row, (low, high) in enumerate(ends) if not low <= bias <= high]
            if len(left) <= count and all(lost[row] for row in left):
                told: dict[str, Any] = {}
                if bias:
                    told["bias"] = bias
                if left:
                    told["missing"] = left
                if told:
                    at = int(errors.inputs.age[columns[0]])
                    found[channel.name if at == 0 else f"{channel.name}, {at} steps ago"] = told
                break
        else:
            return None
    return found


def _decoded(errors: ReadingErrors, column: int, value: float) -> tuple[float, float]:
    """Return the readings, between two ends, that the robot's software makes into an input."""
    channel = errors.inputs.channels[int(errors.inputs.channel[column])]
    ends = [(value - channel.offset) / channel.scale] * 2
    if channel.clip is not None:
        low, high = (float(np.float32(end)) for end in channel.clip)
        beyond = [value <= low, value >= high]
        if channel.scale < 0.0:
            beyond.reverse()
        ends = [-np.inf if beyond[0] else ends[0], np.inf if beyond[1] else ends[1]]
    if channel.reciprocal:
        if ends[0] <= 0.0 <= ends[1] or not (np.isfinite(ends[0]) or np.isfinite(ends[1])):
            return -np.inf, np.inf
        return 1.0 / ends[1], 1.0 / ends[0]
    return ends[0], ends[1]


def _biases(
    errors: ReadingErrors, column: int, recorded: float, observed: float, drifted: float
) -> tuple[float, float]:
    """Return between which biases an entry is what was recorded with an error of its own."""
    first, last = _decoded(errors, column, recorded)
    low, high = _decoded(errors, column, observed)
    own = float(errors.absolute[column])
    floor = min(float(errors.limits[0][column]), first - own)
    ceiling = max(float(errors.limits[1][column]), last + own)
    first, last = first + drifted, last + drifted
    if errors.angles[column] and math.isfinite(first) and math.isfinite(low):
        turns = 2.0 * math.pi * round((low - first) / (2.0 * math.pi))
        first, last = first + turns, last + turns
    share = float(errors.relative[column])
    least = first - (share * abs(first) if share else 0.0) - own
    most = last + (share * abs(last) if share else 0.0) + own
    near = [AS_RECEIVED * (1.0 + abs(end)) if math.isfinite(end) else 0.0 for end in (floor, ceiling)]
    if high < floor - near[0] or low > ceiling + near[1]:
        return np.inf, -np.inf
    below = -np.inf if low <= floor + near[0] else low - most
    above = np.inf if high >= ceiling - near[1] else high - least
    return below, above


def _is_lost(errors: ReadingErrors, missing: Missing, column: int, recorded: float, observed: float) -> bool:
    """Tell whether an entry may be what is read of rays of which one returns nothing."""
    first, last = _decoded(errors, column, recorded)
    low, high = _decoded(errors, column, observed)
    lidar = missing.lidar
    nothing = lidar.maximum_range if lidar.no_return is None else lidar.no_return
    near = AS_RECEIVED * (1.0 + abs(nothing))
    if missing.is_one:
        return low - near <= nothing <= high + near
    if lidar.reduce == "minimum":
        least, most = min(first, nothing), max(last, lidar.maximum_range, nothing)
    else:
        each = min(missing.count, lidar.each) / lidar.each
        least = first + each * min(nothing - lidar.maximum_range, 0.0)
        most = last + each * max(nothing - lidar.minimum_range, 0.0)
    return high >= least - near and low <= most + near
