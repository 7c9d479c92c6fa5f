"""Telling how far a run is: a bar on a terminal, plain lines in a pipe, nothing in a library call."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from viatool.schedule import Progress


class Silence:
    """A progress that says nothing."""

    def advance(self, fraction: float, note: str = "") -> None:
        """Do nothing."""

    def say(self, line: str) -> None:
        """Do nothing."""


@contextmanager
def console_progress() -> Iterator[Progress]:
    """Show progress on stderr: a rich bar with the time left on a terminal, plain lines elsewhere."""
    from rich.console import Console

    console = Console(stderr=True, highlight=False)
    if console.is_terminal:
        with _bar(console) as progress:
            yield progress
    else:
        yield _Lines(console)


@contextmanager
def _bar(console: object) -> Iterator[Progress]:
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        TaskProgressColumn,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )
    from rich.progress import Progress as RichProgress

    assert isinstance(console, Console)
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TaskProgressColumn(),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    with RichProgress(*columns, console=console) as bar:
        task = bar.add_task("training", total=1.0)

        class Bar:
            def advance(self, fraction: float, note: str = "") -> None:
                bar.update(task, completed=fraction, description=note or "training")

            def say(self, line: str) -> None:
                bar.console.print(line, markup=False)

        yield Bar()


class _Lines:
    """Prints only what shall stay: a pipe or a log file has no bar."""

    def __init__(self, console: object) -> None:
        from rich.console import Console

        assert isinstance(console, Console)
        self._console = console

    def advance(self, fraction: float, note: str = "") -> None:
        """Do nothing: the lines of finished epochs tell how far the run is."""

    def say(self, line: str) -> None:
        """Print a line."""
        self._console.print(line, markup=False, soft_wrap=True)
