"""The driven states as a trajectory file (npz, csv), for ``viatool verify --trajectory``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from viatool.report.document import Recorded
from viatool.report.sections import Check

SUFFIXES = (".npz", ".csv")
NEEDS = Recorded
LIBRARIES = ()


def render(document: Recorded, checks: Sequence[Check], suffix: str) -> bytes:
    """Return the file's content."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"trajectory{suffix}"
        document.write_trajectory(path)
        return path.read_bytes()
