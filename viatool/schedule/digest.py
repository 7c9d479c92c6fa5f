"""A hash of plain values, arrays and dataclasses: equal values have equal hashes, in every process."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np


def digest_of(value: Any) -> str:
    """Return the SHA-256 of a value.

    Parameters
    ----------
    value : object
        Numbers, texts, None and arrays, dense or sparse in rows, and whatever dataclasses, mappings, tuples and lists
        are made of them.

    Raises
    ------
    TypeError
        If a part of it is of another type, which might look different each time.
    """
    found = hashlib.sha256()
    _feed(found, value)
    return found.hexdigest()


def _feed(found: Any, value: Any) -> None:
    if isinstance(value, np.ndarray) and value.dtype != object:
        found.update(f"array {value.dtype.str} {value.shape}\0".encode())
        found.update(np.ascontiguousarray(value).data.cast("B") if value.size else b"")
    elif hasattr(value, "indptr"):  # a sparse array in rows
        _feed_all(found, {name: getattr(value, name) for name in ("shape", "indptr", "indices", "data")})
    elif is_dataclass(value) and not isinstance(value, type):
        _feed_all(found, {field.name: getattr(value, field.name) for field in fields(value)})
    elif isinstance(value, Mapping):
        _feed_all(found, value)
    elif isinstance(value, tuple | list):
        _feed_all(found, dict(enumerate(value)))
    elif value is None or isinstance(value, bool | int | float | str | np.generic):
        found.update(f"{type(value).__name__} {value!r}\0".encode("utf-8", errors="surrogatepass"))
    else:
        raise TypeError(f"{type(value).__name__} has no digest")


def _feed_all(found: Any, parts: Mapping[Any, Any]) -> None:
    found.update(f"{len(parts)} parts\0".encode())
    for name, part in parts.items():
        found.update(f"{name}\0".encode("utf-8", errors="surrogatepass"))
        _feed(found, part)
