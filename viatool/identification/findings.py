"""What was measured of an error model, what was not and why, and how bounds are taken from samples."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from viatool.arrays import Floats
from viatool.errors import ConfigurationError
from viatool.uncertainty import ErrorModel

Value = float | int | tuple[float, float]
_DIGITS = 3


@dataclass(frozen=True)
class Bounding:
    """How bounds are taken from samples.

    Parameters
    ----------
    quantile : float
        Share of the samples that lies within a bound, in (0.5, 1].
    margin : float
        Share of a bound (of its width, where it has two ends) that is added to it.

    Raises
    ------
    ConfigurationError
        If one of both is out of its range.
    """

    quantile: float = 0.999
    margin: float = 0.1

    def __post_init__(self) -> None:
        if not 0.5 < self.quantile <= 1.0:
            raise ConfigurationError(
                f"the quantile is {self.quantile:g}, expected more than 0.5 and at most 1",
                "give the share of the samples that a bound shall hold, such as 0.999",
            )
        if not 0.0 <= self.margin < math.inf:
            raise ConfigurationError(
                f"the margin is {self.margin:g}, expected a finite share of 0 or more",
                "give 0.1 for a tenth",
            )

    def largest(self, errors: Floats) -> float:
        """Return a bound of the size of errors (S,)."""
        return self._upper(np.abs(errors)) * (1.0 + self.margin)

    def span(self, values: Floats, least: float = -math.inf) -> tuple[float, float]:
        """Return bounds between which values (S,) lie; the lower one is at least `least`."""
        low, high = -self._upper(-values), self._upper(values)
        more = self.margin * (high - low)
        return max(low - more, least), high + more

    def slowest(self, rates: Floats) -> float:
        """Return a bound that positive rates (S,) reach."""
        return -self._upper(-rates) / (1.0 + self.margin)

    def envelope(self, sizes: Floats, errors: Floats) -> tuple[float, float]:
        """Return an absolute and a relative bound: ``|error| <= absolute + relative * size`` for the quantile.

        Parameters
        ----------
        sizes, errors : ndarray
            (S,) each.

        Notes
        -----
        Of all such pairs it is the one that is smallest in the mean over the samples; a relative part has to earn its
        place, so that errors which do not grow with the size get none.
        """
        size, error = np.abs(sizes), np.abs(errors)
        largest = float(size.max(initial=0.0))
        steepest = self._upper(error) / largest if largest > 0.0 else 0.0
        best = (self._upper(error), 0.0)
        least = _EARNED * best[0]
        for relative in np.linspace(0.0, 1.5 * steepest, 61)[1:].tolist():
            absolute = max(self._upper(error - relative * size), 0.0)
            mean = absolute + relative * float(size.mean())
            if mean < least:
                best, least = (absolute, relative), mean
        return best[0] * (1.0 + self.margin), best[1] * (1.0 + self.margin)

    def _upper(self, values: Floats) -> float:
        return float(np.quantile(values, self.quantile, method="higher"))

    @property
    def words(self) -> str:
        """Return how bounds were taken, in words."""
        return f"{100.0 * self.quantile:g} % of the samples, and {100.0 * self.margin:g} % more"


_EARNED = 0.97
"""Share of a bound without a relative part below which one with it is preferred."""


@dataclass(frozen=True)
class MeasuredTerm:
    """A term of the error model that a recording tells.

    Parameters
    ----------
    place : str
        Where it stands in the file, such as ``sensor.lidar.absolute``.
    value : float, int or pair of float
        Of the term, with its margin.
    samples : int
        From how many.
    spread : str
        How they are spread, in words.
    """

    place: str
    value: Value
    samples: int
    spread: str

    @property
    def words(self) -> str:
        """Return samples and spread, in words."""
        return f"{self.samples:,} samples; {self.spread}"

    @property
    def number(self) -> str:
        """Return the value as the file has it, rounded outward."""
        value = self.value
        if isinstance(value, int):
            return str(value)
        if isinstance(value, tuple):
            return f"[{outward(value[0], up=False)}, {outward(value[1], up=True)}]"
        return outward(value, up=self.place.rpartition(".")[2] not in _FALLING)


_FALLING = ("acceleration", "deceleration")
"""Terms of which a smaller number allows more."""


@dataclass(frozen=True)
class UnmeasuredTerm:
    """A term, or several, that a recording does not tell, and why."""

    place: str
    reason: str


Finding = MeasuredTerm | UnmeasuredTerm


def spread_of(values: Floats, unit: str) -> str:
    """Return mean, standard deviation and ends of samples (S,), in words."""
    return (
        f"mean {values.mean():.3g}, standard deviation {values.std():.3g}, {values.min():.3g} to {values.max():.3g} "
        f"{unit}"
    ).rstrip()


@dataclass(frozen=True)
class Identification:
    """What a recording tells about the errors of a robot.

    Parameters
    ----------
    recording, world_map : str
        What was read.
    bounding : Bounding
        How bounds were taken.
    findings : tuple
        Terms that were measured, and those that were not.
    notes : tuple of str
        What was assumed and left out.
    """

    recording: str
    world_map: str
    bounding: Bounding
    findings: tuple[Finding, ...]
    notes: tuple[str, ...] = ()

    @property
    def measured(self) -> tuple[MeasuredTerm, ...]:
        """Return the terms that were measured."""
        return tuple(one for one in self.findings if isinstance(one, MeasuredTerm))

    @property
    def unmeasured(self) -> tuple[UnmeasuredTerm, ...]:
        """Return the terms that were not measured."""
        return tuple(one for one in self.findings if isinstance(one, UnmeasuredTerm))

    def to_yaml(self) -> str:
        """Return the error model as a file, with where each term comes from."""
        lines = [
            f"# Measured from {self.recording} against {self.world_map}.",
            f"# Bounds hold {self.bounding.words}; numbers are rounded outward.",
            *(f"# {note}" for note in self.notes),
            "version: 1",
        ]
        open_: list[str] = []
        for term in sorted(self.measured, key=lambda one: _order(one.place)):
            *sections, name = term.place.split(".")
            shared = _shared(open_, sections)
            lines += [f"{'  ' * depth}{sections[depth]}:" for depth in range(shared, len(sections))]
            open_, indent = sections, "  " * len(sections)
            lines += [f"{indent}# {term.words}", f"{indent}{name}: {term.number}"]
        if self.unmeasured:
            lines += ["# Not measured:", *(f"#   {one.place}: {one.reason}" for one in self.unmeasured)]
        return "\n".join(lines) + "\n"

    @property
    def model(self) -> ErrorModel:
        """Return the error model."""
        import yaml

        return ErrorModel.model_validate(yaml.safe_load(self.to_yaml()))


def _order(place: str) -> tuple[Any, ...]:
    """Sort as the model has its sections, terms of one section together."""
    sections = list(ErrorModel.model_fields)
    first, *rest = place.split(".")
    return sections.index(first), len(rest) > 1 and first == "actuation", rest


def _shared(first: Iterable[str], second: Iterable[str]) -> int:
    """Return how many sections two places have in common."""
    count = 0
    for one, other in zip(first, second, strict=False):
        if one != other:
            break
        count += 1
    return count


def outward(value: float, *, up: bool) -> str:
    """Return a number with few digits that is not smaller (or not larger) than a value."""
    if value == 0.0:
        return "0.0"
    step = 10.0 ** (math.floor(math.log10(abs(value))) - _DIGITS + 1)
    rounded = (math.ceil if up else math.floor)(value / step - (1e-9 if up else -1e-9)) * step
    return f"{rounded:.{_DIGITS}g}" if abs(rounded) < 1e4 else f"{rounded:.0f}"
