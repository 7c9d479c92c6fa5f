"""How long a command has been running, the loading of viatool included where it was loaded for this command."""

from __future__ import annotations

import time

_begun: list[float] = [time.perf_counter()]
"""When viatool was loaded, then when each command began that the same process ran."""


def begin() -> None:
    """Say that a command begins; the first one began when viatool was loaded."""
    _begun.append(_begun[0] if len(_begun) == 1 else time.perf_counter())


def seconds_since_start() -> float:
    """Return the seconds since the command began."""
    return time.perf_counter() - _begun[-1]
