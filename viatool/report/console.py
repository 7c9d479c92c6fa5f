"""The console report: what a person reads when a run ends."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from rich import box
from rich.console import Console, Group, RenderableType
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from viatool.report.document import FileIdentity, HorizonDocument, RateByOutcome, ReportDocument
from viatool.report.foreign import shown
from viatool.report.gate import Check
from viatool.report.numbers import MISSING, count, percentage, seconds, significant
from viatool.report.palette import MEANING, STYLE, VERDICTS
from viatool.report.wording import (
    HORIZON_COLUMNS,
    assumptions,
    describe_eps,
    describe_horizon,
    describe_task,
    describe_verdicts,
    horizon_rows,
    rate_rows,
    total_seconds,
    unit_of,
)

BAR_WIDTH = 60
OUTCOMES = ("overall", "success", "collision", "timeout")


def print_report(document: ReportDocument, console: Console, checks: Sequence[Check] = ()) -> None:
    """Print a report.

    Parameters
    ----------
    document : ReportDocument
        What to show.
    console : rich.console.Console
        Where to; a pipe gets the same text without colours.
    checks : sequence of Check
        The decided conditions of a gate, shown last.
    """
    for part in _parts(document):
        console.print(part)
        console.print()
    if checks:
        print_checks(checks, console)


def print_checks(checks: Sequence[Check], console: Console) -> None:
    """Print the decided conditions of a gate."""
    table = Table.grid(padding=(0, 2))
    for check in checks:
        word = Text("passed", style=f"bold {STYLE['safe']}")
        if not check.passed:
            word = Text("FAILED", style=f"bold {STYLE['unsafe']}")
        table.add_row(word, Text(shown(check.condition)), Text(shown(check.figures), style="dim"))
    console.print(_titled("Gate", table if checks else Text("no condition was given")))


def _parts(document: ReportDocument) -> list[RenderableType]:
    return [
        _headline(document),
        _verdicts(document),
        _rates(document),
        *([] if document.horizon is None else [_horizon(document.horizon)]),
        _task(document),
        _widths(document),
        _time(document),
        _assumed(document),
    ]


def _headline(document: ReportDocument) -> RenderableType:
    overall = document.safety_rate.overall
    head = Text()
    head.append(shown(document.policy.path), style="bold")
    head.append(" on ")
    head.append(shown(document.map.path), style="bold")
    head.append(shown(f", eps {describe_eps(document.eps)}, criterion {document.criterion}") + "\n")
    head.append(percentage(overall.safe, overall.total), style=f"bold {STYLE['safe']}")
    head.append(f" of the states are proved safe ({count(overall.safe)} of {count(overall.total)})")
    return head


def _verdicts(document: ReportDocument) -> RenderableType:
    counts = {verdict: int(getattr(document.verdicts, verdict)) for verdict in VERDICTS}
    legend = Table.grid(padding=(0, 2))
    for verdict in VERDICTS:
        legend.add_row(
            Text(f"■ {verdict}", style=STYLE[verdict]),
            Text(count(counts[verdict]), justify="right"),
            Text(percentage(counts[verdict], document.states), justify="right"),
            Text(MEANING[verdict], style="dim"),
        )
    return Group(_bar(counts), legend)


def _bar(counts: Mapping[str, int]) -> Text:
    """Draw the shares as one bar; a verdict that occurs gets at least one cell."""
    total = sum(counts.values())
    cells = {name: max(BAR_WIDTH * number // total, 1) if number else 0 for name, number in counts.items()}
    largest = max(cells, key=lambda name: cells[name])
    cells[largest] += (BAR_WIDTH - sum(cells.values())) if total else 0
    bar = Text()
    for name, glyph in zip(VERDICTS, "█▓▒", strict=True):
        bar.append(glyph * cells[name], style=STYLE[name])
    return bar


def _rates(document: ReportDocument) -> RenderableType:
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1), show_edge=False)
    table.add_column("rate of safe states")
    for outcome in OUTCOMES:
        table.add_column("overall" if outcome == "overall" else f"in {outcome}", justify="right")
    for name, rates in rate_rows(document).items():
        table.add_row(Text(shown(name)), *(_rate(rates, outcome) for outcome in OUTCOMES))
    return table


def _rate(rates: RateByOutcome, outcome: str) -> Text:
    rate = getattr(rates, outcome)
    if rate.total == 0:
        return Text(MISSING, style="dim")
    text = Text(percentage(rate.safe, rate.total))
    text.append(f"\n{count(rate.safe)}/{count(rate.total)}", style="dim")
    return text


def _horizon(horizon: HorizonDocument) -> RenderableType:
    """Show the closed loop over several intervals."""
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1), show_edge=False)
    for name in HORIZON_COLUMNS:
        table.add_column(name, justify="right")
    for row in horizon_rows(horizon):
        table.add_row(*row)
    head = Text(f"{describe_verdicts(horizon)} over {describe_horizon(horizon)}; widths of the tubes:")
    return _titled("Horizon", Group(head, table))


def _task(document: ReportDocument) -> RenderableType:
    return _titled("Driven, not proved", Text(describe_task(document)))


def _widths(document: ReportDocument) -> RenderableType:
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1), show_edge=False)
    table.add_column("width of the reachable actions")
    for name in ("mean", "std", "max"):
        table.add_column(name, justify="right")
    table.add_column("unit")
    for action, width in document.reachable_width.items():
        figures = (significant(value) for value in (width.mean, width.std, width.max))
        table.add_row(Text(shown(action)), *figures, Text(shown(unit_of(document, action))))
    return table


def _time(document: ReportDocument) -> RenderableType:
    parts = [f"{stage} {seconds(value)}" for stage, value in document.seconds.items() if stage != "total"]
    return _titled("Time", Text(" · ".join([*parts, f"total {seconds(total_seconds(document))}"])))


def _assumed(document: ReportDocument) -> RenderableType:
    table = Table.grid(padding=(0, 2))
    for name, value in assumptions(document).items():
        table.add_row(Text(shown(name), style="dim"), Text(shown(value)))
    for name, identity in (("policy", document.policy), ("map", document.map)):
        table.add_row(Text(name, style="dim"), _identity(identity))
    return _titled("Assumed", table)


def _identity(identity: FileIdentity) -> Text:
    text = Text(shown(identity.path))
    text.append(f"  sha256 {identity.sha256[:16]}…", style="dim")
    return text


def _titled(title: str, body: Any) -> RenderableType:
    return Group(Text(title, style="bold"), Padding(body, (0, 0, 0, 2), expand=False))
