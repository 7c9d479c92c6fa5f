"""Bisection over verdicts: what it finds are errors at which something was found, of all states at once."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from viatool.errors import BoundsError
from viatool.margins.bisection import Answers, Brackets, bisect
from viatool.safety import Witnesses

MOST, RESOLUTION = 1.0, 2.0**-7


class Oracle:
    """States of which a rule tells what is found at each error; keeps what it was asked."""

    def __init__(self, rule: Callable[[int, float], str]) -> None:
        self.rule = rule
        self.told: dict[tuple[int, float], str] = {}
        self.calls = 0

    def __call__(self, rows: np.ndarray, errors: np.ndarray) -> Answers:
        self.calls += 1
        found = [self.rule(row, error) for row, error in zip(rows.tolist(), errors.tolist(), strict=True)]
        asked = zip(rows.tolist(), errors.tolist(), strict=True)
        self.told |= dict(zip(asked, found, strict=True))
        refuted = np.array([one == "unsafe" for one in found])
        state = np.flatnonzero(refuted)
        count = len(state)
        seen = np.column_stack([rows[state], errors[state]]).astype(float)
        zero = np.zeros(count)
        poses = np.zeros((count, 3))
        witnesses = Witnesses.among_what_stands(
            state, seen, np.zeros((count, 2)), zero, poses, zero, poses, poses
        )
        return Answers(np.array([one == "safe" for one in found]), refuted, witnesses)

    def at(self, row: int, verdict: str) -> list[float]:
        return [error for (state, error), one in self.told.items() if state == row and one == verdict]


def thresholds(proved: list[float], refuted: list[float]) -> Callable[[int, float], str]:
    return lambda row, error: (
        "safe" if error <= proved[row] else "unsafe" if error >= refuted[row] else "unknown"
    )


def check(found: Brackets, oracle: Oracle) -> None:
    """Hold what was found against all that was told."""
    for row, (certified, refuted) in enumerate(zip(found.certified, found.refuted, strict=True)):
        assert certified == max(oracle.at(row, "safe"), default=-np.inf)
        assert refuted == min(oracle.at(row, "unsafe"), default=np.inf)
    assert (found.certified < found.refuted).all()
    kept = found.witnesses
    assert kept.state.tolist() == np.flatnonzero(np.isfinite(found.refuted)).tolist()
    assert (kept.observation[:, 0] == kept.state).all()  # each of its own state,
    assert (kept.observation[:, 1] == found.refuted[kept.state]).all()  # within the smallest error


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.floats(-0.5, 1.5), st.floats(0.0, 1.0)), min_size=1, max_size=12))
def test_both_ends_are_found_to_within_the_resolution(ends: list[tuple[float, float]]) -> None:
    proved = [low for low, _ in ends]
    refuted = [max(low + gap, 0.0) + 1e-9 for low, gap in ends]
    oracle = Oracle(thresholds(proved, refuted))
    found = bisect(oracle, len(ends), 2, 2, MOST, RESOLUTION)
    check(found, oracle)
    for row, (low, high) in enumerate(zip(proved, refuted, strict=True)):
        if low < 0.0:
            assert found.certified[row] == -np.inf
        else:
            assert found.certified[row] <= low < found.certified[row] + RESOLUTION or low >= MOST
        if high > MOST:
            assert found.refuted[row] == np.inf
        else:
            assert found.refuted[row] - RESOLUTION <= high <= found.refuted[row]


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.1, 0.9))
def test_verdicts_that_are_not_orderly_are_taken_for_what_they_prove(seed: int, truth: float) -> None:
    def rule(row: int, error: float) -> str:
        chance = np.random.default_rng([seed, row, int(error * 2**20)]).random()
        if chance < 0.5:
            return "unknown"
        return "safe" if error < truth else "unsafe"

    oracle = Oracle(rule)
    check(bisect(oracle, 8, 2, 2, MOST, RESOLUTION), oracle)


def test_a_contradiction_is_a_fault_and_no_margin() -> None:
    rule = thresholds([0.3], [0.9])
    with pytest.raises(BoundsError, match="proved safe within 1 and refuted within 0"):
        bisect(
            Oracle(lambda row, error: "unsafe" if error < 0.1 else rule(row, 0.0)), 1, 2, 2, MOST, RESOLUTION
        )


def test_all_states_go_through_a_round_together() -> None:
    rng = np.random.default_rng(0)
    proved = rng.uniform(0.0, 1.0, 300)
    oracle = Oracle(thresholds(proved.tolist(), (proved + rng.uniform(0.0, 0.3, 300)).tolist()))
    bisect(oracle, 300, 2, 2, MOST, RESOLUTION)
    assert oracle.calls <= 9  # both ends, and log2 of 128 rounds


def test_errors_that_are_asked_about_are_tried() -> None:
    oracle = Oracle(thresholds([0.0200001], [0.5]))
    found = bisect(oracle, 1, 2, 2, MOST, 0.25, also=[0.02])
    assert (0, 0.02) in oracle.told
    assert found.certified[0] == 0.02


def test_a_bisection_that_tells_the_upper_end_is_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    oracle = Oracle(thresholds([0.3, 0.6], [0.4, 0.6001]))
    found = bisect(oracle, 2, 2, 2, MOST, RESOLUTION)
    check(found, oracle)
    found.certified = found.unproved
    with pytest.raises(AssertionError):
        check(found, oracle)
