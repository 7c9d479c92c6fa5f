"""Work in several processes of this machine, through loky (the pool inside joblib)."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Future, wait
from contextlib import contextmanager
from itertools import islice
from typing import Any

from viatool.errors import ConfigurationError, WorkError
from viatool.schedule.parcel import Parcel, carry_out, checked, failure
from viatool.schedule.pieces import Answer, Content, Piece

_TRIES = 2
"""How often a piece may kill the process that works on nothing else before it is given up."""
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
    When a process dies, by a lack of memory or by a kill, every piece that was under way is tried again by itself.
    What dies of a lack of memory among others may so succeed alone, and a piece that always kills is known by name.
    """

    def __init__(self, workers: int) -> None:
        if workers < 1:
            raise ConfigurationError(f"{workers} workers cannot work", "give 1 or more, or 'auto'")
        self.workers = workers

    def run(
        self, work: Callable[[Content], Answer], pieces: Iterable[Piece[Content]]
    ) -> Iterator[tuple[Piece[Content], Answer]]:
        """Carry out work on pieces, as `Scheduler.run` says."""
        parcel, rest = Parcel.of(work), iter(pieces)
        while True:
            lost: list[Piece[Content]] = []
            yield from _until_death(parcel, rest, self.workers, lost)
            if not lost:
                return
            for piece in lost:
                yield from _alone(parcel, piece)


def _alone(parcel: Parcel, piece: Piece[Content]) -> Iterator[tuple[Piece[Content], Any]]:
    """Try a piece by itself, some times."""
    for _ in range(_TRIES):
        lost: list[Piece[Content]] = []
        yield from _until_death(parcel, iter([piece]), 1, lost)
        if not lost:
            return
    raise WorkError(
        f"{piece.name}: the worker process died {_TRIES} times over it, with nothing else at work; most likely "
        "the system ended it for want of memory",
        "use a machine with more memory, or look into the system's log",
    )


def _until_death(
    parcel: Parcel, pieces: Iterator[Piece[Content]], workers: int, lost: list[Piece[Content]]
) -> Iterator[tuple[Piece[Content], Any]]:
    """Carry out work until there is none, or until a process dies; then `lost` gets what was under way."""
    waiting: dict[Future[Any], Piece[Content]] = {}
    label = parcel.label()
    with _pool(parcel, workers) as pool:
        while True:
            for piece in islice(pieces, 2 * workers - len(waiting)):
                waiting[_submit(pool, label, piece)] = piece
            if not waiting:
                return
            done, _ = wait(waiting, timeout=_PATIENCE, return_when=FIRST_COMPLETED)
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
        future: Future[Any] = pool.submit(carry_out, label, piece.content)
    except BrokenExecutor as error:
        future = Future()
        future.set_exception(error)
    return future


@contextmanager
def _pool(parcel: Parcel, workers: int) -> Iterator[Any]:
    """Open a pool whose processes have the work; they end with the block, at once if it is left early."""
    from loky import ProcessPoolExecutor

    pool = ProcessPoolExecutor(
        max_workers=workers,
        initializer=_begin,
        initargs=(os.getpid(), parcel),
        env=dict.fromkeys(_THREAD_VARIABLES, str(parcel.threads)),
    )
    try:
        yield pool
    except BaseException:
        pool.shutdown(wait=False, kill_workers=True)
        raise
    pool.shutdown(wait=True)


def _begin(parent: int, parcel: Parcel) -> None:
    """Leave Ctrl-C to the main process, do not outlive it, and get ready for the work."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(os, "getppid"):
        threading.Thread(target=_watch, args=(parent,), daemon=True).start()
    parcel.open()


def _watch(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(1.0)
    os._exit(1)
