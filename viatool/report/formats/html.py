"""The document as a page: one file that opens offline, to explore where more is at hand than the JSON holds."""

from __future__ import annotations

from collections.abc import Sequence

from viatool.report.document import Document, Explorable
from viatool.report.sections import Check

SUFFIXES = (".html", ".htm")
NEEDS = Document
LIBRARIES = ("bokeh", "jinja2")


def render(document: Document, checks: Sequence[Check], suffix: str) -> str:
    """Return the page; of what cannot be explored, one of words and figures."""
    if isinstance(document, Explorable):
        return document.page(checks)
    from viatool.report.told_page import told_page

    return told_page(document, checks, document.PLAIN)
