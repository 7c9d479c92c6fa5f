"""What a piece under way tells whoever waits for it: how far it is, and lines for people."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import NamedTuple, Protocol

_SECONDS_BETWEEN = 0.5
_MOST_LETTERS = 400
"""Of a stage and of a line: a short message is written to a pipe at once, so that a kill leaves no half of one."""


class Progress(Protocol):
    """What long work of every kind reports to, in whatever process it is done: a function."""

    def __call__(self, stage: str, done: float, total: float, line: str = "", /) -> None:
        """Note that `done` of `total` units of `stage` are done; a `line`, if there is one, stays in sight."""


class Message(NamedTuple):
    """What a piece under way tells, as `Progress` is called."""

    stage: str
    done: float
    total: float
    line: str = ""

    @property
    def fraction(self) -> float:
        """Return the part that is done, in [0, 1]."""
        return self.done / self.total if self.total else 1.0


Tell = Callable[[Message], None]


def ignore(*_: object) -> None:
    """Tell nobody."""


_tell: ContextVar[Tell] = ContextVar("tell", default=ignore)


class Reporter:
    """A progress that tells the waiting process: every line, and how far the piece is only now and then.

    Notes
    -----
    On a cluster a message may be answered by `Abandoned`: nobody waits for the piece any more.
    """

    def __init__(self, tell: Tell) -> None:
        self._tell, self._last = tell, float("-inf")

    def __call__(self, stage: str, done: float, total: float, line: str = "", /) -> None:
        """Tell how far the piece is, unless that was told a moment ago and there is no line."""
        now = time.monotonic()
        if line or now - self._last >= _SECONDS_BETWEEN:
            self._last = now
            self._tell(Message(stage[:_MOST_LETTERS], done, total, line[:_MOST_LETTERS]))


class Abandoned(Exception):  # noqa: N818  # an event, not an error
    """Nobody waits for a piece any more."""


def reporter() -> Reporter:
    """Return what the piece at work reports to; outside of a piece, nobody listens."""
    return Reporter(_tell.get())


@contextmanager
def telling(tell: Tell) -> Iterator[None]:
    """Let `tell` receive what the work within the block reports."""
    token = _tell.set(tell)
    try:
        yield
    finally:
        _tell.reset(token)
