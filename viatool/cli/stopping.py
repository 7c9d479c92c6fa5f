"""When ``--stop-early`` stops: once the gate ends in the same way whatever is found in what is left."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from viatool.report import Document, Gate

WITHOUT = "the gate does not ask for them, and its outcome was certain (--stop-early)"
"""Why there are no close places then."""

_NEED_ALL = ("baseline", "accepted", "margins", "explain_errors")
"""Options about everything that is judged, or about every finding; not every command has each."""


def require_stoppable(given: Mapping[str, Any]) -> None:
    """Refuse to stop early where there is nothing to stop for, or something is asked of all.

    Raises
    ------
    ConfigurationError
        If so.
    """
    from viatool.errors import ConfigurationError

    needing = [f"--{name.replace('_', '-')}" for name in _NEED_ALL if given.get(name)]
    needing += ["--output evidence" for text in given["output"] if text.startswith("evidence:")]
    if needing:
        raise ConfigurationError(
            f"--stop-early leaves out what cannot change the gate, and {needing[0]} is about all",
            f"leave {needing[0]} out, or --stop-early",
        )
    partly = [
        f"--{name}"
        for name, unless in (("sample", 1.0), ("budget-cells", None))
        if given.get(name.replace("-", "_"), unless) != unless
    ]
    if partly:
        raise ConfigurationError(
            f"{partly[0]} examines a part of the map, of which no condition of a gate holds",
            f"leave {partly[0]} out, or --stop-early",
        )
    limits = (given.get(name) for name in ("max_unsafe", "max_unknown", "min_contested"))
    if not given["fail_under"] and all(limit is None for limit in limits):
        raise ConfigurationError(
            "--stop-early stops when the outcome of the gate is certain, and there is no gate",
            "add a condition, such as --fail-under 0.99 or --max-unsafe 0",
        )


def asks_for_close_places(gate: Gate) -> bool:
    """Tell whether a condition is about close places."""
    return any(threshold.name == "close" for threshold in gate.thresholds)


def without_close_places(gate: Gate) -> Gate:
    """Return the conditions that driven states decide; the others are decided when close places are judged."""
    return replace(gate, thresholds=tuple(one for one in gate.thresholds if one.name != "close"))


def certain(gate: Gate, kind: Callable[[Any], Document]) -> Callable[[Any], bool]:
    """Return what tells whether a gate is certain, of what is known so far; `kind` makes a document of that."""
    from viatool.report.gate import evaluate, is_certain

    return lambda found: is_certain(evaluate(gate, kind(found)))
