"""The gate decides on integers, exactly as the user wrote the rate."""

from __future__ import annotations

from fractions import Fraction

import pytest

from viatool.errors import ConfigurationError
from viatool.report import Check, Gate, evaluate
from viatool.report import parse_threshold as parse_threshold_of
from viatool.report.gate import Threshold
from viatool.report.states.document import StatesDocument


def parse_threshold(text: str) -> Threshold:
    return parse_threshold_of(text, StatesDocument)


def passes(gate: Gate, document) -> bool:
    return all(check.passed for check in evaluate(gate, document))


@pytest.mark.parametrize(
    ("text", "name", "least"),
    [
        ("0.99", "overall", Fraction(99, 100)),
        ("99%", "overall", Fraction(99, 100)),
        ("danger=0.1", "danger", Fraction(1, 10)),
        ("1", "overall", Fraction(1)),
        ("1e-2", "overall", Fraction(1, 100)),
    ],
)
def test_thresholds_are_read_exactly(text: str, name: str, least: Fraction) -> None:
    threshold = parse_threshold(text)
    assert (threshold.name, threshold.least) == (name, least)


@pytest.mark.parametrize(
    "text", ["", "nan", "inf", "-0.1", "1.1", "101%", "safe", "nearby=0.5", "1e-999999999", "=0.5"]
)
def test_what_is_no_rate_is_refused(text: str) -> None:
    with pytest.raises(ConfigurationError):
        parse_threshold(text)


def test_a_rate_that_float_arithmetic_cannot_hold_is_decided_exactly(document) -> None:
    # 0.07 in binary is above 7/100: a float comparison fails this gate.
    assert passes(Gate((parse_threshold("0.07"),)), document(7, 0, 93))


def test_one_state_below_the_threshold_fails(document) -> None:
    gate = Gate((parse_threshold("0.9999999"),))
    assert not passes(gate, document(9_999_998, 2, 0))
    assert passes(gate, document(9_999_999, 1, 0))


def test_a_gate_without_conditions_never_fails(document) -> None:
    assert passes(Gate(), document(0, 0, 0))


def test_an_empty_evaluation_never_passes(document) -> None:
    (check,) = evaluate(Gate((parse_threshold("0.0"),)), document(0, 0, 0))
    assert (check.passed, check.empty) == (False, True)


@pytest.mark.parametrize(("gate", "expected"), [(Gate(max_unsafe=1), True), (Gate(max_unsafe=0), False)])
def test_unsafe_states_are_counted(document, gate: Gate, expected: bool) -> None:
    assert passes(gate, document(97, 1, 2)) is expected


def test_unknown_states_are_counted(document) -> None:
    assert not passes(Gate(max_unknown=1), document(97, 1, 2))


def test_too_few_contested_states_are_nothing_evaluated(document) -> None:
    (enough,) = evaluate(Gate(min_contested=3), document(97, 1, 2))
    assert (enough.passed, enough.empty) == (True, False)
    (few,) = evaluate(Gate(min_contested=4), document(97, 1, 2))
    assert (few.passed, few.empty, few.condition, few.figures) == (
        False,
        True,
        "at least 4 contested",
        "3 contested",
    )
    assert "more scenarios" in few.hint


def test_a_report_passes_against_itself_and_fails_against_a_better_baseline(document) -> None:
    assert passes(Gate(baseline=document(97, 1, 2)), document(97, 1, 2))
    assert not passes(Gate(baseline=document(98, 1, 1)), document(97, 1, 2))
    assert not passes(Gate(baseline=document(97, 0, 3)), document(97, 1, 2))


def test_a_baseline_made_with_another_sensor_error_is_named_as_such(document) -> None:
    now = document(97, 1, 2)
    before = document(97, 1, 2, eps=0.5)
    assert all("another eps" in check.figures for check in evaluate(Gate(baseline=before), now))
    assert not any("another" in check.figures for check in evaluate(Gate(baseline=now), now))


def test_an_empty_evaluation_passes_no_condition_at_all(document) -> None:
    gate = Gate((parse_threshold("0"),), max_unsafe=0, max_unknown=0, baseline=document(1, 0, 0))
    checks = evaluate(gate, document(0, 0, 0))
    assert len(checks) > 3
    assert all(check.empty and not check.passed for check in checks)


def unsafe_at(document, *places: tuple[str, float, float]):
    """Return a report of three unsafe states in a hundred, with some of them listed by scenario, time and x."""
    listed = [
        {"state": number, "scenario": scenario, "time": time, "pose": (x, 0.0, 3.14159)}
        for number, (scenario, time, x) in enumerate(places)
    ]
    return document(97, 3, 0, unsafe_states=listed)


@pytest.mark.parametrize(
    ("places", "named"),
    [
        ((("past", 2.3, 0.5),), None),
        ((), None),
        ((("past", 2.3, 0.50004),), None),  # the same state with the rounding of another machine
        ((("past", 2.4, 0.5),), "past at 2.40 s"),
        ((("other", 2.3, 0.5),), "other at 2.30 s"),
        ((("past", 2.3, 0.6),), "past at 2.30 s"),
        ((("past", 2.3, 0.5), ("past", 9.0, 0.5)), "past at 9.00 s"),
    ],
)
def test_an_unsafe_state_that_the_baseline_lacks_fails(document, places, named: str | None) -> None:
    baseline = unsafe_at(document, ("past", 2.3, 0.5), ("past", 5.0, 1.0))
    (*_, check) = evaluate(Gate(baseline=baseline), unsafe_at(document, *places))
    assert check.passed is (named is None)
    assert (named or "0 new") in check.figures


def test_a_baseline_that_lists_no_states_is_compared_by_their_number(document) -> None:
    (*_, check) = evaluate(Gate(baseline=document(97, 3, 0)), unsafe_at(document, ("past", 1.0, 0.0)))
    assert check == Check("no more unsafe states than the baseline", passed=True, figures="3, was 3")
