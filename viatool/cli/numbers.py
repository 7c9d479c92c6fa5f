"""Numbers as they are written on a command line."""

from __future__ import annotations

import math


def finite(text: str) -> float | None:
    """Read a finite number; None if the text is not one."""
    try:
        number = float(text)
    except ValueError:
        return None
    return number if math.isfinite(number) else None
