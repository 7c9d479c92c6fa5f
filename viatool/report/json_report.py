"""The report as JSON, for other programs."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from viatool.report.gate import Check
    from viatool.verification.result import Result

SUFFIXES = ()


def render(result: Result, checks: Sequence[Check], suffix: str) -> str:
    """Return the report document of a result."""
    return json.dumps(result.to_json(), indent=2, allow_nan=False) + "\n"
