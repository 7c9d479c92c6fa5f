"""When ``--stop-early`` stops: once the gate ends in the same way whatever is found in the states that are left."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from viatool.report import Gate
    from viatool.verification.so_far import Enough, SoFar

WITHOUT = "the gate does not ask for them, and its outcome was certain (--stop-early)"
"""Why there are no close places then."""

_NEED_ALL = ("baseline", "accepted", "margins", "explain_errors")
"""Options about every state, or about every finding."""


def require_stoppable(given: Mapping[str, Any]) -> None:
    """Refuse to stop early where there is nothing to stop for, or something is asked of every state.

    Raises
    ------
    ConfigurationError
        If so.
    """
    from viatool.errors import ConfigurationError

    needing = [f"--{name.replace('_', '-')}" for name in _NEED_ALL if given[name]]
    needing += ["--output evidence" for text in given["output"] if text.startswith("evidence:")]
    if needing:
        raise ConfigurationError(
            f"--stop-early leaves states out, and {needing[0]} is about every one",
            f"leave {needing[0]} out, or --stop-early",
        )
    limits = (given["max_unsafe"], given["max_unknown"], given["min_contested"])
    if not given["fail_under"] and all(limit is None for limit in limits):
        raise ConfigurationError(
            "--stop-early stops when the outcome of the gate is certain, and there is no gate",
            "add a condition, such as --fail-under 0.99 or --max-unsafe 0",
        )


def asks_for_close_places(gate: Gate) -> bool:
    """Tell whether a condition is about close places."""
    return any(threshold.name == "close" for threshold in gate.thresholds)


def certain(gate: Gate) -> Enough:
    """Return what tells whether a gate is certain; conditions on close places are decided when these are judged."""
    from viatool.report.gate import evaluate, is_certain
    from viatool.report.states.so_far import StatesSoFar

    driven = tuple(threshold for threshold in gate.thresholds if threshold.name != "close")
    asked = replace(gate, thresholds=driven)

    def enough(found: SoFar) -> bool:
        return is_certain(evaluate(asked, StatesSoFar(found)))

    return enough
