"""Work in this process, one piece after the other."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

from threadpoolctl import threadpool_limits

from viatool.errors import ViatoolError
from viatool.schedule.parcel import checked, failure, numeric_threads
from viatool.schedule.pieces import Answer, Content, Piece


class Serial:
    """The scheduler without workers."""

    workers = 1

    def run(
        self, work: Callable[[Content], Answer], pieces: Iterable[Piece[Content]]
    ) -> Iterator[tuple[Piece[Content], Answer]]:
        """Carry out work on pieces, as `Scheduler.run` says, in their order."""
        for piece in pieces:
            try:
                with threadpool_limits(limits=numeric_threads()):
                    answer: Answer | ViatoolError = work(piece.content)
            except ViatoolError as error:
                answer = error
            except Exception as error:
                raise failure(piece, error) from error
            yield piece, checked(piece, answer)
