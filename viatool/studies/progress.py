"""How far a study is: a bar for each running task on a terminal, plain lines in a pipe, the time left in both."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from viatool.errors import ViatoolError
from viatool.schedule import Message

if TYPE_CHECKING:
    from rich.console import Console

    from viatool.studies.tasks import Record, Task

_SECONDS_BETWEEN_LINES = 30.0


class Board:
    """Counts the work that is done, and estimates from its pace how long the rest will take.

    Silent by itself; subclasses show it.
    """

    def __init__(self) -> None:
        self._running: dict[str, float] = {}
        self._work: dict[str, float] = {}
        self._left = self._gone = 0.0
        self._number = self._total = 0
        self._started = time.monotonic()

    def begin(self, waiting: Sequence[Task], total: int) -> None:
        """Note what is to be done, of how many tasks in all."""
        self._work = {task.name: task.work for task in waiting}
        self._left, self._gone = sum(self._work.values()), 0.0
        self._number, self._total = total - len(waiting), total
        self._started = time.monotonic()
        self._show(f"{self._number} of {total} tasks are finished already" if self._number else "")

    def put(self, task: str, message: Message) -> None:
        """Note how far a running task is."""
        self._running[task] = message.fraction
        self._moved(task, message)

    def end(self, task: str, outcome: Record | ViatoolError) -> None:
        """Note that a task is done, or has failed."""
        self._running.pop(task, None)
        work = self._work.get(task, 0.0)
        self._left, self._gone = self._left - work, self._gone + work
        self._number += 1
        told = f"failed: {outcome.message}" if isinstance(outcome, ViatoolError) else f"{outcome.seconds:g} s"
        self._show(f"[{self._number}/{self._total}] {task}: {told}{self.time_left()}")
        self._ended(task)

    def fraction(self) -> float:
        """Return the part of this attempt's work that is done."""
        return self._done() / max(self._left + self._gone, 1e-9)

    def time_left(self) -> str:
        """Return the time left in words, empty while nothing is known."""
        done = self._done()
        rest = self._left + self._gone - done
        if done <= 0.0 or rest <= 1e-9:
            return ""
        seconds = rest * (time.monotonic() - self._started) / done
        return f", about {_duration(seconds)} left"

    def _done(self) -> float:
        return self._gone + sum(self._work.get(name, 0.0) * part for name, part in self._running.items())

    def _show(self, line: str) -> None:
        """Show a line that stays."""

    def _moved(self, task: str, message: Message) -> None:
        """Show how far a running task is."""

    def _ended(self, task: str) -> None:
        """Show a task no more."""


def _duration(seconds: float) -> str:
    minutes = round(seconds / 60)
    if minutes == 0:
        return f"{seconds:.0f} s"
    return f"{minutes} min" if minutes < 60 else f"{minutes // 60} h {minutes % 60:02d} min"


class Lines(Board):
    """Plain lines: one for each finished task, and now and then one for a running task."""

    def __init__(self, console: Console) -> None:
        super().__init__()
        self._console, self._last = console, time.monotonic()

    def _show(self, line: str) -> None:
        if line:
            self._console.print(line, markup=False, soft_wrap=True)

    def _moved(self, task: str, message: Message) -> None:
        now = time.monotonic()
        if now - self._last >= _SECONDS_BETWEEN_LINES:
            self._last = now
            self._show(f"{task}: {message.fraction:.0%} {message.stage}{self.time_left()}")


class Bars(Board):
    """A bar for all the work and one for each running task."""

    def __init__(self, bars: Any) -> None:
        super().__init__()
        self._bars = bars
        self._all = bars.add_task("", total=1.0)
        self._rows: dict[str, Any] = {}

    def _show(self, line: str) -> None:
        if line:
            self._bars.console.print(line, markup=False)

    def _moved(self, task: str, message: Message) -> None:
        if task not in self._rows:
            self._rows[task] = self._bars.add_task("", total=1.0)
        text = f"{task} {message.stage}"
        self._bars.update(self._rows[task], completed=message.fraction, description=text)
        overall = f"{self._number} of {self._total} tasks{self.time_left()}"
        self._bars.update(self._all, completed=self.fraction(), description=overall)

    def _ended(self, task: str) -> None:
        if task in self._rows:
            self._bars.remove_task(self._rows.pop(task))


@contextmanager
def open_board(console: Console, *, quiet: bool = False) -> Iterator[Board]:
    """Give the board that fits the console."""
    if quiet:
        yield Board()
    elif console.is_terminal:
        from rich.progress import BarColumn, TaskProgressColumn, TextColumn
        from rich.progress import Progress as RichProgress

        columns = (BarColumn(), TaskProgressColumn(), TextColumn("{task.description}", markup=False))
        with RichProgress(*columns, console=console) as bars:
            yield Bars(bars)
    else:
        yield Lines(console)
