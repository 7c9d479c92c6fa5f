"""What is printed while a command works and when it ends: the report on stdout, everything else on stderr."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from rich.console import Console

PIPE_WIDTH = 100
_SECONDS_BETWEEN_LINES = 10.0


class Progress(Protocol):
    """Told how far a stage has come."""

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Note that `done` of `total` units of `stage` are finished."""


def open_console(*, stderr: bool = False) -> Console:
    """Return a console that fits the terminal, or a fixed width in a pipe; NO_COLOR is honoured by rich."""
    from rich.console import Console

    console = Console(stderr=stderr, highlight=False, soft_wrap=False)
    if not console.is_terminal:
        console = Console(stderr=stderr, highlight=False, width=PIPE_WIDTH)
    return console


@contextmanager
def show_progress(*, quiet: bool = False) -> Iterator[Progress]:
    """Show a bar for each stage on a terminal, plain lines in a pipe, nothing if `quiet`.

    Yields
    ------
    Progress
        To be called with the stage, the units done and the units in all.
    """
    console = open_console(stderr=True)
    if quiet:
        yield _ignore
    elif console.is_terminal:
        with _bars(console) as progress:
            yield progress
    else:
        yield _Lines(console)


def _ignore(stage: str, done: int, total: int) -> None:
    """Show nothing."""


@contextmanager
def _bars(console: Console) -> Iterator[Progress]:
    from rich.progress import BarColumn, MofNCompleteColumn, TaskID, TextColumn, TimeElapsedColumn
    from rich.progress import Progress as Bars

    columns = (TextColumn("{task.description:>12}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    stages: dict[str, TaskID] = {}
    with Bars(*columns, console=console, transient=True) as bars:

        def update(stage: str, done: int, total: int) -> None:
            if stage not in stages:
                stages[stage] = bars.add_task(stage, total=total)
            bars.update(stages[stage], completed=done, total=total)

        yield update


class _Lines:
    """Plain lines: one when a stage ends, and now and then one while it runs."""

    def __init__(self, console: Console) -> None:
        self.console = console
        self.last = time.monotonic()

    def __call__(self, stage: str, done: int, total: int) -> None:
        now = time.monotonic()
        if done >= total or now - self.last >= _SECONDS_BETWEEN_LINES:
            self.last = now
            self.console.print(f"{stage}: {done:,} of {total:,}", markup=False)
