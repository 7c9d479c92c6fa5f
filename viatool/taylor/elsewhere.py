"""Bounds of a Taylor model of which a few inputs lie somewhere else than the others; see `observed`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from viatool.arrays import Floats, Hull, Indices
from viatool.rounding import ENGINE_ROUNDOFF, SLIGHTLY_MORE
from viatool.taylor.model import TaylorModel


@dataclass(frozen=True, eq=False)
class FewSymbols:
    """Symbols of an input model of which up to `count` lie in another range than else.

    Parameters
    ----------
    count : int
        How many at once.
    symbols : ndarray
        (E,) their numbers.
    usual, elsewhere : tuple of ndarray
        (B, E) ends of both ranges, within [-1, 1].
    """

    count: int
    symbols: Indices
    usual: Hull
    elsewhere: Hull

    def most(self, slope: Floats) -> Floats:
        """Bound what the symbols add to actions at most, (B, A), of what each of them adds, (B, E, A)."""
        usual, elsewhere = (
            np.maximum(slope * ends[0][:, :, None], slope * ends[1][:, :, None])
            for ends in (self.usual, self.elsewhere)
        )
        gain = np.maximum(elsewhere - usual, 0.0)
        count = min(self.count, gain.shape[1])
        largest = np.partition(gain, gain.shape[1] - count, axis=1)[:, gain.shape[1] - count :]
        return np.asarray(usual.sum(axis=1) + largest.sum(axis=1))


def few_hull(model: TaylorModel, few: tuple[FewSymbols, ...]) -> Hull:
    """Enclose the range of a Taylor model of order 1. **Sound:** yes, by the derivation in `observed`."""
    linear = model.linear.dense()
    usual = np.setdiff1d(np.arange(linear.shape[1]), np.concatenate([some.symbols for some in few]))
    rest = model.remainder + np.abs(linear[:, usual]).sum(axis=1)
    rest = rest + sum(form.norms() for form in model.symbols.values())
    rest = rest * SLIGHTLY_MORE + 8 * linear.shape[1] * ENGINE_ROUNDOFF * model.magnitude
    below, above = (
        sum(some.most(sign * linear[:, some.symbols]) for some in few) + rest for sign in (-1.0, 1.0)
    )
    return model.constant - below, model.constant + above
