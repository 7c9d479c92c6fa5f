"""What is printed while a command works and when it ends: the report on stdout, everything else on stderr."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress as Bars
    from rich.progress import ProgressColumn, TaskID

    from viatool.schedule import Progress

PIPE_WIDTH = 100
_SECONDS_BETWEEN_LINES = 10.0
_SECONDS_TO_JUDGE_BY = 1.0
_SECONDS_WORTH_A_LINE = 20.0


def open_console(*, stderr: bool = False) -> Console:
    """Return a console that fits the terminal, or a fixed width in a pipe; NO_COLOR is honoured by rich."""
    from rich.console import Console

    console = Console(stderr=stderr, highlight=False, soft_wrap=False)
    if not console.is_terminal:
        console = Console(stderr=stderr, highlight=False, width=PIPE_WIDTH)
    return console


@contextmanager
def show_progress(*, quiet: bool = False, whole: str = "") -> Iterator[Progress]:
    """Show how far a command is: bars on a terminal, plain lines in a pipe, nothing if `quiet`.

    Parameters
    ----------
    quiet : bool
        Show nothing.
    whole : str
        What one bar for all stages is called at first, which stays with the time left; in a pipe there are then only
        the lines that the work gives. By default each stage has a bar or lines of its own.

    Yields
    ------
    Progress
        To be called with the stage, the units done and the units in all.
    """
    from viatool.schedule import ignore

    console = open_console(stderr=True)
    if quiet:
        yield ignore
    elif console.is_terminal:
        from rich.progress import Progress as Bars

        with Bars(*_columns(whole), console=console, transient=not whole) as bars:
            yield Display(console, whole, bars)
    else:
        yield Display(console, whole)


def _columns(whole: str) -> tuple[ProgressColumn, ...]:
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        TaskProgressColumn,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    spent, left = TimeElapsedColumn(), (TextColumn("left"), TimeRemainingColumn())
    if whole:
        return TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), spent, *left
    return TextColumn("{task.description:>12}"), BarColumn(), MofNCompleteColumn(), spent, *left


class Display:
    """Draws progress on a console.

    Parameters
    ----------
    console : Console
        For lines.
    whole : str
        As in `show_progress`.
    bars : Bars, optional
        Of rich, on a terminal.
    """

    def __init__(self, console: Console, whole: str = "", bars: Bars | None = None) -> None:
        self._console, self._whole, self._bars = console, whole, bars
        self._rows: dict[str, TaskID] = {}
        self._forecast = Forecast()
        if bars is not None and whole:
            self._rows[whole] = bars.add_task(whole, total=1.0)
        self._last = time.monotonic()

    def __call__(self, stage: str, done: float, total: float, line: str = "", /) -> None:
        """Show how far a stage is, and a line that stays."""
        if self._bars is not None:
            self._draw(self._bars, stage, done, total)
        elif not self._whole:
            self._print_now_and_then(stage, done, total)
        if not self._whole:
            line = self._forecast.of(stage, done, total, line) or line
        if line:
            self._console.print(line, markup=False, soft_wrap=not self._console.is_terminal)

    def _draw(self, bars: Bars, stage: str, done: float, total: float) -> None:
        if self._whole:
            bars.update(self._rows[self._whole], completed=done / total, description=stage)
            return
        if stage not in self._rows:
            self._rows[stage] = bars.add_task(stage, total=total)
        bars.update(self._rows[stage], completed=done, total=total)

    def _print_now_and_then(self, stage: str, done: float, total: float) -> None:
        """Print a line when a stage ends, and now and then one while it runs."""
        now = time.monotonic()
        if done >= total or now - self._last >= _SECONDS_BETWEEN_LINES:
            self._last = now
            self._console.print(f"{stage}: {done:,} of {total:,}", markup=False)


class Forecast:
    """Says of every stage once how long it will take, as soon as a part of it is done and it takes long."""

    def __init__(self) -> None:
        self._begun: dict[str, tuple[float, float]] = {}
        self._told: set[str] = set()

    def of(self, stage: str, done: float, total: float, line: str = "") -> str:
        """Note how far a stage is, and return a line that foretells the rest of it; nothing if it is told or short.

        A stage of which its own work tells something when it begins foretells itself.
        """
        from viatool.schedule.durations import duration

        now = time.monotonic()
        if stage not in self._begun:
            self._begun[stage] = now, done
            self._told |= {stage} if line else set()
            return ""
        begun, before = self._begun[stage]
        seconds, part = now - begun, done - before
        if stage in self._told or part <= 0 or seconds < _SECONDS_TO_JUDGE_BY:
            return ""
        self._told.add(stage)
        left = seconds * (total - done) / part
        if left < _SECONDS_WORTH_A_LINE:
            return ""
        judged = f"judging by the first {done:,.0f} in {duration(seconds)}"
        return f"{stage}: about {duration(left)} more for {total:,.0f}, {judged}"
