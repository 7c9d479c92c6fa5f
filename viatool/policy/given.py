"""Numbers as a caller gives them."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from viatool.arrays import Floats
from viatool.errors import ConfigurationError


def numbers(what: str, values: ArrayLike) -> Floats:
    """Return what a caller gave as float64.

    Raises
    ------
    ConfigurationError
        If rows have different lengths, or something is no real number; `what` says what the values are.
    """
    try:
        found = np.asarray(values)
    except ValueError:
        raise ConfigurationError(
            f"{what} are rows of different lengths", "give every row the same length"
        ) from None
    if found.dtype.kind not in "fiub" and found.size:
        raise ConfigurationError(
            f"{what} hold {found.dtype} values, expected real numbers", "give them as an array of float64"
        )
    return found.astype(np.float64)


def row(what: str, values: ArrayLike, size: int) -> Floats:
    """Return one row of numbers that a caller gave, (1, size); refused as by `numbers`, and if it has another size."""
    found = numbers(what, values)
    if found.shape != (size,):
        raise ConfigurationError(f"{what} has shape {found.shape}, expected ({size},)", "give one state")
    return found[None]
