"""Means over seeds, their uncertainty, and differences between methods."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

CONFIDENCE = 0.95


@dataclass(frozen=True)
class Estimate:
    """A quantity over independent seeds.

    Parameters
    ----------
    mean : float
        Over the seeds.
    std : float
        Standard deviation of the seeds (n - 1 in the denominator); 0 for one seed.
    low, high : float
        Confidence interval of the mean by Student's t; the mean itself when all seeds agree.
    count : int
        Seeds.
    """

    mean: float
    std: float
    low: float
    high: float
    count: int

    @property
    def half(self) -> float:
        """Return half of the width of the interval."""
        return (self.high - self.low) / 2


def estimate(values: Sequence[float], confidence: float = CONFIDENCE) -> Estimate:
    """Return the mean of the values of some seeds, at least one, with its confidence interval.

    Notes
    -----
    One seed tells nothing about the spread: its interval is infinite.
    """
    from scipy.stats import t

    sample = np.asarray(values, dtype=np.float64)
    count, mean = len(sample), float(sample.mean())
    if count == 1:
        return Estimate(mean, 0.0, -np.inf, np.inf, 1)
    std = float(sample.std(ddof=1))
    half = float(t.ppf((1 + confidence) / 2, count - 1)) * std / count**0.5
    return Estimate(mean, std, mean - half, mean + half, count)


def difference(first: Sequence[float], second: Sequence[float], confidence: float = CONFIDENCE) -> Estimate:
    """Return mean(first) - mean(second) with Welch's confidence interval.

    Returns
    -------
    Estimate
        Its `std` is the standard error of the difference, its `count` all seeds.
    """
    from scipy.stats import t

    a, b = estimate(first), estimate(second)
    shares = np.array([a.std**2 / a.count, b.std**2 / b.count])
    mean, count = a.mean - b.mean, a.count + b.count
    if min(a.count, b.count) == 1:
        return Estimate(mean, 0.0, -np.inf, np.inf, count)
    variance = float(shares.sum())
    if variance == 0.0:
        return Estimate(mean, 0.0, mean, mean, count)
    freedom = variance**2 / float((shares**2 / [a.count - 1, b.count - 1]).sum())
    half = float(t.ppf((1 + confidence) / 2, freedom)) * variance**0.5
    return Estimate(mean, variance**0.5, mean - half, mean + half, count)


def sign(found: Estimate) -> int:
    """Return +1 or -1 when the whole interval lies on that side of 0, else 0."""
    return int(found.low > 0.0) - int(found.high < 0.0)


def rank_correlation(first: Sequence[float], second: Sequence[float]) -> float:
    """Return Kendall's tau-b of two rankings; 0 if one of them ranks nothing."""
    from scipy.stats import kendalltau

    tau = float(kendalltau(first, second).statistic)
    return tau if np.isfinite(tau) else 0.0
