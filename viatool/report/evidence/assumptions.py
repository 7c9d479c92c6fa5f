"""Who vouches for each assumption: the tool, a recording that `measure-errors` measured, or nobody yet."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    from viatool.verification.result import Result

Status = Literal["tool", "measure-errors", "open"]

MEANING: Mapping[Status, str] = {
    "tool": "checked by the tool",
    "measure-errors": "checked by measure-errors",
    "open": "open",
}

_MEASURED = "# Measured from "
"""How files begin that measure-errors writes."""

_MEASURABLE = "compare with a recording: viatool measure-errors"

_KNOWN: dict[str, tuple[Status, str]] = {
    "criterion": ("open", "whether this criterion is the right one for the robot's task"),
    "arithmetic": (
        "tool",
        "rounding is counted in the bounds; the network was compared with onnxruntime before",
    ),
    "engine": ("tool", "bounds are rounded outward, and safe states are judged by them"),
    "states": ("open", "whether these states stand for those that the robot will be in"),
    "recording": ("tool", "the recorded readings were compared with the map"),
    "before the network": (
        "open",
        "whether the robot feeds the network this way: viatool doctor tries a recording",
    ),
    "after the network": (
        "open",
        "whether the robot takes its outputs this way: viatool doctor tries a recording",
    ),
    "footprint": ("open", "measure the robot with its load"),
    "clearance": ("open", "whether this distance is enough is for those who use the robot"),
    "commands": ("open", f"whether the robot has these limits; how it follows commands: {_MEASURABLE}"),
    "motion": ("open", f"whether the robot moves this way: {_MEASURABLE}"),
    "horizon": ("open", "what comes after is not spoken of: viatool mission follows whole runs"),
    "delay": ("open", _MEASURABLE),
    "braking": ("open", "a test of the brakes with the largest load"),
    "obstacles": ("open", "whether the map shows everything that is there, and what of it moves"),
    "sensor error": ("open", _MEASURABLE),
    "memory": ("open", "what earlier sensor errors would have made of it is not asked about"),
}

_UNCHECKED = "nobody has checked it"

_SECTIONS = ("sensor", "actuation", "timing")
"""Sections of an error model that a recording can tell."""

_TOOL_ALONE = ("inside the model",)
"""What the tool has read in the model itself, where the assumption says nothing else."""


@dataclass(frozen=True)
class Assumption:
    """One thing that the claims rest on.

    Parameters
    ----------
    name, value : str
        What it is about, and what is assumed.
    status : str
        ``tool``, ``measure-errors`` or ``open``.
    how : str
        What was checked, or what is left to check.
    """

    name: str
    value: str
    status: Status
    how: str

    def to_json(self) -> dict[str, Any]:
        """Return the form in the folder."""
        return asdict(self)


def assumptions_of(assumed: Mapping[str, str], result: Result, errors: Path | None) -> tuple[Assumption, ...]:
    """Return everything that claims rest on: what a report assumes, terms of the error model, and those left out.

    Parameters
    ----------
    assumed : mapping
        What the report lists under *Assumed*.
    result : Result
        What was found.
    errors : Path, optional
        The file of the error model.

    Notes
    -----
    Whatever is not known to be checked is open.
    """
    measured = errors is not None and _is_measured(errors)
    model = result.setting.uncertainty
    found = []
    for name, value in assumed.items():
        status, how = _KNOWN.get(name, ("open", _UNCHECKED))
        if value.startswith(_TOOL_ALONE) and ";" not in value:
            status, how = "tool", "read in the model itself, which is what was bounded"
        found.append(Assumption(name, value, status, how))
    for place, words in model.premises():
        can_be = place.partition(".")[0] in _SECTIONS
        if measured and can_be:
            told = f"measured from a recording, as {model.source} says"
            found.append(Assumption(place, words, "measure-errors", told))
        else:
            found.append(Assumption(place, words, "open", _MEASURABLE if can_be else _UNCHECKED))
    left_out = [
        Assumption(f"left out: {name}", words, "open", _MEASURABLE if name in _SECTIONS else _UNCHECKED)
        for name, words in model.assumed().items()
    ]
    return (*found, *left_out)


def _is_measured(errors: Path) -> bool:
    """Tell whether a file says that measure-errors wrote it."""
    with errors.open(encoding="utf-8", errors="replace") as stream:
        return stream.readline().startswith(_MEASURED)
