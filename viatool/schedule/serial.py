"""Work in this process, one piece after the other."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

from threadpoolctl import threadpool_limits

from viatool.errors import ViatoolError
from viatool.schedule.parcel import checked, failure, numeric_threads
from viatool.schedule.pieces import Answer, Content, Piece, Source, Told, draw
from viatool.schedule.progress import ignore, telling


class Serial:
    """The scheduler without workers."""

    workers = 1
    remote = False

    def run(
        self, work: Callable[[Content], Answer], pieces: Source[Content], told: Told = ignore
    ) -> Iterator[tuple[Piece[Content], Answer]]:
        """Carry out work on pieces, as `Scheduler.run` says, in their order."""
        rest = iter(pieces)
        while (piece := next(draw(rest, 1), None)) is not None:
            try:
                with threadpool_limits(limits=numeric_threads()), telling(partial(told, piece)):
                    answer: Answer | ViatoolError = work(piece.content)
            except ViatoolError as error:
                answer = error
            except Exception as error:
                raise failure(piece, error) from error
            yield piece, checked(piece, answer)
