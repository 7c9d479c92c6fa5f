"""Two reports side by side."""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from viatool.report.document import Rate, ReportDocument
from viatool.report.foreign import shown
from viatool.report.gate import RATES, rate_named
from viatool.report.numbers import MISSING, count, percentage, seconds, significant
from viatool.report.palette import STYLE, VERDICTS
from viatool.report.wording import settings, total_seconds

Row = tuple[str, str, str, Text]
ALWAYS = ("map", "eps", "criterion", "arithmetic")  # settings that are shown also where they agree


def print_comparison(before: ReportDocument, after: ReportDocument, console: Console) -> None:
    """Print what two reports assumed and found; changes for the better are in the colour of safe."""
    table = Table(box=box.SIMPLE_HEAD, show_edge=False)
    table.add_column("")
    table.add_column("before", justify="right")
    table.add_column("after", justify="right")
    table.add_column("change", justify="right")
    for section in (
        _settings(before, after),
        _verdicts(before, after),
        _rates(before, after),
        _costs(before, after),
    ):
        for name, old, new, change in section:
            table.add_row(Text(shown(name)), Text(shown(old)), Text(shown(new)), change)
        table.add_section()
    console.print(table)


def _settings(before: ReportDocument, after: ReportDocument) -> Iterator[Row]:
    old, new = settings(before), settings(after)
    yield _setting("policy", before.policy.sha256[:12], after.policy.sha256[:12])
    for name in new:
        if name in ALWAYS or old.get(name, new[name]) != new[name]:
            yield _setting(name, old[name], new[name])
    yield _setting("states", count(before.states), count(after.states))


def _setting(name: str, old: str, new: str) -> Row:
    return name, old, new, Text("same" if old == new else "differs", style="dim" if old == new else "bold")


def _verdicts(before: ReportDocument, after: ReportDocument) -> Iterator[Row]:
    for verdict in VERDICTS:
        old, new = getattr(before.verdicts, verdict), getattr(after.verdicts, verdict)
        sign = 1 if verdict == "safe" else -1
        yield verdict, count(old), count(new), _change(f"{new - old:+,}", sign * (new - old))


def _rates(before: ReportDocument, after: ReportDocument) -> Iterator[Row]:
    for name, title in RATES.items():
        old, new = rate_named(before, name), rate_named(after, name)
        if name == "horizon" and old.total == new.total == 0:  # neither of them has one
            continue
        yield title, _rate(old), _rate(new), _rate_change(old, new)


def _rate(rate: Rate) -> str:
    return percentage(rate.safe, rate.total)


def _rate_change(old: Rate, new: Rate) -> Text:
    if old.total == 0 or new.total == 0:
        return Text(MISSING, style="dim")
    points = 100 * (Fraction(new.safe, new.total) - Fraction(old.safe, old.total))
    return _change(f"{float(points):+.2f} points", points)


def _change(text: str, better: int | Fraction) -> Text:
    if better == 0:
        return Text("same", style="dim")
    return Text(text, style=STYLE["safe" if better > 0 else "unsafe"])


def _costs(before: ReportDocument, after: ReportDocument) -> Iterator[Row]:
    for action in (name for name in before.reachable_width if name in after.reachable_width):
        old, new = before.reachable_width[action].mean, after.reachable_width[action].mean
        ratio = Text(f"x {significant(new / old)}" if old else MISSING, style="dim")
        yield f"mean width of {action}", significant(old), significant(new), ratio
    yield "time", seconds(total_seconds(before)), seconds(total_seconds(after)), Text("")
