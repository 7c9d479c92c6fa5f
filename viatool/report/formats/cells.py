"""The cells of space with their status, as arrays for other programs."""

from __future__ import annotations

from collections.abc import Sequence

from viatool.report.archives import npz_of
from viatool.report.document import CellTabled
from viatool.report.sections import Check

SUFFIXES = (".npz",)
NEEDS = CellTabled
LIBRARIES = ()


def render(document: CellTabled, checks: Sequence[Check], suffix: str) -> bytes:
    """Return the table of cells: their bounds, their status, and the counterexamples."""
    return npz_of(document, document.cell_table())
