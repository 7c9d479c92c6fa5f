"""What a robot's software makes of a reading before the network takes it: ``clip(scale * value + offset)``.

With ``reciprocal`` the value is replaced by 1 / value first. Errors are bounded in the unit of the sensor, and the
network takes what is encoded: every proof carries a set of readings through here.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from viatool.arrays import Floats, Reals
from viatool.errors import EnclosureError
from viatool.rounding import FEW_ROUNDINGS
from viatool.sets.forms import Forms


@dataclass(frozen=True)
class Encoding:
    """The map from readings in the sensor's unit to inputs of the network, number by number.

    Parameters
    ----------
    scale, offset : float
        The scale is not 0.
    clip : tuple of float, optional
        Least and largest input.
    reciprocal : bool
        Whether 1 / value is scaled.
    """

    scale: float = 1.0
    offset: float = 0.0
    clip: tuple[float, float] | None = None
    reciprocal: bool = False

    def __bool__(self) -> bool:
        """Tell whether it changes anything."""
        return self != PLAIN

    @property
    def words(self) -> str:
        """Return the map in words, such as ``0.2 * value - 0.5 in [0, 1]``; nothing where it changes nothing."""
        if not self:
            return ""
        value = "1 / value" if self.reciprocal else "value"
        scaled = value if self.scale == 1.0 else f"{self.scale:.4g} * {value}"
        shifted = (
            f"{scaled} {'-' if self.offset < 0 else '+'} {abs(self.offset):.4g}" if self.offset else scaled
        )
        return shifted if self.clip is None else f"{shifted} in [{self.clip[0]:g}, {self.clip[1]:g}]"

    def apply(self, values: Reals) -> Reals:
        """Encode readings of any shape; a reciprocal of 0 is infinite before it is clipped."""
        if not self:
            return values
        with np.errstate(divide="ignore"):
            found = self.scale * (1.0 / values if self.reciprocal else values) + self.offset
        return np.asarray(found if self.clip is None else np.clip(found, *self.clip))

    def readings(self, inputs: Floats, *, within: bool = False) -> tuple[Floats, Floats]:
        """Return the least and the largest reading that may be encoded as each input, of any shape.

        At the end of a clip every reading beyond counts; the reading itself is infinite there. With `within`, a number
        that is so near to the end that rounding may have made it of what was clipped is taken for itself.
        """
        if not self:
            return inputs, inputs
        ends = [inputs, inputs]
        if not within:  # an input is a rounded one, and was large where what it may become is small
            rounded = FEW_ROUNDINGS * (np.abs(inputs) + abs(self.offset))
            ends = [inputs - rounded, inputs + rounded]
        if self.clip is not None:
            low, high = (
                np.float64(np.float32(end))
                if within
                else end + side * FEW_ROUNDINGS * (abs(end) + abs(self.offset))
                for end, side in zip(self.clip, (1.0, -1.0), strict=True)
            )
            ends = [np.where(inputs <= low, -np.inf, ends[0]), np.where(inputs >= high, np.inf, ends[1])]
        first, last = ((end - self.offset) / self.scale for end in ends)
        first, last = np.minimum(first, last), np.maximum(first, last)
        if not self.reciprocal:
            return first, last
        return _reciprocals(first, last, within=within)

    def enclose(self, lower: Floats, upper: Floats, *, within: bool = False) -> tuple[Floats, Floats]:
        """Bound what is encoded of readings between two ends, of any shape; infinite ends are allowed.

        With `within`, everything between the bounds is some encoded reading instead, whatever the program rounds; where
        rounding leaves nothing of a range, its middle alone.

        Raises
        ------
        EnclosureError
            If a reading may be 0 of which the reciprocal is not clipped.

        Notes
        -----
        Sound: yes, for an evaluation in float32 or better, in whatever form the map is written.
        """
        if not self:
            return lower, upper
        first, last = _reciprocals(lower, upper, within=within) if self.reciprocal else (lower, upper)
        ends = [self.scale * end + self.offset for end in (first, last)]
        size = [
            np.where(np.isfinite(end), np.abs(self.scale * end) + abs(self.offset), 0.0)
            for end in (first, last)
        ]
        spare = FEW_ROUNDINGS * np.maximum(*size)
        if within:
            spare = -np.minimum(spare, 0.5 * np.abs(ends[1] - ends[0]))
        least, most = np.minimum(*ends) - spare, np.maximum(*ends) + spare
        if self.clip is not None:
            low, high = self.clip if within else _as_stored(*self.clip)
            least, most = np.clip(least, low, high), np.clip(most, low, high)
        if not (np.isfinite(least).all() and np.isfinite(most).all()):
            raise EnclosureError(
                "a reading may be 0 or without bounds, so that nothing bounds what the network takes of it",
                "give the channel the `clip` with which the robot's software keeps it finite",
            )
        return least, most

    def forms(self, readings: Forms) -> Forms:
        """Encode readings that are linear forms of a state, (C, K).

        Notes
        -----
        Sound: yes, as `enclose`. What is surely not clipped stays a form; a reciprocal and what may be clipped are
        enclosed by the chord's slope; of the reciprocal of what may be 0 the ends of the clip are known.
        """
        if not self:
            return readings
        finite = (readings.lower > 0.0) | (readings.upper < 0.0)
        if self.reciprocal and self.clip is not None and not finite.all():
            low, high = _as_stored(*self.clip)
            still, ones = np.zeros_like(readings.slope), np.ones_like(readings.centre)
            half = (0.5 * (high - low) + FEW_ROUNDINGS * (abs(low) + abs(high))) * ones
            anything = Forms(0.5 * (low + high) * ones, still, half)
            return Forms.where(
                finite,
                self.forms(Forms.where(finite, readings, Forms(ones, still, 0.0 * ones))),
                anything,
            )
        if self.reciprocal:
            readings = _reciprocal_forms(readings)
        scaled = self.scale * readings.centre + self.offset
        size = np.abs(self.scale) * np.maximum(np.abs(readings.lower), np.abs(readings.upper)) + abs(
            self.offset
        )
        rest = abs(self.scale) * readings.rest + FEW_ROUNDINGS * size
        found = Forms(scaled, self.scale * readings.slope, rest)
        return found if self.clip is None else found.clipped(*self.clip)


PLAIN = Encoding()


def _as_stored(low: float, high: float) -> tuple[float, float]:
    """Return the ends of a clip, further apart where float32 holds them so."""
    return min(low, float(np.float32(low))), max(high, float(np.float32(high)))


def _reciprocals(lower: Floats, upper: Floats, *, within: bool) -> tuple[Floats, Floats]:
    """Bound the reciprocals of readings: by nothing where 0, of either sign, may be among them.

    With `within`, there is a reading for everything between: of those on both sides of 0 the positive ones count.
    """
    positive, negative = lower > 0.0, upper < 0.0
    with np.errstate(divide="ignore"):
        least, most = 1.0 / (upper + 0.0), 1.0 / lower  # 0.0 in the place of -0.0
    least = np.where(positive | negative | (within & (upper >= 0.0)), least, -np.inf)
    return least, np.where(positive | negative, most, np.inf)


def _reciprocal_forms(readings: Forms) -> Forms:
    """Enclose reciprocals by the chord's slope where all readings have one sign, and by nothing elsewhere."""
    lower, upper = readings.lower, readings.upper
    if not ((lower > 0.0) | (upper < 0.0)).all():
        raise EnclosureError(
            "a reading may be 0 somewhere in a set of states, and its reciprocal anything",
            "give the channel the `clip` with which the robot's software keeps it finite",
        )
    slope = -1.0 / (lower * upper)
    # 1/x - slope x is convex (concave for x < 0): its extremes are at the ends and at the tangent point
    at_ends = 1.0 / lower - slope * lower
    tangent = np.sign(lower) * 2.0 / np.sqrt(lower * upper)
    least, most = np.minimum(at_ends, tangent), np.maximum(at_ends, tangent)
    middle = 0.5 * (least + most)
    spare = FEW_ROUNDINGS * (np.abs(at_ends) + np.abs(tangent))
    rest = 0.5 * (most - least) + np.abs(slope) * readings.rest + spare
    return Forms(slope * readings.centre + middle, slope[:, None] * readings.slope, rest)
