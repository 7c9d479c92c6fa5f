"""Which unsafe states an older report knows, too."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from viatool.report.states.record import UnsafeState

SAME = 1e-3  # metres and radians within which a pose counts as the same


def new_states(before: Sequence[UnsafeState], now: Sequence[UnsafeState]) -> Iterator[UnsafeState]:
    """Yield the states of now that were not among those before."""
    known: dict[tuple[str, float], list[UnsafeState]] = {}
    for state in before:
        known.setdefault((state.scenario, round(state.time, 3)), []).append(state)
    for state in now:
        there = known.get((state.scenario, round(state.time, 3)), [])
        if not any(_same_pose(state, old) for old in there):
            yield state


def _same_pose(state: UnsafeState, other: UnsafeState) -> bool:
    """Tell whether two states of one scenario and time are one: runs on other machines differ by rounding."""
    x, y, turn = (a - b for a, b in zip(state.pose, other.pose, strict=True))
    return math.hypot(x, y) < SAME and abs(math.remainder(turn, math.tau)) < SAME
