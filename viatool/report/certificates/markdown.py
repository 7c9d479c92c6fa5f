"""A certificate as Markdown, for pull requests and job summaries."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from viatool.report.certificates.console import headline, rows_of_rates, rows_of_volumes, rows_of_worst
from viatool.report.certificates.document import read_certificate
from viatool.report.markdown_report import escape

if TYPE_CHECKING:
    from viatool.places import Certificate
    from viatool.report.gate import Check

SUFFIXES = ()


def render(certificate: Certificate, checks: Sequence[Check], suffix: str) -> str:
    """Return a certificate as Markdown."""
    document = read_certificate(certificate)
    lines = [f"## viatool: {escape(headline(document))}", ""]
    if checks:
        verdicts = [
            ("passed" if c.passed else "**FAILED**", escape(c.condition), escape(c.figures)) for c in checks
        ]
        lines += _table(("gate", "condition", "found"), verdicts)
    lines += _table(("status", "cells", "volume, m² rad"), rows_of_volumes(document))
    lines += _table(("share", "of", ""), rows_of_rates(document))
    lines += _table(("worst place", "previous command", "command", "clearance"), rows_of_worst(document))
    return "\n".join(lines) + "\n"


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    cells = [head, ["---"] * len(head), *rows]
    return [*("| " + " | ".join(row) + " |" for row in cells), ""] if rows else []
