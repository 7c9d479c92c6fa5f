"""Means, intervals and decisions, by numbers worked out by hand."""

from __future__ import annotations

import math

import pytest

from viatool.studies.statistics import difference, estimate, rank_correlation, sign

T_4, T_2 = 2.7764451, 4.3026527  # Student's t at 97.5 %, from printed tables


def test_an_estimate_has_the_mean_the_sample_deviation_and_students_interval() -> None:
    found = estimate([1.0, 2.0, 3.0, 4.0, 5.0])
    assert (found.mean, found.count) == (3.0, 5)
    assert found.std == pytest.approx(math.sqrt(2.5))
    half = T_4 * math.sqrt(2.5) / math.sqrt(5)
    assert (found.low, found.high) == (pytest.approx(3 - half), pytest.approx(3 + half))


def test_one_seed_has_no_interval_and_equal_seeds_have_a_point() -> None:
    single = estimate([0.7])
    assert (single.mean, single.std, single.low, single.high) == (0.7, 0.0, -math.inf, math.inf)
    equal = estimate([0.5, 0.5, 0.5])
    assert (equal.low, equal.high) == (0.5, 0.5)


def test_a_difference_has_welchs_interval() -> None:
    found = difference([1.0, 2.0, 3.0], [1.0, 1.0, 1.0])  # the second does not vary: 2 degrees of freedom
    assert found.mean == 1.0
    half = T_2 * math.sqrt(1 / 3)
    assert (found.low, found.high) == (pytest.approx(1 - half), pytest.approx(1 + half))


def test_equal_variances_and_counts_give_welch_all_degrees_of_freedom() -> None:
    found = difference([1.0, 2.0, 3.0], [11.0, 12.0, 13.0])
    half = T_4 * math.sqrt(2 / 3)
    assert (found.low, found.high) == (pytest.approx(-10 - half), pytest.approx(-10 + half))


@pytest.mark.parametrize(
    ("first", "second", "expected"),
    [
        ([1.0, 2.0, 3.0], [11.0, 12.0, 13.0], -1),
        ([11.0, 12.0, 13.0], [1.0, 2.0, 3.0], 1),
        ([1.0, 2.0, 3.0], [1.0, 1.0, 1.0], 0),
        ([0.0, 0.0], [0.0, 0.0], 0),
        ([1.0], [0.0, 0.0], 0),
    ],
)
def test_a_difference_is_decided_when_its_interval_leaves_zero(
    first: list[float], second: list[float], expected: int
) -> None:
    assert sign(difference(first, second)) == expected


def test_rankings_that_agree_or_oppose() -> None:
    assert rank_correlation([1, 2, 3], [10, 20, 30]) == pytest.approx(1.0)
    assert rank_correlation([1, 2, 3], [30, 20, 10]) == pytest.approx(-1.0)
    assert rank_correlation([1, 1, 1], [1, 2, 3]) == 0.0
