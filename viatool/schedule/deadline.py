"""Until when work may go on: one moment, made once, that travels with the work and is looked at within it."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Any

Seconds = Callable[[], float]


class TimeUp(Exception):  # noqa: N818  # an event, not an error
    """The work at hand has to end unfinished."""


@dataclass(frozen=True)
class Deadline:
    """A moment after which nothing is begun.

    Parameters
    ----------
    moment : float
        By the clock, in seconds.
    budget : float
        The seconds that there were when it was made.
    clock : callable
        What tells the time.

    Notes
    -----
    Within a machine it goes by a clock that nobody sets. On its way to another process it becomes a time of day, so
    that workers on machines whose clocks differ end early or late by as much.
    """

    moment: float = math.inf
    budget: float = math.inf
    clock: Seconds = time.monotonic

    @classmethod
    def after(cls, seconds: float | None, clock: Seconds = time.monotonic) -> Deadline:
        """Return the moment so many seconds from now; never for None."""
        return NEVER if seconds is None else cls(clock() + seconds, seconds, clock)

    @property
    def left(self) -> float:
        """Return the seconds that are left; negative when it has passed."""
        return self.moment - self.clock()

    @property
    def passed(self) -> bool:
        """Tell whether nothing is to be begun any more."""
        return self.left <= 0.0

    def moved(self, share: float) -> Deadline:
        """Return the moment a share of the budget later, or earlier if it is negative."""
        if math.isinf(self.budget):
            return self
        return Deadline(self.moment + share * self.budget, self.budget, self.clock)

    def __reduce__(self) -> tuple[Any, ...]:
        """Travel as a time of day."""
        moment = time.time() + self.left if self.clock is time.monotonic else self.moment
        return _arrived, (moment, self.budget, None if self.clock is time.monotonic else self.clock)


NEVER = Deadline()
"""The deadline of work that may go on for as long as it takes."""


def _arrived(moment: float, budget: float, clock: Seconds | None) -> Deadline:
    if clock is not None:
        return Deadline(moment, budget, clock)
    return Deadline(moment - time.time() + time.monotonic(), budget)


_within: ContextVar[Deadline] = ContextVar("within", default=NEVER)


def time_is_up() -> bool:
    """Tell whether the deadline of the innermost `within` has passed, for work that can do with less."""
    return _within.get().passed


def check_time() -> None:
    """End the work at hand if its time is up; called between steps that take up to some tenths of a second.

    Raises
    ------
    TimeUp
        After the deadline of the innermost `within`.
    """
    if time_is_up():
        raise TimeUp


@contextmanager
def within(deadline: Deadline) -> Iterator[None]:
    """Let `check_time` look at a deadline in the work of the block."""
    token = _within.set(deadline)
    try:
        yield
    finally:
        _within.reset(token)
