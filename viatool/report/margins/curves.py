"""Curves of margins: which share of the contested states survives more than an error."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from viatool.report.margins.record import PolicyMarginsRecord

if TYPE_CHECKING:
    from viatool.arrays import Floats


def proved_curve(part: PolicyMarginsRecord, most: float) -> tuple[Floats, Floats]:
    """Return from which errors on which share of the contested states is proved: steps, from 0 to the most."""
    states = part.contested_states
    return _steps([s.certified for s in states if s.certified is not None], len(states), most)


def withstood_curve(part: PolicyMarginsRecord, most: float) -> tuple[Floats, Floats]:
    """Return from which errors on which share of the contested states is not refuted: steps, from 0 to the most."""
    states = part.contested_states
    return _steps([most if s.refuted is None else s.refuted for s in states], len(states), most)


def _steps(errors: Sequence[float], total: int, most: float) -> tuple[Floats, Floats]:
    """Return from which errors on which share of all states survives more: steps; the last ones survive all."""
    values = np.asarray(errors, dtype=np.float64)
    ends = np.sort(values[values < most])
    left = np.arange(len(values), len(values) - len(ends) - 1, -1) / max(total, 1)
    return np.concatenate([[0.0], ends, [most]]), np.concatenate([left, left[-1:]])


def between(lower: tuple[Floats, Floats], upper: tuple[Floats, Floats]) -> tuple[Floats, Floats, Floats]:
    """Return the errors at which one of two curves steps, and the shares of both from there on."""
    at = np.unique(np.concatenate([lower[0], upper[0]]))
    low, high = (
        shares[np.clip(np.searchsorted(errors, at, side="right") - 1, 0, len(shares) - 1)]
        for errors, shares in (lower, upper)
    )
    return at, low, high
