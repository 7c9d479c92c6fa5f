"""The page of a project: policies against maps, with a link to the report of each cell. It needs no extra."""

from __future__ import annotations

import shlex
from collections.abc import Iterable
from html import escape

from viatool.projects.records import OUTCOMES, CellRecord, ProjectSummary
from viatool.projects.tables import grid_of, label_of, tone_of
from viatool.report.html.plain import inert, plain_page, scrolling

_LINKED = (
    "html",
    "evidence",
    "markdown",
    "figure",
    "junit",
    "sarif",
    "csv",
    "states",
    "cells",
    "tube",
    "witnesses",
    "mcap",
    "json",
)
_OWN = """
main { padding-top: 14px; }
a { color: var(--accent); }
.scroll td { white-space: normal; min-width: 13em; }
.plain td:first-child { white-space: nowrap; overflow-wrap: normal; }
td a { text-decoration: none; color: inherit; }
td a:hover, td a:focus { text-decoration: underline; }
.cell { display: block; padding: 2px 0 2px 10px; border-left: 6px solid var(--swatch, var(--rule)); margin: 2px 0; }
.cell b { font-variant-numeric: tabular-nums; }
code { overflow-wrap: anywhere; }
pre { white-space: pre-wrap; overflow-wrap: anywhere; }
"""


def page_of(summary: ProjectSummary) -> str:
    """Return the page."""
    verdict = "passed" if summary.exit_code == 0 else "failed"
    told = OUTCOMES.get(summary.exit_code, OUTCOMES[3])
    main = f"""<section>
  <h1>{inert(summary.project)}: <span class="{verdict}">{inert(told)}</span></h1>
  <p class="sub">{len(summary.counted)} of {len(summary.cells)} cells were asked for; exit code {summary.exit_code}</p>
  <h2>Policies against maps</h2>
  {_grid(summary)}
</section>
{_accepted(summary)}
<section>
  <h2>Cells</h2>
  {"".join(map(_cell, summary.cells))}
</section>"""
    return plain_page(f"{summary.project}: {told}", main, f"Made by viatool {summary.viatool}.", _OWN)


def _grid(summary: ProjectSummary) -> str:
    maps, rows = grid_of(summary.cells)
    head = "".join(f'<th scope="col">{inert(name)}</th>' for name in maps)
    body = "".join(
        f'<tr><th scope="row">{inert(policy)}</th>'
        + "".join(f"<td>{''.join(map(_entry, row[name])) or '-'}</td>" for name in maps)
        + "</tr>"
        for policy, row in rows.items()
    )
    table = f'<table><thead><tr><th scope="col">policy</th>{head}</tr></thead><tbody>{body}</tbody></table>'
    return scrolling("Policies against maps", table)


def _entry(record: CellRecord) -> str:
    accepted = sum(one.passed for one in record.accepted)
    notes = [*([f"{accepted} accepted"] if accepted else []), *(["kept"] if record.reused else [])]
    notes += [] if record.run or record.code is None else ["from an earlier run"]
    text = f"{inert(label_of(record))}: <b>{inert(record.outcome)}</b>"
    small = "; ".join([*map(inert, filter(None, (record.stake, record.headline))), *notes])
    small = f"<small>{small}</small>" if small else ""
    return f'<a class="cell {tone_of(record)}" href="#{inert(_anchor(record))}">{text}{small}</a>'


def _accepted(summary: ProjectSummary) -> str:
    rows = [(record, one) for record in summary.cells for one in record.accepted]
    if not rows:
        return ""
    body = "".join(
        f'<tr><td class="{"passed" if one.passed else "failed"}">{"in force" if one.passed else "NOT in force"}</td>'
        f"<td>{inert(record.name)}</td><td>{inert(one.condition)}</td><td>{inert(one.figures)}</td></tr>"
        for record, one in rows
    )
    return (
        "<section><h2>Accepted findings</h2><p>They change no verdict and no rate; the gate does not count them.</p>"
        f"{scrolling('Accepted findings', f'<table><tbody>{body}</tbody></table>')}</section>"
    )


def _cell(record: CellRecord) -> str:
    links = " · ".join(
        f'<a href="{inert(record.reports[name])}">{name}</a>' for name in _LINKED if name in record.reports
    )
    conditions = "".join(
        f'<tr><td class="{"passed" if one.passed else "failed"}">{"passed" if one.passed else "FAILED"}</td>'
        f'<td>{inert(one.condition)}</td><td class="quiet">{inert(one.figures)}</td></tr>'
        for one in record.conditions
    )
    parts: Iterable[str] = (
        f'<h3 id="{inert(_anchor(record))}">{inert(record.name)}: {inert(record.outcome)}</h3>',
        f"<p>{inert(record.stake)}</p>" if record.stake else "",
        f'<table class="plain"><tbody>{conditions}</tbody></table>' if conditions else "",
        f"<p>{inert(record.headline)} {f'({inert(record.figures)})' if record.figures else ''}</p>",
        f"<pre>{escape(record.message)}</pre>" if record.message and not conditions else "",
        f"<p>{links}</p>" if links else "",
        f'<p class="quiet"><code>{inert(shlex.join(record.command))}</code></p>',
    )
    return "".join(parts)


def _anchor(record: CellRecord) -> str:
    return record.name.replace("/", "--")
