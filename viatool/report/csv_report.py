"""The states as a table for spreadsheets: one row each, with pose, verdict and the reachable commands."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from io import StringIO
from typing import TYPE_CHECKING

from viatool.report.foreign import shown

if TYPE_CHECKING:
    from viatool.report.gate import Check
    from viatool.safety import Result

SUFFIXES = (".csv",)
COLUMNS = ("state", "episode", "scenario", "outcome", "time", "x", "y", "theta", "verdict")
_CHARACTERS = 1_000_000
_FORMULA_STARTS = ("=", "+", "-", "@")


def render(result: Result, checks: Sequence[Check], suffix: str) -> Iterator[str]:
    """Yield one row for each state, below a row of names, some rows at a time."""
    trajectory, reachable = result.trajectory, result.reachable
    bounds = [f"{action.name}_{end}" for end in ("lower", "upper") for action in result.actions]
    names = [trajectory.name_of(index) for index in range(trajectory.episodes)]
    stream = StringIO(newline="")
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow([*COLUMNS, *map(inert, bounds)])
    for state, episode in enumerate(trajectory.episode.tolist()):
        ends = (*reachable.lower[state], *reachable.upper[state])
        writer.writerow(
            [
                state,
                episode,
                inert(names[episode]),
                trajectory.outcomes[episode],
                *(f"{number:.9g}" for number in (trajectory.time[state], *trajectory.poses[state])),
                result.verdict[state],
                *(f"{number:.17g}" for number in ends),
            ]
        )
        if stream.tell() > _CHARACTERS:
            yield stream.getvalue()
            stream.seek(0)
            stream.truncate()
    yield stream.getvalue()


def inert(text: str) -> str:
    """Keep a name on its line, and keep a spreadsheet from reading it as a formula."""
    text = shown(text)
    return f"'{text}" if text.lstrip().startswith(_FORMULA_STARTS) else text
