"""A certificate as JSON, for other programs."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from viatool.places import Certificate
    from viatool.report.gate import Check

SUFFIXES = ()


def render(certificate: Certificate, checks: Sequence[Check], suffix: str) -> str:
    """Return the document of a certificate."""
    return json.dumps(certificate.to_json(), indent=2, allow_nan=False) + "\n"
