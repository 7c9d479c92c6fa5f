"""The document as a picture: png, svg or pdf."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from io import BytesIO

from viatool.report.document import Drawn
from viatool.report.sections import Check

SUFFIXES = (".png", ".svg", ".pdf")
NEEDS = Drawn
LIBRARIES = ("matplotlib",)
DPI = 160


def render(document: Drawn, checks: Sequence[Check], suffix: str) -> bytes:
    """Return the picture; the same document gives the same bytes."""
    from matplotlib import rc_context

    date = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}}.get(suffix, {})
    content = BytesIO()
    with rc_context({"svg.hashsalt": "viatool", **document.STYLE}), warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph .* missing")  # of a name in another script
        document.draw().savefig(content, format=suffix[1:], dpi=DPI, metadata=date)
    return content.getvalue()
