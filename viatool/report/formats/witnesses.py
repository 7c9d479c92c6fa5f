"""The counterexamples as a file that ``viatool replay`` runs again."""

from __future__ import annotations

import json
from collections.abc import Sequence

from viatool.report.document import Replayable
from viatool.report.sections import Check

SUFFIXES = (".json",)
NEEDS = Replayable
LIBRARIES = ()


def render(document: Replayable, checks: Sequence[Check], suffix: str) -> str:
    """Return the counterexamples as JSON."""
    return json.dumps(document.witness_file(), indent=1, allow_nan=False) + "\n"
