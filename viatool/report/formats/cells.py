"""The cells of space with their status, as arrays for other programs."""

from __future__ import annotations

from collections.abc import Sequence
from io import BytesIO

import numpy as np

from viatool.report.document import CellTabled
from viatool.report.sections import Check

SUFFIXES = (".npz",)
NEEDS = CellTabled
LIBRARIES = ()


def render(document: CellTabled, checks: Sequence[Check], suffix: str) -> bytes:
    """Return the table of cells: their bounds, their status, and the counterexamples."""
    buffer = BytesIO()
    np.savez_compressed(buffer, **document.cell_table())  # type: ignore[arg-type]  # names of arrays, no options
    return buffer.getvalue()
