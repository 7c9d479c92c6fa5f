"""The headline and the decided conditions as JSON: what a summary of many runs shows of each."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict

from viatool.report.document import Document
from viatool.report.sections import Check

SUFFIXES = (".json",)
NEEDS = Document
LIBRARIES = ()


def render(document: Document, checks: Sequence[Check], suffix: str) -> str:
    """Return what was found in a line, and the conditions with what decided them."""
    content = {
        "headline": str(document.headline),
        "figures": document.headline.figures,
        "conditions": [asdict(check) for check in checks],
    }
    return json.dumps(content, indent=2) + "\n"
