"""Calls of the library's functions, with arrays as C reads them."""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viatool.arrays import Floats, Indices
from viatool.engine import library
from viatool.errors import BoundsError

Passed = NDArray[Any] | ctypes.Structure | int | float | None
"""What a function of the library takes."""

_READ = {np.dtype(kind) for kind in (np.float64, np.int64, np.uint8, np.bool_)}


def call(name: str, asked: ctypes.Structure, *arguments: Passed) -> bool:
    """Call a function of the library, and return whether it could do its work.

    Parameters
    ----------
    name : str
        Of the function.
    asked : Structure
        What it takes first.
    *arguments : ndarray, Structure, int, float or None
        Integers have 64 bits in C, floats are doubles, None is NULL, a structure is passed by its address.

    Raises
    ------
    BoundsError
        If an array is not one of numbers that C reads, one row behind the other.
    """
    return bool(getattr(library(), name)(ctypes.byref(asked), *map(passed, arguments)))


def passed(argument: Passed) -> Any:
    """Return an argument as C takes it: arrays by the address of their rows, one behind the other, or not at all."""
    if isinstance(argument, np.ndarray):
        if argument.dtype not in _READ or not argument.flags.c_contiguous:
            raise BoundsError(
                f"internal error: an array of {argument.dtype} as it is for the compiled engine"
            )
        return ctypes.c_void_p(argument.ctypes.data)
    if argument is None:
        return None
    if isinstance(argument, ctypes.Structure):
        return ctypes.byref(argument)
    return ctypes.c_double(argument) if isinstance(argument, float) else ctypes.c_int64(argument)


def floats(values: Floats) -> Floats:
    """Return numbers as C reads them, copied only if they are not."""
    return np.ascontiguousarray(values, dtype=np.float64)


def integers(values: Indices) -> Indices:
    """Return whole numbers as C reads them, copied only if they are not."""
    return np.ascontiguousarray(values, dtype=np.int64)
