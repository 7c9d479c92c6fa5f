"""The headline and the decided conditions as JSON: what a summary of many runs shows of each."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import fields

from viatool.report.document import Document
from viatool.report.sections import Check

SUFFIXES = (".json",)
NEEDS = Document
LIBRARIES = ()
_NOT_TOLD = ("failing", "may_be_empty")


def render(document: Document, checks: Sequence[Check], suffix: str) -> str:
    """Return what was found in a line, and the conditions with what decided them."""
    content = {
        "stake": document.headline.stake,
        "headline": str(document.headline),
        "figures": document.headline.figures,
        "conditions": [_condition(check) for check in checks],
    }
    return json.dumps(content, indent=2) + "\n"


def _condition(check: Check) -> dict[str, object]:
    told = {field.name: getattr(check, field.name) for field in fields(check) if field.name not in _NOT_TOLD}
    return {**told, "evidence": list(check.evidence)}
