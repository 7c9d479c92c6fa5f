"""The state table: one row for each state, as arrays for other programs."""

from __future__ import annotations

from collections.abc import Sequence
from io import BytesIO
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from viatool.report.gate import Check
    from viatool.safety import Result

SUFFIXES = (".npz",)


def render(result: Result, checks: Sequence[Check], suffix: str) -> bytes:
    """Return the state table of a result as an npz archive."""
    content = BytesIO()
    np.savez_compressed(content, allow_pickle=False, **result.state_table())
    return content.getvalue()
