"""A format as CONTRIBUTING describes it: this module, and its line in the registry."""

from __future__ import annotations

from collections.abc import Sequence

from viatool.report.document import Document
from viatool.report.sections import Check

SUFFIXES = (".toy",)
NEEDS = Document
LIBRARIES = ()


def render(document: Document, checks: Sequence[Check], suffix: str) -> str:
    """Return one line."""
    return f"{document.headline}, {len(document.sections)} sections, {len(checks)} conditions\n"
