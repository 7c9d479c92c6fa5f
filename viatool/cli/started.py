"""How long this process has been running, what Python itself needs to start included where that is known."""

from __future__ import annotations

import os
import time
from pathlib import Path

_IMPORTED = time.perf_counter()
_STAT = Path("/proc/self/stat")


def seconds_since_start() -> float:
    """Return the seconds since the process was started, by Linux's clock; elsewhere since viatool was."""
    since_import = time.perf_counter() - _IMPORTED
    try:
        ticks = int(_STAT.read_text().rpartition(")")[2].split()[19])
        running = time.clock_gettime(time.CLOCK_BOOTTIME) - ticks / os.sysconf("SC_CLK_TCK")
    except (OSError, ValueError, IndexError, AttributeError):
        return since_import
    return max(running, since_import)
