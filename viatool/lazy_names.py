"""Public names of a room that are imported when they are first used, so that nobody waits for what is not asked for."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any


def lazily(room: str, homes: Mapping[str, str]) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Return ``__getattr__`` and ``__dir__`` of a room.

    Parameters
    ----------
    room : str
        Its ``__name__``.
    homes : mapping
        The module in which each name is at home.
    """

    def getattribute(name: str) -> Any:
        if name not in homes:
            raise AttributeError(f"module '{room}' has no attribute '{name}'")
        value = getattr(import_module(homes[name]), name)
        setattr(sys.modules[room], name, value)
        return value

    return getattribute, lambda: sorted(sys.modules[room].__all__)
