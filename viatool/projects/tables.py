"""The cells of a project as a table of policies against maps, for people."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table as Grid
from rich.text import Text

from viatool.projects.matrix import ProjectCell
from viatool.projects.records import CellRecord, ProjectSummary
from viatool.report.foreign import shown
from viatool.report.palette import STYLE

TONES: Mapping[int | None, str] = {0: "safe", 1: "unsafe", 2: "unsafe", 3: "unsafe", 5: "unknown", None: ""}


def tone_of(record: CellRecord) -> str:
    """Return the verdict whose colour an outcome has."""
    tone = TONES.get(record.code, "unsafe")
    return "unknown" if tone == "safe" and record.outcome != "passed" else tone


def grid_of(records: Sequence[CellRecord]) -> tuple[list[str], dict[str, dict[str, list[CellRecord]]]]:
    """Return the maps, and for each policy the cells on each of them, in the order of the project."""
    maps = list(dict.fromkeys(record.map for record in records))
    rows: dict[str, dict[str, list[CellRecord]]] = {}
    for record in records:
        row = rows.setdefault(record.policy, {name: [] for name in maps})
        row[record.map].append(record)
    return maps, rows


def label_of(record: CellRecord) -> str:
    """Return what tells a cell from others of the same policy and map."""
    axes = record.name.split("/")[3:]
    return " ".join([record.check, *axes])


def print_cells(cells: Sequence[ProjectCell], console: Console) -> None:
    """Print the names of cells."""
    for cell in cells:
        console.print(Text(shown(cell.name)), soft_wrap=True)


def print_summary(summary: ProjectSummary, page: Path, console: Console) -> None:
    """Print a table of policies against maps, what is wrong where, and where the page is."""
    maps, rows = grid_of(summary.cells)
    grid = Grid(show_edge=False, pad_edge=False)
    grid.add_column("policy")
    for name in maps:
        grid.add_column(Text(shown(name)))
    for policy, row in rows.items():
        grid.add_row(Text(shown(policy)), *(Text("\n").join(map(_entry, row[name])) for name in maps))
    console.print(grid)
    console.print()
    for text in _causes(summary.counted):
        console.print(Text(shown(text)), soft_wrap=True)
    counts = Counter(record.outcome for record in summary.counted)
    told = ", ".join(f"{number} {outcome}" for outcome, number in counts.items())
    console.print(f"{told}; exit code {summary.exit_code}", soft_wrap=True)
    console.print(Text(f"page: {shown(str(page))}"), soft_wrap=True)


def _entry(record: CellRecord) -> Text:
    text = Text(f"{label_of(record)}: ")
    text.append(record.outcome, style=STYLE.get(tone_of(record), "dim"))
    told = "%" in record.headline and record.code in (0, 1)  # else it is not what the outcome is about
    figure = record.headline.split("%")[0] + "%" if told else ""
    text.append(f" {figure}" if figure else "")
    accepted = sum(one.passed for one in record.accepted)
    text.append(f", {accepted} accepted" if accepted else "")
    text.append(" (kept)" if record.reused else "")
    return text


_NAMED = 3
"""Cells of one cause that are named."""


def _causes(records: Sequence[CellRecord]) -> Iterator[str]:
    """Yield what is wrong, a line each; one cause of several cells once."""
    cells: dict[tuple[str, ...], list[str]] = {}
    for record in records:
        if told := tuple(_complaints(record)):
            cells.setdefault(told, []).append(record.name)
    for told, names in cells.items():
        first = (
            f"{', '.join(names[:_NAMED])}{f' and {len(names) - _NAMED} more' if len(names) > _NAMED else ''}"
        )
        yield from (f"{first}: {line}" for line in told)


def _complaints(record: CellRecord) -> list[str]:
    """Return what is wrong with a cell, a line each."""
    failed = [f"{one.condition}: {one.figures}" for one in record.conditions if not one.passed]
    if failed or not record.code:
        return failed
    return [line for line in record.message.splitlines() if line.startswith(("error:", "hint:"))]
