"""Work in several processes of this machine, through loky (the pool inside joblib)."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Collection, Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Future, wait
from contextlib import contextmanager
from functools import partial
from typing import Any

from viatool.errors import ConfigurationError, WorkError
from viatool.schedule.parcel import Parcel, carry_out, checked, failure
from viatool.schedule.pieces import Answer, Content, Piece, Source, Span, Told, draw
from viatool.schedule.progress import Message, ignore

_TRIES = 2
"""How often a piece may be under way when a process dies before it is tried by itself."""
_THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")
_PATIENCE = 0.5  # seconds between looks at the keyboard, for Windows does not interrupt a wait


def available_cores() -> int:
    """Return how many cores this process may use, by affinity and by the limits of a container."""
    from loky import cpu_count

    return int(cpu_count())


class Processes:
    """The scheduler with worker processes.

    Parameters
    ----------
    workers : int
        How many.

    Notes
    -----
    When a process dies, by a lack of memory or by a kill, every piece that was under way is tried again; what is
    under way when that happens twice is tried by itself. What dies of a lack of memory among others may then succeed
    alone, and a piece that always kills is known by name.
    """

    remote = False

    def __init__(self, workers: int) -> None:
        if workers < 1:
            raise ConfigurationError(f"{workers} workers cannot do any work", "give 1 or more, or 'auto'")
        self.workers = workers

    def run(
        self, work: Callable[[Content], Answer], pieces: Source[Content], told: Told = ignore
    ) -> Iterator[tuple[Piece[Content], Answer]]:
        """Carry out work on pieces, as `Scheduler.run` says."""
        parcel, line = Parcel.of(work), _Line(pieces)
        losses: Counter[Span] = Counter()
        while True:
            lost: list[Piece[Content]] = []
            yield from _until_death(parcel, line, self.workers, lost, told)
            if not lost:
                return
            losses.update(piece.span for piece in lost)
            line.again.extend(piece for piece in lost if losses[piece.span] < _TRIES)
            for piece in lost:
                if losses[piece.span] >= _TRIES:
                    yield from _alone(parcel, piece, told)


class _Line(Iterator[Piece[Content] | None]):
    """Pieces in the order of their turn: those that were lost first."""

    def __init__(self, pieces: Source[Content]) -> None:
        self.again: deque[Piece[Content]] = deque()
        self.rest = iter(pieces)

    def __next__(self) -> Piece[Content] | None:
        return self.again.popleft() if self.again else next(self.rest)


def _alone(parcel: Parcel, piece: Piece[Content], told: Told) -> Iterator[tuple[Piece[Content], Any]]:
    """Try a piece by itself."""
    lost: list[Piece[Content]] = []
    yield from _until_death(parcel, iter([piece]), 1, lost, told)
    if lost:
        raise WorkError(
            f"{piece.name}: the worker process died {_TRIES + 1} times over it, the last time with nothing else "
            "at work; most likely the system ended it because memory ran out",
            "use a machine with more memory, or check the system's log",
        )


def _until_death(
    parcel: Parcel,
    pieces: Iterator[Piece[Content] | None],
    workers: int,
    lost: list[Piece[Content]],
    told: Told,
) -> Iterator[tuple[Piece[Content], Any]]:
    """Carry out work until there is none, or until a process dies; then `lost` gets what was under way."""
    waiting: dict[Future[Any], Piece[Content]] = {}
    label = parcel.label()
    with _pool(parcel, workers) as (pool, mailbox):
        while True:
            for piece in draw(pieces, 2 * workers - len(waiting)):
                waiting[_submit(pool, label, piece)] = piece
            if not waiting:
                return
            done, _ = wait(waiting, timeout=_PATIENCE, return_when=FIRST_COMPLETED)
            _deliver(mailbox, waiting.values(), told)
            for future in done:
                error, piece = future.exception(), waiting.pop(future)
                if isinstance(error, BrokenExecutor):
                    lost.append(piece)
                elif error is not None:
                    raise failure(piece, error) from error
                else:
                    yield piece, checked(piece, future.result())
            if lost:
                lost.extend(waiting.values())
                lost.sort(key=lambda piece: piece.span)
                return


def _submit(pool: Any, label: Parcel, piece: Piece[Any]) -> Future[Any]:
    try:
        future: Future[Any] = pool.submit(carry_out, label, piece.content, partial(_post, piece.span))
    except BrokenExecutor as error:
        future = Future()
        future.set_exception(error)
    return future


def _deliver(mailbox: Any, pieces: Collection[Piece[Any]], told: Told) -> None:
    """Pass on what pieces under way have posted."""
    addressed = {piece.span: piece for piece in pieces}
    while not mailbox.empty():
        span, message = mailbox.get()
        if span in addressed:
            told(addressed[span], message)


@contextmanager
def _pool(parcel: Parcel, workers: int) -> Iterator[tuple[Any, Any]]:
    """Open a pool whose processes have the work, and their mailbox; they end with the block, at once if left early."""
    from loky import ProcessPoolExecutor
    from loky.backend import get_context

    mailbox = get_context("loky").SimpleQueue()
    pool = ProcessPoolExecutor(
        max_workers=workers,
        initializer=_begin,
        initargs=(os.getpid(), parcel, mailbox),
        env=dict.fromkeys(_THREAD_VARIABLES, str(parcel.threads)),
    )
    try:
        yield pool, mailbox
    except BaseException:
        pool.shutdown(wait=False, kill_workers=True)
        raise
    else:
        pool.shutdown(wait=True)
    finally:
        mailbox.close()


_mailbox: Any = None  # of a worker process


def _begin(parent: int, parcel: Parcel, mailbox: Any) -> None:
    """Leave Ctrl-C to the main process, do not outlive it, and get ready for the work."""
    global _mailbox
    _mailbox = mailbox
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(os, "getppid"):
        threading.Thread(target=_watch, args=(parent,), daemon=True).start()
    parcel.open()


def _post(span: Span, message: Message) -> None:
    _mailbox.put((span, message))


def _watch(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(1.0)
    os._exit(1)
