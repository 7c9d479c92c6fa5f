"""Observations that sensors may make within an error model: sets to search, and random ones.

What is found here proves nothing by itself: an observation counts as a counterexample if `viatool.setting.explanation`
finds the errors that make it of what was recorded, or of what perfect sensors read.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from viatool.arrays import Floats, Hull, Indices
from viatool.channels.missing import Missing
from viatool.channels.reading_errors import ReadingErrors
from viatool.rounding import AS_RECEIVED
from viatool.sets.chance import RowChance


@dataclass(frozen=True, eq=False)
class KnownReadings:
    """What perfect sensors read in each of B states, where it is known.

    Parameters
    ----------
    readings : ndarray
        (B, n) the reading that stands in each input.
    losing : tuple of ndarray
        For each scan whose rays may return nothing (J, B, E): what its bins read when the j nearest of their rays do,
        j from 1 to J; NaN where a bin has fewer rays.
    """

    readings: Floats
    losing: tuple[Floats, ...] = ()

    def select(self, which: Indices) -> KnownReadings:
        """Return those of some states."""
        return KnownReadings(self.readings[which], tuple(part[:, which] for part in self.losing))


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
    known : KnownReadings, optional
        What perfect sensors read, of which `inputs` is what the network takes, where nothing was recorded.
    """

    errors: ReadingErrors
    inputs: Floats
    drifted: Floats | None = None
    known: KnownReadings | None = None

    @classmethod
    def of(cls, errors: ReadingErrors, known: KnownReadings) -> AdmissibleSets:
        """Return what may be observed where perfect sensors read what is known."""
        found = cls(errors, known.readings, known=known)
        return replace(found, inputs=found._received(known.readings))

    def rows(self, which: Indices) -> AdmissibleSets:
        """Return some of the sets."""
        drifted = None if self.drifted is None else self.drifted[which]
        known = None if self.known is None else self.known.select(which)
        errors = self.errors.rows(which)
        return replace(self, errors=errors, inputs=self.inputs[which], drifted=drifted, known=known)

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
        if self.known is not None:
            seen, (lowest, highest) = self.known.readings, self.errors.limits
            return seen, (np.minimum(lowest, seen), np.maximum(highest, seen))
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
        return _narrowed(*self.errors.own(*self._recorded))

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
        for number, missing in enumerate(self.errors.missing):
            if self.known is None:
                inputs = self._without(missing, inputs, slope)
            else:
                inputs = self._losing(missing, self.known.losing[number], inputs, slope, steep, common)
        return inputs

    def random_corner(self, chance: RowChance) -> Floats:
        """Return an observation of each set at the ends of all its errors, (B, n)."""
        return self.corner(2.0 * chance.random(self.inputs.shape[1]) - 1.0, self.inputs)

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

    def _losing(
        self, missing: Missing, losing: Floats, inputs: Floats, slope: Floats, steep: Floats, common: Floats
    ) -> Floats:
        """Let those rays return nothing that gain most: one of each of some bins, or several of one."""
        columns, rows = missing.columns, np.arange(len(inputs))
        relative, absolute = self.errors.relative[columns], self.errors.absolute[..., columns]
        low, high = _narrowed(*((1.0 + sign * relative) * losing + sign * absolute for sign in (-1.0, 1.0)))
        read = np.where(steep[:, columns] > 0.0, high, low) + common[:, columns]
        silent = (losing >= missing.lidar.maximum_range) | (losing == missing.reading)
        read = np.where(silent, losing, np.clip(read, *(end[:, columns] for end in self._placed[1])))
        seen = self.errors.inputs.channels[int(self.errors.inputs.channel[columns[0]])].encoding.apply(read)
        gains = np.nan_to_num(slope[:, columns] * (seen - inputs[:, columns]), nan=-np.inf)  # (J, B, E)
        found = inputs.copy()
        chosen = np.argsort(-gains[0], axis=1, kind="stable")[:, : missing.count]
        gained = np.take_along_axis(gains[0], chosen, axis=1)
        each = np.where(
            gained > 0.0, np.take_along_axis(seen[0], chosen, axis=1), inputs[rows[:, None], columns[chosen]]
        )
        found[rows[:, None], columns[chosen]] = each
        best = gains.transpose(1, 0, 2).reshape(len(inputs), -1).argmax(axis=1)
        level, bin_ = np.divmod(best, len(columns))
        alone = np.flatnonzero(gains[level, rows, bin_] > np.maximum(gained, 0.0).sum(axis=1))
        found[alone] = inputs[alone]
        found[alone, columns[bin_[alone]]] = seen[level[alone], alone, bin_[alone]]
        return found


def _narrowed(least: Floats, most: Floats) -> Hull:
    """Return ends with room for the rounding of what is received."""
    middle = 0.5 * (least + most)
    half = np.maximum(0.5 * (most - least) - AS_RECEIVED * (1.0 + np.abs(middle)), 0.0)
    return middle - half, middle + half
