"""The tubes of missions as arrays for other programs."""

from __future__ import annotations

from collections.abc import Sequence

from viatool.report.archives import npz_of
from viatool.report.document import TubeTabled
from viatool.report.sections import Check

SUFFIXES = (".npz",)
NEEDS = TubeTabled
LIBRARIES = ()


def render(document: TubeTabled, checks: Sequence[Check], suffix: str) -> bytes:
    """Return the parts of all tubes: scenario, interval, and ends of x, y, theta and the command."""
    return npz_of(document, document.tube_table())
