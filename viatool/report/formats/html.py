"""The document as a page: one file that opens offline, to explore."""

from __future__ import annotations

from collections.abc import Sequence

from viatool.report.document import Explorable
from viatool.report.sections import Check

SUFFIXES = (".html", ".htm")
NEEDS = Explorable
LIBRARIES = ("bokeh", "jinja2")


def render(document: Explorable, checks: Sequence[Check], suffix: str) -> str:
    """Return the page."""
    return document.page(checks)
