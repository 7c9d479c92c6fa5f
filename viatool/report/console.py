"""A document on the console: what a person reads when a run ends."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from rich import box
from rich.console import Console, Group, RenderableType
from rich.padding import Padding
from rich.table import Table as Grid
from rich.text import Text

from viatool.report.foreign import shown
from viatool.report.numbers import MISSING
from viatool.report.palette import STYLE
from viatool.report.sections import Breakdown, Check, Facts, Part, Rates, Section, Share, Table
from viatool.report.wording import describe_seconds

if TYPE_CHECKING:
    from viatool.report.document import Document, Explained
    from viatool.report.records import FileIdentity

BAR_WIDTH = 60
MOST_EVIDENCE = 5  # sentences of a condition that failed
_NAME_WIDTH = 45  # of what may stand in the first column of a table without a break
_WORD_WIDTH = 24  # of a word of a later column of texts
_GLYPHS = {"safe": "█", "unknown": "▓", "unsafe": "▒", "": "░"}


def print_report(document: Document, console: Console, checks: Sequence[Check] = ()) -> None:
    """Print a document.

    Parameters
    ----------
    document : Document
        What to show.
    console : rich.console.Console
        Where to; a pipe gets the same text without colours.
    checks : sequence of Check
        The decided conditions of a gate, shown last.
    """
    console.print(
        _headline(document), soft_wrap=not console.is_terminal
    )  # each line whole, for grep and head -1
    console.print()
    parts = [
        *map(_section, document.sections),
        _titled("Time", Text(describe_seconds(document, " · "))),
        *_premises(document),
        _assumed(document),
    ]
    for part in parts:
        console.print(part)
        console.print()
    if checks:
        print_checks(checks, console)


def print_checks(checks: Sequence[Check], console: Console) -> None:
    """Print the decided conditions of a gate."""
    table = Grid.grid(padding=(0, 2))
    for check in checks:
        word = Text("passed", style=f"bold {STYLE['safe']}")
        if not check.passed:
            word = Text(check.word, style=f"bold {STYLE['unsafe']}")
        table.add_row(word, Text(shown(check.condition)), Text(shown(check.figures), style="dim"))
    told = [Text(shown(line), style="dim") for check in checks for line in check.some_evidence(MOST_EVIDENCE)]
    if any(len(check.failing) > MOST_EVIDENCE for check in checks):
        told.append(Text("Every one of them is in --output html, csv, junit or sarif.", style="dim"))
    console.print(_titled("Gate", Group(table, *told) if checks else Text("no condition was given")))


def print_explanation(text: str, console: Console) -> None:
    """Print in paragraphs why something is not safe."""
    console.print(Text("\n".join(shown(line) for line in text.split("\n"))))


def print_failing(document: Explained, console: Console) -> None:
    """Print all that is not safe, each with its reason in short."""
    table = document.failing
    console.print(_table(table) if table.rows else Text("Nothing to explain: all is safe."))


def _headline(document: Document) -> RenderableType:
    found, record = document.headline, document.record
    head = Text()
    if found.stake:
        head.append(f"{shown(found.stake)}\n", style="bold")
    head.append(shown(record.policy.path), style="bold")
    head.append(" on ")
    head.append(shown(record.map.path), style="bold")
    head.append("".join(f", {shown(phrase)}" for phrase in document.subject) + "\n")
    if found.rate:
        head.append(found.rate, style=f"bold {STYLE['safe']}")
        head.append(" ")
    head.append(shown(found.rest))
    head.append(f" ({found.figures})" if found.figures else "")
    return head


def _section(section: Section) -> RenderableType:
    match section:
        case Breakdown():
            return _breakdown(section)
        case Rates():
            return _rates(section)
        case Table():
            return _table(section)
        case Facts():
            return _facts(section)


def _breakdown(section: Breakdown) -> RenderableType:
    legend = Grid.grid(padding=(0, 2))
    for part in section.parts:
        legend.add_row(
            Text(f"■ {shown(part.name)}", style=STYLE.get(part.tone, "")),
            *(Text(shown(figure), justify="right") for figure in part.figures),
            Text(shown(part.meaning), style="dim"),
        )
    return Group(_bar(section.parts), legend)


def _bar(parts: Sequence[Part]) -> Text:
    """Draw the shares as one bar; a part that occurs gets at least one cell."""
    total = sum(part.weight for part in parts)
    cells = [max(int(BAR_WIDTH * part.weight // total), 1) if part.weight else 0 for part in parts]
    cells[cells.index(max(cells))] += (BAR_WIDTH - sum(cells)) if total else 0
    bar = Text()
    for part, number in zip(parts, cells, strict=True):
        bar.append(_GLYPHS[part.tone] * number, style=STYLE.get(part.tone, ""))
    return bar


def _rates(section: Rates) -> RenderableType:
    table = _grid()
    table.add_column(section.title)
    for index, group in enumerate(section.groups):
        table.add_column(f"in {group}" if index else group, justify="right")
    for name, shares in section.rows.items():
        table.add_row(Text(shown(name)), *map(_share, shares))
    return table


def _share(share: Share) -> Text:
    if share.total == 0:
        return Text(MISSING, style="dim")
    text = Text(share.percentage())
    text.append(f"\n{share.of('/')}", style="dim")
    return text


def _table(section: Table) -> RenderableType:
    table = _grid()
    for index, name in enumerate(section.head):
        is_text = index == 0 or index >= len(section.head) - section.texts
        # Names in the first column are looked up: they are shown whole, others make room.
        words = (word for row in section.rows for word in shown(row[index]).split()) if is_text else ()
        least = min(max(map(len, words), default=0), _NAME_WIDTH if index == 0 else _WORD_WIDTH) or None
        table.add_column(
            Text(shown(name)), justify="left" if is_text else "right", min_width=least, overflow="fold"
        )
    for row in section.rows:
        table.add_row(*(Text(shown(text)) for text in row))
    body = Group(Text(f"{shown(section.remark)}:"), table) if section.remark else table
    return _titled(section.title, body) if section.title else body


def _facts(section: Facts) -> RenderableType:
    table = Grid.grid(padding=(0, 2))
    nameless = not any(name for name, _ in section.pairs)
    for name, value in section.pairs:
        table.add_row(*([] if nameless else [Text(shown(name), style="dim")]), Text(shown(value)))
    return _titled(section.title, table)


def _premises(document: Document) -> list[RenderableType]:
    if not document.record.premises:
        return []
    table = Grid.grid(padding=(0, 2))
    for premise in document.record.premises:
        table.add_row(
            Text(shown(premise.name), style="dim"),
            Text(shown(premise.value)),
            Text(shown(premise.source), style="dim"),
        )
    return [_titled("In effect", table)]


def _assumed(document: Document) -> RenderableType:
    table = Grid.grid(padding=(0, 2))
    for name, value in document.assumptions.items():
        table.add_row(Text(shown(name), style="dim"), Text(shown(value)))
    for name, identity in (("policy", document.record.policy), ("map", document.record.map)):
        table.add_row(Text(name, style="dim"), _identity(identity))
    return _titled("Assumed", table)


def _identity(identity: FileIdentity) -> Text:
    text = Text(shown(identity.path))
    text.append(f"  sha256 {identity.sha256[:16]}…", style="dim")
    return text


def _grid() -> Grid:
    return Grid(box=box.SIMPLE_HEAD, padding=(0, 1), show_edge=False)


def _titled(title: str, body: Any) -> RenderableType:
    return Group(Text(title, style="bold"), Padding(body, (0, 0, 0, 2), expand=False))
