"""Durations in words, as exact as a forecast is."""

from __future__ import annotations


def duration(seconds: float) -> str:
    """Write a duration in the unit that fits: seconds, minutes, hours or days."""
    for most, unit, name in ((100.0, 1.0, "s"), (6000.0, 60.0, "min"), (172_800.0, 3600.0, "h")):
        if seconds < most:
            number = seconds / unit
            return f"{number:.1f} {name}" if name == "h" and number < 10 else f"{number:.0f} {name}"
    return f"{seconds / 86_400.0:.0f} days"
