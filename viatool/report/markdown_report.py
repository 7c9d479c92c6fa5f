"""The report as Markdown, for pull requests and job summaries."""

from __future__ import annotations

import html
from collections.abc import Sequence
from typing import TYPE_CHECKING

from viatool.report.document import RateByOutcome, ReportDocument, read_result
from viatool.report.foreign import shown
from viatool.report.gate import Check
from viatool.report.numbers import count, percentage, seconds, significant
from viatool.report.palette import MEANING, VERDICTS
from viatool.report.wording import (
    HORIZON_COLUMNS,
    assumptions,
    describe_eps,
    describe_horizon,
    describe_verdicts,
    horizon_rows,
    rate_rows,
    total_seconds,
    unit_of,
)

if TYPE_CHECKING:
    from viatool.verification.result import Result

SUFFIXES = ()
_SPECIAL = str.maketrans({character: f"\\{character}" for character in "\\`*_{}[]()#+!|~@"})


def render(result: Result, checks: Sequence[Check], suffix: str) -> str:
    """Return the report of a result."""
    return markdown(read_result(result), checks)


def markdown(document: ReportDocument, checks: Sequence[Check] = ()) -> str:
    """Return a report as Markdown."""
    overall = document.safety_rate.overall
    lines = [
        f"## viatool: {percentage(overall.safe, overall.total)} of the states are proved safe",
        "",
        f"{escape(document.policy.path)} on {escape(document.map.path)}, "
        f"eps {escape(describe_eps(document.eps))}, criterion {escape(document.criterion)}, "
        f"{escape(document.arithmetic)}, {seconds(total_seconds(document))}",
        "",
    ]
    if checks:
        rows = [
            ("passed" if c.passed else "**FAILED**", escape(c.condition), escape(c.figures)) for c in checks
        ]
        lines += _table(("gate", "condition", "found"), rows)
    lines += _table(
        ("verdict", "states", "share", "meaning"),
        [
            (verdict, count(number), percentage(number, document.states), MEANING[verdict])
            for verdict in VERDICTS
            for number in [int(getattr(document.verdicts, verdict))]
        ],
    )
    lines += _rates(document)
    if document.horizon is not None:
        told = f"{describe_verdicts(document.horizon)} over {describe_horizon(document.horizon)}"
        lines += [f"Horizon: {escape(told)}.", ""]
        lines += _table(HORIZON_COLUMNS, horizon_rows(document.horizon))
    lines += _table(
        ("reachable action", "mean width", "std", "max", "unit"),
        [
            (escape(name), *map(significant, (w.mean, w.std, w.max)), escape(unit_of(document, name)))
            for name, w in document.reachable_width.items()
        ],
    )
    lines += ["<details><summary>Assumed</summary>", ""]
    facts = [(escape(name), escape(value)) for name, value in assumptions(document).items()]
    facts += [("policy sha256", document.policy.sha256), ("map sha256", document.map.sha256)]
    lines += [*_table(("", ""), facts), "</details>", ""]
    return "\n".join(lines)


def _rates(document: ReportDocument) -> list[str]:
    outcomes = ("overall", "success", "collision", "timeout")

    def cells(rates: RateByOutcome) -> list[str]:
        chosen = [getattr(rates, outcome) for outcome in outcomes]
        return [f"{percentage(r.safe, r.total)} ({count(r.safe)}/{count(r.total)})" for r in chosen]

    rows = [(escape(title), *cells(rates)) for title, rates in rate_rows(document).items()]
    return _table(("rate of safe states", *outcomes), rows)


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    lines = [f"| {' | '.join(cells)} |" for cells in (head, ["---"] * len(head), *rows)]
    return [*lines, ""]


def escape(text: str) -> str:
    """Make a foreign string inert: one line, no markup, no HTML, no mention, no command in a log."""
    return html.escape(shown(text).translate(_SPECIAL), quote=False)
