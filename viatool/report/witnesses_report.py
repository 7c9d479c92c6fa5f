"""The counterexamples as a file that ``viatool replay`` runs again."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from viatool.report.gate import Check
    from viatool.verification.result import Result

SUFFIXES = (".json",)


def render(result: Result, checks: Sequence[Check], suffix: str) -> str:
    """Return the counterexamples of a result as JSON."""
    from viatool.verification.witness_file import witness_document

    return json.dumps(witness_document(result), indent=1, allow_nan=False) + "\n"
