"""Work for the schedulers under test; workers import it from here."""

from __future__ import annotations

import os
import signal
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from viatool.errors import EnclosureError
from viatool.schedule import Piece, Span, check_time, reporter


def pieces(count: int, size: int = 10) -> list[Piece[list[int]]]:
    """Return pieces of consecutive numbers."""
    spans = [Span(first, first + size) for first in range(0, count, size)]
    return [Piece(s, f"numbers {s.first} to {s.last - 1}", list(range(s.first, s.last))) for s in spans]


def squares(count: int) -> list[int]:
    return [number * number for number in range(count)]


def in_order(results: Any) -> list[int]:
    """Return all answers of a run, in the order of the pieces."""
    answers = {piece.span: answer for piece, answer in results}
    return [number for span in sorted(answers) for number in answers[span]]


@dataclass(frozen=True)
class Square:
    """Squares numbers, with an accident at one of them.

    Parameters
    ----------
    at : int
        The number at which it happens.
    accident : str
        What happens: kill, refuse, crash, exhaust, or nothing.
    marker : str
        A file that exists once the accident has happened, after which it never happens again; each time if empty.
    seconds : float
        Time that a piece takes.
    """

    at: int = -1
    accident: str = ""
    marker: str = ""
    seconds: float = 0.0

    def __call__(self, numbers: list[int]) -> list[int]:
        time.sleep(self.seconds)
        if self.at in numbers and not (self.marker and Path(self.marker).exists()):
            if self.marker:
                Path(self.marker).touch()
            if self.accident == "kill":
                os.kill(os.getpid(), signal.SIGKILL)
            if self.accident == "refuse":
                raise EnclosureError("no bounds", "smaller eps")
            if self.accident == "crash":
                raise ZeroDivisionError("by zero")
            if self.accident == "exhaust":
                raise MemoryError
        return [number * number for number in numbers]


def where(numbers: list[int]) -> list[tuple[int, str | None]]:
    """Return the process that works, and the threads that its libraries may use."""
    return [(os.getpid(), os.environ.get("OMP_NUM_THREADS")) for _ in numbers]


def report(numbers: list[int]) -> list[int]:
    """Square numbers, and say so."""
    progress = reporter()
    for done, number in enumerate(numbers, start=1):
        progress(f"at {number}", done, len(numbers))
    progress("", 1, 1, f"squared {numbers}")
    return [number * number for number in numbers]


@dataclass(frozen=True)
class Endless:
    """Reports for a minute, and leaves a sign of life in a file."""

    sign: str

    def __call__(self, numbers: list[int]) -> list[int]:
        for step in range(1200):
            Path(self.sign).write_text(str(step))
            reporter()("", step, 1200)
            time.sleep(0.05)
        return numbers


def add_up(folder: Path, names: list[str]) -> int:
    """Add what files hold to a total that an earlier attempt may have begun, and remove one of them."""
    total = folder / "deep" / "total"
    total.parent.mkdir(exist_ok=True)
    before = int(total.read_text()) if total.exists() else 0
    total.write_text(str(before + sum(int((folder / name).read_text()) for name in names)))
    (folder / names[0]).unlink()
    return int(total.read_text())


class Chain:
    """Pieces of which each is the answer to the one before."""

    def __init__(self, length: int) -> None:
        self.length = length
        self.answers = [2]

    def __iter__(self) -> Any:
        for link in range(self.length):
            while len(self.answers) <= link:
                yield None
            yield Piece(Span(link, link + 1), f"link {link}", [self.answers[link]])


@dataclass(frozen=True)
class QuickAtFirst:
    """Takes a minute for every piece but the one that begins with 0."""

    def __call__(self, numbers: list[int]) -> list[int]:
        time.sleep(60.0 if numbers[0] else 0.0)
        return numbers


@dataclass(frozen=True)
class SinceBegun:
    """A clock that starts when a file appears, so that the start of processes takes no time."""

    file: Path

    def __call__(self) -> float:
        return time.time() - self.file.stat().st_mtime if self.file.exists() else 0.0


@dataclass(frozen=True)
class Sleep:
    """Takes so many seconds for each number, looks at the time before each, and starts a clock."""

    seconds: float
    clock: SinceBegun

    def __call__(self, numbers: list[int]) -> list[int]:
        if not self.clock.file.exists():
            self.clock.file.touch()
        for _ in numbers:
            check_time()
            time.sleep(self.seconds)
        return numbers
