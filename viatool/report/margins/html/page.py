"""The page of margins: what its template speaks of, filled in one place."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Sequence
from typing import TYPE_CHECKING

from viatool.report.foreign import one_line
from viatool.report.formats.figure import render as picture_of
from viatool.report.html.shell import assemble
from viatool.report.margins.tables import quantiles_table, weakest_table
from viatool.report.sections import Check

if TYPE_CHECKING:
    from viatool.report.margins.document import MarginsDocument

SCRIPTS = ("figures.js", "theme.js", "margins.js")
_SHOWN = 500
"""Weakest states of each policy."""


def render_page(document: MarginsDocument, checks: Sequence[Check]) -> str:
    """Return the page of margins."""
    record = document.record
    picture = picture_of(document, (), ".svg")
    assert isinstance(picture, bytes)
    return assemble(
        document,
        __package__,
        "margins.html",
        SCRIPTS,
        title="viatool margins",
        data={},
        figures=(),
        checks=checks,
        stake=document.headline.stake,
        headline=document.headline.rest,
        policies=", ".join(map(one_line, document.names)),
        map=one_line(record.map.path),
        subject=", ".join(document.asked),
        quantiles=quantiles_table(record.varied, document.parts),
        parts=[
            weakest_table(record.varied, part, name, _SHOWN)
            for name, part in document.parts.items()
            if part.tested
        ],
        picture=b64encode(picture).decode(),
    )
