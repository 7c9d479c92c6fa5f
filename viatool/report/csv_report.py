"""The states as a table for spreadsheets: one row each, with pose, verdict and the reachable commands."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from viatool.report.csv_table import inert, table

if TYPE_CHECKING:
    from viatool.report.gate import Check
    from viatool.verification.result import Result

SUFFIXES = (".csv",)
COLUMNS = ("state", "episode", "scenario", "outcome", "time", "x", "y", "theta", "verdict")


def render(result: Result, checks: Sequence[Check], suffix: str) -> Iterator[str]:
    """Yield one row for each state, below a row of names, some rows at a time."""
    bounds = [f"{action.name}_{end}" for end in ("lower", "upper") for action in result.actions]
    return table([*COLUMNS, *map(inert, bounds)], _rows(result))


def _rows(result: Result) -> Iterator[Sequence[object]]:
    trajectory, reachable = result.trajectory, result.reachable
    names = [trajectory.name_of(index) for index in range(trajectory.episodes)]
    for state, episode in enumerate(trajectory.episode.tolist()):
        ends = (*reachable.lower[state], *reachable.upper[state])
        yield [
            state,
            episode,
            inert(names[episode]),
            trajectory.outcomes[episode],
            *(f"{number:.9g}" for number in (trajectory.time[state], *trajectory.poses[state])),
            result.verdict[state],
            *(f"{number:.17g}" for number in ends),
        ]
