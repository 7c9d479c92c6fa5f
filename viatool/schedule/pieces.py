"""Pieces of work, and what every scheduler does with them."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass
from itertools import islice
from typing import Any, Generic, Protocol, TypeVar

from viatool.schedule.progress import Message, ignore

Content = TypeVar("Content")
Answer = TypeVar("Answer")


@dataclass(frozen=True, order=True)
class Span:
    """The consecutive units `first` to `last - 1` of all that is to be done."""

    first: int
    last: int

    def __len__(self) -> int:
        """Return the number of units."""
        return self.last - self.first


@dataclass(frozen=True, eq=False)
class Piece(Generic[Content]):
    """What a worker gets at once.

    Parameters
    ----------
    span : Span
        Which units it holds.
    name : str
        How messages call it, such as "states 0 to 1023".
    content : object
        What the work is called with; it has to be picklable.
    """

    span: Span
    name: str
    content: Content


Source = Iterable[Piece[Content] | None]
Told = Callable[[Piece[Any], Message], None]


class Scheduler(Protocol):
    """Where work is carried out."""

    @property
    def workers(self) -> int:
        """Return how many pieces can be worked on at the same time."""
        ...

    @property
    def remote(self) -> bool:
        """Tell whether workers may be on machines that do not see the files of this one."""
        ...

    def run(
        self, work: Callable[[Content], Answer], pieces: Source[Content], told: Told = ignore
    ) -> Iterator[tuple[Piece[Content], Answer]]:
        """Carry out work on pieces.

        Parameters
        ----------
        work : callable
            A picklable, pure function of a piece's content.
        pieces : iterable of Piece
            Drawn one by one as workers become free, so that they need not all exist at once. Where pieces depend on
            answers, None says that no piece is ready before another answer has been given out.
        told : callable
            Called with what pieces under way report, see `reporter`.

        Yields
        ------
        tuple of (Piece, answer)
            In the order in which they are finished. Leaving the loop early cancels what is under way.

        Raises
        ------
        ViatoolError
            The error of the work, with the name of its piece.
        WorkError
            If a piece ended otherwise: its worker died, it ran out of memory, or the work is broken.
        """
        ...


def draw(pieces: Iterator[Piece[Content] | None], most: int) -> Iterator[Piece[Content]]:
    """Draw at most so many pieces; fewer when no other one is ready."""
    for piece in islice(pieces, max(most, 0)):
        if piece is None:
            return
        yield piece


def cut(count: int, done: Collection[Span], most: int) -> list[Span]:
    """Cut what is not done of `count` units into spans of at most `most` units."""
    edges = sorted(done)
    gaps = zip([0, *(span.last for span in edges)], [*(span.first for span in edges), count], strict=True)
    return [Span(first, min(first + most, end)) for begin, end in gaps for first in range(begin, end, most)]
