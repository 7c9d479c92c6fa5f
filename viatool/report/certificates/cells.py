"""All cells that hold a free pose with their status, as npz."""

from __future__ import annotations

from collections.abc import Sequence
from io import BytesIO
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from viatool.places import Certificate
    from viatool.report.gate import Check

SUFFIXES = (".npz",)


def render(certificate: Certificate, checks: Sequence[Check], suffix: str) -> bytes:
    """Return the table of cells: bounds of x, y, theta, v and omega, and the counterexamples."""
    buffer = BytesIO()
    np.savez_compressed(buffer, **certificate.cell_table())  # type: ignore[arg-type]  # names of arrays, no options
    return buffer.getvalue()
