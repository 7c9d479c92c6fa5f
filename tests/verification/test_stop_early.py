"""A run that stops early ends as the whole run does, and says what it left out."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from viatool.report import Gate, Threshold, evaluate
from viatool.report.gate import is_certain
from viatool.report.ruling import Ruling
from viatool.report.states.so_far import StatesSoFar
from viatool.verification.so_far import JudgedCount

RATES = ("overall", "danger", "sampled", "contested", "success", "collision", "timeout")


def parts_of(table: Any) -> list[Any]:
    """Cut a table of verdicts (N, 5), of bool, into blocks as the examination finds them."""
    parts = []
    for first in range(0, len(table), 3):
        safe, danger, sampled, contested, unsafe = table[first : first + 3].T
        parts.append(
            SimpleNamespace(
                judgement=SimpleNamespace(safe=safe, danger=danger, sampled=sampled),
                contested=SimpleNamespace(collision=contested),
                witnesses=SimpleNamespace(state=first + np.flatnonzero(unsafe & ~safe)),
                tubes=None,
            )
        )
    return parts


def outcome_of(gate: Gate, found: Any) -> str:
    return Ruling(evaluate(gate, StatesSoFar(found))).outcome


LEAST = st.sampled_from([Fraction(0), Fraction(1, 3), Fraction(1, 2), Fraction(9, 10), Fraction(1)])
THRESHOLDS = st.lists(st.builds(Threshold, st.sampled_from(RATES), LEAST), max_size=3).map(tuple)
LIMIT = st.none() | st.integers(0, 8)
GATES = st.builds(
    Gate, THRESHOLDS, max_unsafe=LIMIT, max_unknown=LIMIT, min_contested=LIMIT, exit_zero=st.booleans()
)


@settings(max_examples=400, deadline=None)
@given(gate=GATES, data=st.data())
def test_no_later_verdict_changes_how_a_gate_ends_that_is_certain(gate: Gate, data: st.DataObject) -> None:
    count = data.draw(st.integers(1, 24))
    generator = np.random.default_rng(data.draw(st.integers(0, 2**32)))
    table = generator.random((count, 5)) < generator.choice([0.02, 0.5, 0.98], size=5)
    outcome = generator.choice(["success", "collision", "timeout", "unknown"], size=count)
    parts = parts_of(table)
    everything = JudgedCount(outcome, lambda found: False)
    everything(parts)
    whole = outcome_of(gate, everything.so_far)
    stopped = []
    watch = JudgedCount(
        outcome, lambda found: stopped.append(found) or is_certain(evaluate(gate, StatesSoFar(found)))
    )
    for length in range(1, len(parts) + 1):
        if watch(parts[:length]):
            break
    assert outcome_of(gate, stopped[-1]) == whole
    judged = stopped[-1].rates["overall"].total
    assert stopped[-1].unjudged["overall"] == count - judged
    assert stopped[-1].rates["overall"].safe == table[:judged, 0].sum()


def so_far(
    safe: int, total: int, left: int, *, contested: tuple[int, int] = (0, 0), unsafe: int = 0
) -> StatesSoFar:
    """Return what is known of states of successful episodes."""
    outcome = np.full(total + left, "success")
    table = np.zeros((total, 5), dtype=bool)
    table[:safe, :3] = True
    table[: contested[0], 3] = table[total - contested[1] + contested[0] :, 3] = True
    table[total - unsafe :, 4] = True
    watch = JudgedCount(outcome, lambda found: False)
    watch(parts_of(table))
    return StatesSoFar(watch.so_far)


@pytest.mark.parametrize(
    ("gate", "found", "certain"),
    [
        (Gate((Threshold("overall", Fraction(1, 2)),)), so_far(5, 5, 5), True),
        (Gate((Threshold("overall", Fraction(1, 2)),)), so_far(4, 4, 5), False),
        (Gate((Threshold("overall", Fraction(9, 10)),)), so_far(3, 5, 5), True),
        (Gate((Threshold("overall", Fraction(9, 10)),)), so_far(4, 5, 5), False),
        (Gate(max_unsafe=0), so_far(4, 5, 5, unsafe=1), True),
        (Gate(max_unsafe=0), so_far(5, 5, 5), False),
        (Gate(max_unsafe=5), so_far(5, 5, 5), True),
        (Gate((Threshold("contested", Fraction(0)),)), so_far(5, 5, 5), False),  # there may be none: exit 5
        (Gate((Threshold("contested", Fraction(0)),)), so_far(5, 5, 5, contested=(1, 1)), True),
        (Gate(min_contested=1, max_unsafe=0), so_far(4, 5, 5, unsafe=1), False),  # exit 1 or 5
        (Gate((Threshold("timeout", Fraction(0)),)), so_far(5, 5, 5), True),  # there are none, exit 5
        (Gate((Threshold("timeout", Fraction(0)),), max_unsafe=0), so_far(5, 5, 5), True),  # whatever the other
    ],
)  # fmt: skip
def test_a_gate_is_certain_when_nothing_can_change_it(gate: Gate, found: StatesSoFar, certain: bool) -> None:
    assert is_certain(evaluate(gate, found)) is certain


def test_a_condition_that_was_not_decided_is_not_taken_to_hold() -> None:
    gate = Gate((Threshold("overall", Fraction(3, 4)),), max_unsafe=0)
    least, most = evaluate(gate, so_far(6, 7, 3, unsafe=1))
    assert (least.passed, least.open, least.word) == (False, True, "NOT DECIDED")
    assert least.figures == "60.00 % to 90.00 %, 3 not judged"
    assert (most.passed, most.open, most.figures) == (False, False, "1 unsafe, 3 not judged")
    assert [
        check.outcome for check in evaluate(replace(gate, exit_zero=True), so_far(6, 7, 3, unsafe=1))
    ] == [
        "warning",
        "warning",
    ]
