"""Two reports of one kind side by side."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from viatool.errors import ConfigurationError
from viatool.report.document import Document
from viatool.report.foreign import shown
from viatool.report.numbers import MISSING, count, seconds, significant
from viatool.report.paired import PairedGroups, PairedSubjects, interval_of
from viatool.report.palette import STYLE
from viatool.report.sections import NOTHING, Share

Row = tuple[str, str, str, Text]
"""What is compared, both figures, and what changes, in a colour if one is better."""
TITLES = ("before", "after", "change")


@dataclass(frozen=True)
class Difference:
    """A setting or a premise by name, and how two reports have it."""

    name: str
    before: str
    after: str


def require_same_kind(before: Document, after: Document) -> None:
    """Refuse to compare reports on different kinds of run.

    Raises
    ------
    ConfigurationError
        Names both kinds.
    """
    if before.SIGN != after.SIGN:
        old, new = (d.WHAT if d.path is None else f"{d.WHAT} ('{d.path}')" for d in (before, after))
        raise ConfigurationError(
            f"{old} cannot be compared with {new}",
            f"give a report that viatool {after.COMMAND} wrote with --output json:PATH",
        )


def differences(before: Document, after: Document) -> list[Difference]:
    """Return what two reports were asked for and rest on differently; what only one of them tells is left out.

    Premises are compared if both reports tell theirs; one that only one of them has is a difference then.
    """
    old, new = before.settings, after.settings
    found = [Difference(name, old.get(name, new[name]), new[name]) for name in new]
    premises = [{p.name: p.value for p in document.record.premises} for document in (before, after)]
    if all(premises):
        names = [name for name in dict.fromkeys([*premises[1], *premises[0]]) if name not in new]
        found += [Difference(name, *(told.get(name, MISSING) for told in premises)) for name in names]
    return [difference for difference in found if difference.before != difference.after]


def compared(before: Document, after: Document) -> list[list[Row]]:
    """Return what two reports assumed and found, in sections of rows.

    Raises
    ------
    ConfigurationError
        If they are of different kinds.
    """
    require_same_kind(before, after)
    sections = (_settings, _tallies, _rates, _chance, _costs)
    return [list(section(before, after)) for section in sections]


def print_comparison(before: Document, after: Document, console: Console) -> None:
    """Print what two reports assumed and found; changes for the better are in the colour of safe.

    Raises
    ------
    ConfigurationError
        If they are of different kinds.
    """
    table = Table(box=box.SIMPLE_HEAD, show_edge=False)
    table.add_column("")
    for title in TITLES:
        table.add_column(title, justify="right")
    for section in compared(before, after):
        for name, old, new, change in section:
            table.add_row(Text(shown(name)), Text(shown(old)), Text(shown(new)), change)
        table.add_section()
    console.print(table)


def _settings(before: Document, after: Document) -> Iterator[Row]:
    """Yield what was asked, and what else differs."""
    yield _setting("policy", before.record.policy.sha256[:12], after.record.policy.sha256[:12])
    asked = ("map", *after.terms)
    old, new = before.settings, after.settings
    for name in asked:
        yield _setting(name, old.get(name, MISSING), new[name])
    for difference in differences(before, after):
        if difference.name not in asked:
            yield _setting(difference.name, difference.before, difference.after)
    yield _setting(after.SUBJECTS, count(before.size), count(after.size))


def _setting(name: str, old: str, new: str) -> Row:
    return name, old, new, Text("same" if old == new else "differs", style="dim" if old == new else "bold")


def _tallies(before: Document, after: Document) -> Iterator[Row]:
    for old, new in zip(before.tallies, after.tallies, strict=True):
        more = new.number - old.number
        text = f"{more:+,}" if isinstance(more, int) else f"{'+' if more > 0 else ''}{significant(more)}"
        yield new.name, old.text, new.text, _change(text, more, new.better)


def _rates(before: Document, after: Document) -> Iterator[Row]:
    for name, title in after.RATES.items():
        if name in before.rates or name in after.rates:
            old, new = before.rates.get(name, NOTHING), after.rates.get(name, NOTHING)
            yield title, old.percentage(), new.percentage(), _rate_change(old, new)


def _chance(before: Document, after: Document) -> Iterator[Row]:
    """Yield how the subjects of both runs do side by side, and by how much rates differ beyond chance."""
    same = before.content.get("seed") == after.content.get("seed") and before.record.map == after.record.map
    paired = PairedSubjects.of(before.outcomes if same else {}, after.outcomes)
    grouped = after.groups and PairedGroups.of(before.outcomes, after.outcomes, after.groups)
    if paired.total:
        better = f"better here, of the {count(paired.total)} {after.SUBJECTS} of both"
        likely = Text(f"by chance: {significant((grouped or paired).chance)}", style="dim")
        yield better, count(paired.before), count(paired.after), likely
    if paired.total and paired.holding:
        ends = (grouped or paired).interval
        if ends is not None:
            yield _interval(after.RATES["overall"], ends)
        return
    for name, title in after.RATES.items():
        old, new = before.rates.get(name, NOTHING), after.rates.get(name, NOTHING)
        if after.INDEPENDENT and old.total and new.total:
            yield _interval(title, interval_of(old, new))


def _interval(title: str, ends: tuple[float, float]) -> Row:
    low, high = (f"{100.0 * end:+.1f}" for end in ends)
    certain = ends[0] > 0.0 or ends[1] < 0.0
    style = STYLE["safe" if ends[0] > 0.0 else "unsafe"] if certain else "dim"
    return f"{title}, 95 %", "", "", Text(f"{low} to {high} points", style=style)


def _rate_change(old: Share, new: Share) -> Text:
    if old.total == 0 or new.total == 0:
        return Text(MISSING, style="dim")
    points = 100 * (Fraction(new.part, new.total) - Fraction(old.part, old.total))
    return _change(f"{float(points):+.2f} points", points, 1)


def _change(text: str, more: float | Fraction, better: int) -> Text:
    if more == 0:
        return Text("same", style="dim")
    return Text(text, style=STYLE["safe" if better * more > 0 else "unsafe"] if better else "")


def _costs(before: Document, after: Document) -> Iterator[Row]:
    for name in (name for name in before.costs if name in after.costs):
        old, new = before.costs[name], after.costs[name]
        ratio = Text(f"x {significant(new / old)}" if old else MISSING, style="dim")
        yield name, significant(old), significant(new), ratio
    yield "time", seconds(before.record.total_seconds), seconds(after.record.total_seconds), Text("")
