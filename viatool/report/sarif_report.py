"""SARIF 2.1.0, for code-scanning dashboards: one result for each state that is not safe."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from viatool.report.document import read_result
from viatool.report.sarif_log import GATE, Finding, compose_log

if TYPE_CHECKING:
    from viatool.report.gate import Check
    from viatool.verification.result import Result

SUFFIXES = (".sarif", ".json")
RULES = {
    "unsafe-state": ("error", "A sensor error within eps makes the deployed policy violate the criterion."),
    "unknown-state": ("warning", "The criterion could be neither proved nor refuted."),
    **GATE,
}


def render(result: Result, checks: Sequence[Check], suffix: str) -> str:
    """Return the log; failed conditions of the gate first, then unsafe states, then unknown ones."""
    doubtful = int((result.verdict != "safe").sum())
    return compose_log(read_result(result), RULES, checks, _doubtful(result), doubtful)


def _doubtful(result: Result) -> Iterator[Finding]:
    trajectory = result.trajectory
    for verdict in ("unsafe", "unknown"):
        for state in np.flatnonzero(result.verdict == verdict).tolist():
            name, time = trajectory.name_of(trajectory.episode[state]), float(trajectory.time[state])
            x, y, heading = trajectory.poses[state].tolist()
            text = (
                f"State {state} is {verdict}: scenario {name} at {time:.2f} s, "
                f"x {x:.3f} m, y {y:.3f} m, heading {heading:.3f} rad."
            )
            # Poses that were picked have no time that tells them apart.
            place = f"{name}/{time:.3f}" if trajectory.connected else f"{name}/{x:.3f},{y:.3f},{heading:.3f}"
            yield Finding(f"{verdict}-state", text, place, place)
