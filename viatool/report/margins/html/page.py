"""The page of margins: what its template speaks of, filled in one place."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from viatool.report.foreign import one_line
from viatool.report.html.shell import assemble
from viatool.report.margins.document import state_key
from viatool.report.margins.html.curve import curve_view
from viatool.report.margins.html.rows import weakest_view
from viatool.report.margins.tables import quantiles_table
from viatool.report.sections import Check, Key

if TYPE_CHECKING:
    from viatool.report.margins.document import MarginsDocument
    from viatool.report.margins.record import ContestedStateRecord, PolicyMarginsRecord

SCRIPTS = ("figures.js", "theme.js", "keys.js", "margins.js")
_SHOWN = 500
"""Weakest states of each policy."""


def render_page(document: MarginsDocument, checks: Sequence[Check]) -> str:
    """Return the page of margins."""
    record = document.record
    return assemble(
        document,
        __package__,
        "margins.html",
        SCRIPTS,
        title="viatool margins",
        data={},
        figures=(),
        checks=checks,
        address=lambda key: _address(document.names, key),
        stake=document.headline.stake,
        headline=document.headline.rest,
        policies=", ".join(map(one_line, document.names)),
        map=one_line(record.map.path),
        subject=", ".join(document.asked),
        quantiles=quantiles_table(record.varied, document.parts),
        parts=[_part(document, name, part, checks) for name, part in document.parts.items() if part.tested],
        curve=curve_view(record.varied, document.parts),
    )


def _part(
    document: MarginsDocument, name: str, part: PolicyMarginsRecord, checks: Sequence[Check]
) -> dict[str, Any]:
    """Return the weakest states of a policy, and which conditions count each."""
    failed = [{finding.key for finding in check.failing} for check in checks if not check.passed]

    def key(state: ContestedStateRecord) -> Key:
        return state_key(name, state.state, close=state.close)

    view = weakest_view(
        document.record.varied,
        part,
        _SHOWN,
        lambda state: _address(document.names, key(state)),
        lambda state: [place for place, keys in enumerate(failed) if key(state) in keys],
    )
    return {"title": f"Weakest states of {name}", "view": view}


def _address(names: Sequence[str], key: Key) -> str:
    """Return where the page shows a state: by its number, and that of its policy behind the first one."""
    table, number = key
    policy, _, kind = table.rpartition("/")
    place = list(names).index(policy)
    return f"#{'close' if kind == 'close' else 'state'}={number}" + (f",{place}" if place else "")
