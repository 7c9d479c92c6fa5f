"""Fitting responses to steps: delay, time constant and limit, by search over all three."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from itertools import product

import numpy as np

from viatool.arrays import Booleans, Floats

_DELAYS = np.linspace(0.0, 0.6, 21)
_LAGS = np.concatenate([[0.0], np.geomspace(0.02, 1.0, 9)])
_RISES = np.concatenate(
    [[0.0], np.geomspace(0.05, 3.0, 9)]
)  # s that a limited velocity would take for the whole step
_ROUNDS = 5
_WORST = 0.1  # of the step, root mean square
_LIMITED = 0.85  # of the rise, that the lag may take up: beyond, the limit was hardly reached


@dataclass(frozen=True, eq=False)
class Responses:
    """How S steps were followed.

    Parameters
    ----------
    delay, lag : ndarray
        (S,) seconds.
    rate : ndarray
        (S,) m/s^2 or rad/s^2; infinite where no limit was seen.
    rise : ndarray
        (S,) seconds that the whole step takes at that rate.
    limited, grows : ndarray
        (S,) bool: whether the step was limited by the rate, and whether the velocity grew.
    """

    delay: Floats
    lag: Floats
    rate: Floats
    rise: Floats
    limited: Booleans
    grows: Booleans

    def __len__(self) -> int:
        """Return S."""
        return len(self.delay)

    @classmethod
    def join(cls, parts: Sequence[Responses]) -> Responses:
        """Return the responses of all parts."""
        if not parts:
            none = np.zeros(0)
            return cls(none, none, none, none, none > 0.0, none > 0.0)
        return cls(*(np.concatenate([getattr(part, one.name) for part in parts]) for one in fields(cls)))

    def settled_after(self, lags: float) -> float:
        """Return after how many seconds every step has settled."""
        return float((self.delay + self.rise + lags * self.lag).max()) + 0.1


def fit_responses(seconds: Floats, share: Floats, change: float, *, grows: bool) -> Responses | None:
    """Fit the response to one step.

    Parameters
    ----------
    seconds, share : ndarray
        (M,) since the step, and how much of it has been done: from about 0 to about 1.
    change : float
        The size of the step in m/s or rad/s.
    grows : bool
        Whether the velocity grows.

    Returns
    -------
    Responses or None
        One; None if nothing fits.
    """
    axes = [_DELAYS, _LAGS, _RISES]
    best = np.zeros(3)
    for _ in range(_ROUNDS):
        grid = np.array(list(product(*axes)))
        misfit = _misfit(grid, seconds, share)
        best = grid[misfit.argmin()]
        axes = [_finer(axis, at) for axis, at in zip(axes, best, strict=True)]
    if not np.sqrt(misfit.min()) <= _WORST:
        return None
    delay, lag, rise = (np.array([value]) for value in best)
    limited = (lag < _LIMITED * rise) & (rise > 0.0)
    rate = np.where(limited, change / np.where(rise > 0.0, rise, 1.0), np.inf)
    return Responses(delay, lag, rate, np.where(limited, rise, 0.0), limited, np.array([grows]))


def _misfit(grid: Floats, seconds: Floats, share: Floats) -> Floats:
    """Return the mean square by which responses (G, 3) differ from what was measured, (G,)."""
    delay, lag, rise = (part[:, None] for part in grid.T)
    past = np.maximum(seconds - delay, 0.0)
    slope = np.where(rise > 0.0, 1.0 / np.where(rise > 0.0, rise, 1.0), 0.0)
    ramp = np.maximum(rise - lag, 0.0)  # until only what the lag alone would do is left
    left = np.where(rise > 0.0, 1.0 - slope * np.minimum(past, ramp), 1.0)
    after = np.maximum(past - ramp, 0.0)
    decay = np.where(lag > 0.0, np.exp(-after / np.where(lag > 0.0, lag, 1.0)), past < ramp)
    decay = np.where((lag == 0.0) & (rise == 0.0), past <= 0.0, decay)
    return np.asarray(np.square(share - (1.0 - left * decay)).mean(axis=1))


def _finer(axis: Floats, at: float) -> Floats:
    """Return a finer axis between the neighbours of a value."""
    number = int(np.abs(axis - at).argmin())
    low, high = axis[max(number - 1, 0)], axis[min(number + 1, len(axis) - 1)]
    return np.unique(np.append(np.linspace(low, high, 9), at))
