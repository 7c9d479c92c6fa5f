"""The report as a page: one file that opens offline, with a map to explore and every state behind its verdict."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from viatool.report.html.page import render_page

if TYPE_CHECKING:
    from viatool.report.gate import Check
    from viatool.verification.result import Result

SUFFIXES = (".html", ".htm")


def render(result: Result, checks: Sequence[Check], suffix: str) -> str:
    """Return the page of a result."""
    return render_page(result, checks)
