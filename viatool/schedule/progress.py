"""What a piece under way tells whoever waits for it: how far it is, and lines for people."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import NamedTuple, Protocol

_SECONDS_BETWEEN = 0.5
_MOST_LETTERS = 500  # a short message is written to a pipe at once, so that a kill leaves no half of one


class Progress(Protocol):
    """What long work reports to."""

    def advance(self, fraction: float, note: str = "") -> None:
        """Tell the fraction of the work that is done, in [0, 1], and what is going on."""

    def say(self, line: str) -> None:
        """Tell something that shall stay on the screen."""


class Staged(Protocol):
    """Told how far a stage has come."""

    def __call__(self, stage: str, done: int, total: int, /) -> None:
        """Note that `done` of `total` units of `stage` are finished."""


class Message(NamedTuple):
    """The fraction of a piece that is done, what is going on, and a line that shall stay, if there is one."""

    fraction: float
    note: str = ""
    line: str = ""


Tell = Callable[[Message], None]


def ignore(*_: object) -> None:
    """Tell nobody."""


_tell: ContextVar[Tell] = ContextVar("tell", default=ignore)


class Reporter:
    """A progress that tells the waiting process, of the fraction only now and then.

    Notes
    -----
    On a cluster a message may be answered by `Abandoned`: nobody waits for the piece any more.
    """

    def __init__(self, tell: Tell) -> None:
        self._tell = tell
        self._fraction, self._last = 0.0, float("-inf")

    def advance(self, fraction: float, note: str = "") -> None:
        """Tell how far the piece is, unless that was told a moment ago."""
        self._fraction = fraction
        now = time.monotonic()
        if now - self._last >= _SECONDS_BETWEEN:
            self._last = now
            self._tell(Message(fraction, note[:_MOST_LETTERS]))

    def say(self, line: str) -> None:
        """Tell a line."""
        self._tell(Message(self._fraction, "", line[:_MOST_LETTERS]))


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
