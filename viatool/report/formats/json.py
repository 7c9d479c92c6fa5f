"""The document as JSON, for other programs."""

from __future__ import annotations

import json
from collections.abc import Sequence

from viatool.report.document import Document
from viatool.report.sections import Check

SUFFIXES = ()
NEEDS = Document
LIBRARIES = ()


def render(document: Document, checks: Sequence[Check], suffix: str) -> str:
    """Return the report JSON."""
    return json.dumps(document.content, indent=2, allow_nan=False) + "\n"
