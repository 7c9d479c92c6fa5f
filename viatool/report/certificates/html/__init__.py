"""A certificate as a page: one file that opens offline, with what is proved of each place and heading, and why not."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from viatool.report.certificates.html.page import render_page

if TYPE_CHECKING:
    from viatool.places import Certificate
    from viatool.report.gate import Check

SUFFIXES = (".html", ".htm")


def render(certificate: Certificate, checks: Sequence[Check], suffix: str) -> str:
    """Return the page of a certificate."""
    return render_page(certificate, checks)
