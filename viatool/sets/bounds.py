"""Bounds as every proof takes them for granted: no NaN, and no lower end above its upper one."""

from __future__ import annotations

import numpy as np

from viatool.arrays import Floats
from viatool.errors import BoundsError


def require_ordered(
    what: str, lower: Floats, upper: Floats, *, finite: bool = False, rounding: float = 0.0
) -> None:
    """Refuse bounds of which a proof would be about nothing.

    Parameters
    ----------
    what : str
        What is bounded, in the plural.
    lower, upper : ndarray
        (...) ends, in the same unit.
    finite : bool
        Whether infinite ends are refused, too.
    rounding : float
        By how much, relative to their size, ends may be the wrong way round that two computations rounded
        differently.

    Raises
    ------
    BoundsError
        If an end is NaN, or a lower one is above its upper one.

    Notes
    -----
    Every box whose ends are crossed is empty, and of an empty box everything holds: this is where such a box stops.
    """
    ordered = lower <= upper + rounding * (1.0 + np.abs(upper)) if rounding else lower <= upper
    if finite:
        ordered = ordered & np.isfinite(lower) & np.isfinite(upper)
    if not np.all(ordered):
        first = tuple(np.argwhere(~np.asarray(ordered))[0])
        ends = (float(np.broadcast_to(end, np.shape(ordered))[first]) for end in (lower, upper))
        raise BoundsError(
            "internal error: the {} are bounded by {:g} and {:g}, but a lower bound is a number "
            "of at most the upper one".format(what, *ends)
        )
