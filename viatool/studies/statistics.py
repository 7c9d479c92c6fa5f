"""Means over seeds, differences between methods, tests of these, and their correction for being many."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np

from viatool.arrays import Floats

CONFIDENCE = 0.95
POWER = 0.8


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


@dataclass(frozen=True)
class Differences:
    """Differences of two means over seeds, of one shape, with what Welch's test needs of their spread.

    Parameters
    ----------
    mean : ndarray
        Of the first minus that of the second.
    error : ndarray
        Standard errors; infinite where the spread is not known.
    freedom : ndarray
        Degrees of freedom; 1 where the spread is not known.
    """

    mean: Floats
    error: Floats
    freedom: Floats

    def within(self, confidence: float = CONFIDENCE) -> tuple[Floats, Floats]:
        """Return the ends of confidence intervals."""
        from scipy.stats import t

        half = t.ppf((1 + confidence) / 2, self.freedom) * self.error
        return self.mean - half, self.mean + half

    def p_different(self) -> Floats:
        """Return the p-values, two-sided, of there being no difference."""
        from scipy.stats import t

        return cast(Floats, 2 * t.sf(np.abs(self.mean) / self.error, self.freedom))

    def p_equal(self, margin: float) -> Floats:
        """Return the p-values of a difference of `margin` or more, by two one-sided tests (Schuirmann, 1987)."""
        from scipy.stats import t

        return cast(Floats, t.sf((margin - np.abs(self.mean)) / self.error, self.freedom))

    def detectable(self, level: float, power: float = POWER) -> Floats:
        """Return how large a true difference must be to be found at that level with that power, to first order."""
        from scipy.stats import t

        return (t.ppf(1 - level / 2, self.freedom) + t.ppf(power, self.freedom)) * self.error


def differences(first: Floats, second: Floats, trials: int | None = None) -> Differences:
    """Compare values of seeds by Welch's test, the seed being the unit that was drawn.

    Parameters
    ----------
    first, second : ndarray
        ``(..., S)`` and ``(..., T)``, NaN where a seed has no value.
    trials : int, optional
        For shares of so many trials in each seed: their variance is taken to be no smaller than the binomial one of
        the share over all seeds of both, with one success and one failure added (Agresti and Caffo, 2000). Near 0
        and 1 a few seeds often agree by chance, and would pass for values without spread.

    Returns
    -------
    Differences
        Of shape ``(...)``. Where either has fewer than two values, or neither varies, the spread is not known.
    """
    counts = [np.isfinite(values).sum(axis=-1) for values in (first, second)]
    sums = [np.nansum(values, axis=-1) for values in (first, second)]
    enough = np.minimum(*counts) > 1
    least = 0.0
    if trials is not None:
        tried = (counts[0] + counts[1]) * trials
        share = ((sums[0] + sums[1]) * trials + 1) / (tried + 2)
        least = share * (1 - share) / trials
    means = [total / np.maximum(count, 1) for total, count in zip(sums, counts, strict=True)]
    parts = []
    for values, mean, count in zip((first, second), means, counts, strict=True):
        squares = np.nansum((values - mean[..., None]) ** 2, axis=-1)
        parts.append(np.maximum(squares / np.maximum(count - 1, 1), least) / np.maximum(count, 1))
    variance = parts[0] + parts[1]
    known = enough & (variance > 0.0)
    spread = sum(part**2 / np.maximum(count - 1, 1) for part, count in zip(parts, counts, strict=True))
    freedom = np.divide(variance**2, spread, out=np.ones(variance.shape), where=known)
    error = np.sqrt(variance, out=np.full(variance.shape, np.inf), where=known)
    return Differences(means[0] - means[1], error, freedom)


def holm(p_values: Floats) -> Floats:
    """Return p-values ``(..., K)`` of K tests, corrected so that any false rejection has that level (Holm, 1979)."""
    count = p_values.shape[-1]
    order = np.argsort(p_values, axis=-1)
    sorted_p = np.take_along_axis(p_values, order, axis=-1) * np.arange(count, 0, -1)
    adjusted = np.minimum(np.maximum.accumulate(sorted_p, axis=-1), 1.0)
    corrected = np.empty_like(adjusted)
    np.put_along_axis(corrected, order, adjusted, axis=-1)
    return corrected


def rank_correlation(first: Sequence[float], second: Sequence[float]) -> float:
    """Return Kendall's tau-b of two rankings; 0 if one of them ranks nothing."""
    from scipy.stats import kendalltau

    tau = float(kendalltau(first, second).statistic)
    return tau if np.isfinite(tau) else 0.0
