"""Means, intervals, tests and their correction, by numbers worked out by hand and by scipy's tests."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import ttest_ind

from viatool.studies.statistics import differences, estimate, holm, rank_correlation

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
    found = differences(np.array([1.0, 2.0, 3.0]), np.array([1.0, 1.0, 1.0]))  # 2 degrees of freedom
    low, high = found.within()
    half = T_2 * math.sqrt(1 / 3)
    assert found.mean == 1.0
    assert (low, high) == (pytest.approx(1 - half), pytest.approx(1 + half))


def test_differences_of_many_samples_are_scipys_welch_test_of_each() -> None:
    rng = np.random.default_rng(0)
    first, second = rng.normal(size=(7, 5)), rng.normal(0.5, 2.0, (7, 4))
    first[2, 3] = np.nan
    found = differences(first, second)
    low, high = found.within()
    for row in range(7):
        expected = ttest_ind(first[row], second[row], equal_var=False, nan_policy="omit")
        assert found.p_different()[row] == pytest.approx(expected.pvalue)
        assert found.freedom[row] == pytest.approx(expected.df)
        interval = expected.confidence_interval(0.95)
        assert (low[row], high[row]) == (pytest.approx(interval.low), pytest.approx(interval.high))


def test_what_has_no_known_spread_is_not_decided() -> None:
    equal, one = np.array([0.5, 0.5]), np.array([0.7, np.nan])
    for first, second in ((equal, equal + 0.1), (equal, one), (one, one + 1.0)):
        found = differences(first, second)
        assert found.p_different() == 1.0
        assert found.p_equal(1.0) >= 0.5
        assert np.isinf(found.within()).all()


def test_shares_that_agree_by_chance_have_the_spread_of_a_binomial() -> None:
    """Five seeds without a collision in 10 episodes each, against five with one of ten."""
    none, some = np.zeros(5), np.full(5, 0.1)
    assert differences(none, some).p_different() == 1.0  # neither varies
    found = differences(none, some, trials=10)
    share = (5 + 1) / (100 + 2)
    assert found.error == pytest.approx(math.sqrt(2 * share * (1 - share) / 10 / 5))
    spread = np.array([0.0, 0.4, 0.0, 0.5, 0.1])  # more than the binomial one: it stays
    assert differences(spread, spread, trials=1000).error == pytest.approx(
        math.sqrt(2 * spread.var(ddof=1) / 5)
    )


def test_equality_needs_the_whole_interval_within_the_margin() -> None:
    """Two one-sided tests at 5 % are the 90 % interval."""
    found = differences(np.array([1.0, 1.1, 0.9]), np.array([1.0, 1.2, 0.8]))
    low, high = found.within(0.9)
    widest = max(abs(low), abs(high))
    assert found.p_equal(float(widest) * 1.001) < 0.05 < found.p_equal(float(widest) * 0.999)


def test_a_difference_of_the_detectable_size_is_found_in_four_of_five_studies() -> None:
    rng = np.random.default_rng(1)
    size = 2.0
    first, second = rng.normal(size, 1.0, (20_000, 10)), rng.normal(0.0, 1.0, (20_000, 10))
    found = differences(first, second)
    typical = float(np.median(found.detectable(0.05)))
    shifted = differences(first - size + typical, second)
    assert (shifted.p_different() <= 0.05).mean() == pytest.approx(0.8, abs=0.03)


def test_holms_correction_by_hand() -> None:
    corrected = holm(np.array([0.01, 0.04, 0.03, 0.005]))
    assert corrected == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert (holm(np.array([[0.6, 0.6], [0.02, 1.0]])) == [[1.0, 1.0], [0.04, 1.0]]).all()


def test_holm_errs_at_all_in_at_most_one_of_twenty_families() -> None:
    p_values = np.random.default_rng(2).uniform(size=(20_000, 6))
    assert (holm(p_values).min(axis=1) <= 0.05).mean() == pytest.approx(0.05, abs=0.01)


def test_rankings_that_agree_or_oppose() -> None:
    assert rank_correlation([1, 2, 3], [10, 20, 30]) == pytest.approx(1.0)
    assert rank_correlation([1, 2, 3], [30, 20, 10]) == pytest.approx(-1.0)
    assert rank_correlation([1, 1, 1], [1, 2, 3]) == 0.0
