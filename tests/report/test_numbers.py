"""A printed rate never flatters: rounding goes down and agrees with the gate."""

from __future__ import annotations

from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from viatool.report.gate import parse_threshold
from viatool.report.numbers import MISSING, digits_needed, percent_of, percentage
from viatool.report.states.document import StatesDocument

rates = st.integers(0, 10**9).flatmap(lambda total: st.tuples(st.integers(0, total), st.just(total)))


@given(rates)
def test_a_hundred_per_cent_is_printed_only_when_every_state_is_safe(rate: tuple[int, int]) -> None:
    safe, total = rate
    assert (percentage(safe, total) == "100.00 %") == (safe == total > 0)


def test_the_last_of_a_million_states_is_not_rounded_away() -> None:
    assert percentage(999_999, 1_000_000) == "99.99 %"


def test_no_states_give_no_rate() -> None:
    assert percentage(0, 0) == MISSING


@given(rates.filter(lambda rate: rate[1] > 0), st.decimals("0", "1", places=6))
def test_the_printed_rate_never_contradicts_the_gate(rate: tuple[int, int], least: object) -> None:
    safe, total = rate
    threshold = parse_threshold(str(least), StatesDocument).least
    digits = digits_needed(threshold)
    printed = Fraction(percentage(safe, total, digits).removesuffix(" %"))
    wanted = Fraction(percent_of(threshold, digits).removesuffix(" %"))
    assert (printed >= wanted) == (Fraction(safe, total) >= threshold)


@pytest.mark.parametrize(
    ("part", "total", "printed"), [(1, 3, "33.33 %"), (2, 3, "66.66 %"), (0, 7, "0.00 %")]
)
def test_rates_are_rounded_down(part: int, total: int, printed: str) -> None:
    assert percentage(part, total) == printed
