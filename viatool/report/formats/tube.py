"""The tubes of missions as arrays for other programs."""

from __future__ import annotations

from collections.abc import Sequence
from io import BytesIO

import numpy as np

from viatool.report.document import TubeTabled
from viatool.report.sections import Check

SUFFIXES = (".npz",)
NEEDS = TubeTabled
LIBRARIES = ()


def render(document: TubeTabled, checks: Sequence[Check], suffix: str) -> bytes:
    """Return the parts of all tubes: scenario, interval, and ends of x, y, theta and the command."""
    buffer = BytesIO()
    np.savez_compressed(buffer, **document.tube_table())  # type: ignore[arg-type]  # names of arrays, no options
    return buffer.getvalue()
