"""Work on an existing Dask cluster, whoever started it."""

from __future__ import annotations

import logging
import time
import uuid
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from viatool.errors import ConfigurationError, WorkError
from viatool.schedule.parcel import (
    Parcel,
    carry_out,
    checked,
    decisive_versions,
    describe_mismatch,
    failure,
    needed_versions,
)
from viatool.schedule.pieces import Answer, Content, Piece, Source, Told, draw
from viatool.schedule.progress import Abandoned, Message, ignore

if TYPE_CHECKING:
    from distributed import Client, Future

_CONNECT_SECONDS = 10.0
_FILE_SECONDS = 30.0  # for a scheduler that was started a moment ago
_WORKER_SECONDS = 60.0
_CLOSE_SECONDS = 1.0
_RETRIES = 2
_PATIENCE = 0.02  # seconds between looks at what has come
_AHEAD = 8  # pieces beyond those at work, so that an adaptive cluster sees a reason to grow


class Cluster:
    """The scheduler on a Dask cluster.

    Parameters
    ----------
    address : str
        Of its scheduler, such as ``tcp://host:8786``, or the path of its scheduler file (JSON).

    Notes
    -----
    The work travels once to each worker, a piece when it is its turn. Dask gives the pieces of a worker that died to
    others, and gives a piece up that killed several. A scheduler that dies ends the run; a checkpoint keeps what is
    finished. A piece that reports its progress ends soon after nobody waits for it any more.
    """

    remote = True

    def __init__(self, address: str) -> None:
        self.address = address
        self._threads = 1

    @property
    def workers(self) -> int:
        """Return the threads of all workers, as last seen."""
        return self._threads

    def connect(self) -> None:
        """Look whether the cluster is there and fit for the work, before any other work is done.

        Raises
        ------
        ConfigurationError
            If there is no scheduler or no worker, or a worker has other versions.
        """
        with self._client() as client:
            self._inspect(client)

    def run(
        self, work: Callable[[Content], Answer], pieces: Source[Content], told: Told = ignore
    ) -> Iterator[tuple[Piece[Content], Answer]]:
        """Carry out work on pieces, as `Scheduler.run` says."""
        with self._client() as client:
            self._inspect(client)
            orders = _Orders(client, Parcel.of(work))
            rest = iter(pieces)
            try:
                orders.fill(rest, self._threads)
                while orders.waiting:
                    for future in orders.finished(told):
                        piece = orders.waiting.pop(future)
                        try:
                            answer = self._answer(future, piece)
                            self._threads = max(1, sum(client.nthreads().values()))
                            orders.fill(rest, self._threads)
                        except OSError as error:  # so are all errors of Dask's connections
                            raise self._lost() from error
                        yield piece, checked(piece, answer)
                    orders.fill(rest, self._threads)  # with what waited for these answers
            finally:
                orders.cancel()

    def _answer(self, future: Future, piece: Piece[Any]) -> Any:
        """Return the answer of a finished piece, in whatever way it finished."""
        from distributed import KilledWorker

        status = future.status
        if status == "finished":
            return future.result()
        if status != "error":
            raise self._lost()
        error = future.exception()
        if isinstance(error, KilledWorker):
            raise WorkError(
                f"{piece.name}: several workers died over it, the last at {error.last_worker.address}; most "
                "likely because memory ran out",
                "give the workers more memory, or check their logs",
            ) from error
        if isinstance(error, ModuleNotFoundError):
            raise _not_importable(error) from error
        raise failure(piece, error) from error

    def _lost(self) -> WorkError:
        return WorkError(
            f"the connection to the scheduler {self.address} was lost",
            "start the cluster again; what is finished is kept in --checkpoint, for --resume, or in --output",
        )

    @contextmanager
    def _client(self) -> Iterator[Client]:
        from distributed import Client

        kind = "scheduler_file" if self.address.endswith(".json") else "address"
        if kind == "scheduler_file":
            _await_file(Path(self.address))
        quiet = logging.getLogger("distributed")
        level = quiet.level
        # What goes wrong is said once, by an error; a lost client goes on trying, so then it stays quiet.
        quiet.setLevel(logging.CRITICAL)
        try:
            client = Client(**{kind: self.address}, timeout=_CONNECT_SECONDS, set_as_default=False)
        except (OSError, ValueError, TimeoutError) as error:
            raise ConfigurationError(
                f"no Dask scheduler answers at {self.address} ({error})",
                "start one with 'dask scheduler', and give the address that it prints",
            ) from error
        try:
            yield client
            quiet.setLevel(level)
        finally:
            with suppress(Exception):
                client.close(timeout=_CLOSE_SECONDS)

    def _inspect(self, client: Client) -> None:
        """Refuse a cluster without workers, or with workers that would compute something else."""
        try:
            client.wait_for_workers(1, timeout=_WORKER_SECONDS)
        except TimeoutError as error:
            raise ConfigurationError(
                f"the cluster at {self.address} has no worker after {_WORKER_SECONDS:g} s",
                f"start some with 'dask worker {self.address}'",
            ) from error
        here, others = needed_versions(), client.run(decisive_versions, on_error="return")
        try:
            others[f"scheduler {self.address}"] = client.run_on_scheduler(decisive_versions)
        except Exception as error:  # whatever its import raises comes back
            raise _not_importable(error, f"scheduler {self.address}") from error
        for process, there in others.items():
            if isinstance(there, BaseException):
                raise _not_importable(there, f"worker {process}") from there
            differing = describe_mismatch(here, there)
            if differing:
                raise ConfigurationError(
                    f"{process} of the cluster has {differing}", "install the same versions there as here"
                )
        self._threads = max(1, sum(client.nthreads().values()))


def _await_file(path: Path) -> None:
    """Wait for a scheduler to write its file; Dask's client would wait for ever."""
    end = time.monotonic() + _FILE_SECONDS
    while not path.exists():
        if time.monotonic() >= end:
            raise ConfigurationError(
                f"no scheduler file '{path}' has appeared within {_FILE_SECONDS:g} s",
                f"check the path, or start one with 'dask scheduler --scheduler-file {path}'",
            )
        time.sleep(0.1)


def _not_importable(error: BaseException, process: str = "worker") -> ConfigurationError:
    return ConfigurationError(
        f"the {process} cannot import viatool ({type(error).__name__}: {error})",
        "install viatool in the environments of the scheduler and of the workers as well",
    )


class _Orders:
    """The pieces that are at work on a cluster, or about to be.

    Parameters
    ----------
    client : Client
        Of the cluster.
    parcel : Parcel
        The work; sent once to each worker.
    """

    def __init__(self, client: Client, parcel: Parcel) -> None:
        from distributed import as_completed

        self.client, self.run = client, f"viatool-{uuid.uuid4().hex[:12]}"
        self.parcel = client.submit(_keep, parcel, key=f"{self.run}-work")
        self.waiting: dict[Future, Piece[Any]] = {}
        self._ended = as_completed(loop=client.loop)
        self._posted: deque[tuple[str, Any]] = deque()
        client.subscribe_topic(self.run, lambda event: self._posted.append(event[1]))

    def fill(self, pieces: Iterator[Piece[Any] | None], threads: int) -> None:
        """Order as many pieces as keep all workers busy."""
        for piece in draw(pieces, 2 * threads + _AHEAD - len(self.waiting)):
            key = f"{self.run}-{piece.span.first}-{piece.span.last}"
            tell = partial(_post, self.run, key)
            future = self.client.submit(
                carry_out, self.parcel, piece.content, tell, key=key, retries=_RETRIES
            )
            self.waiting[future] = piece
            self._ended.add(future)

    def finished(self, told: Told) -> list[Future]:
        """Return what has ended, if anything has, after passing on what was posted before."""
        ended: list[Future] = self._ended.next_batch(block=False)
        pieces = {future.key: piece for future, piece in self.waiting.items()} if self._posted else {}
        while self._posted:
            key, message = self._posted.popleft()
            if key in pieces:
                told(pieces[key], Message(*message))
        if not ended:
            time.sleep(_PATIENCE)
        return ended

    def cancel(self) -> None:
        """Let the cluster forget all of it."""
        with suppress(Exception):  # the scheduler may be gone
            self.client.cancel([*self.waiting, self.parcel], asynchronous=False, force=True)


def _post(topic: str, key: str, message: Message) -> None:
    """Post a message from a worker; a piece that nobody waits for ends here."""
    from distributed import get_worker

    worker = get_worker()
    task = worker.state.tasks.get(key)
    if task is None or task.state == "cancelled":
        raise Abandoned(key)
    worker.log_event(topic, (key, list(message)))


def _keep(parcel: Parcel) -> Parcel:
    """Hold the work on a worker: as a task it is made again if that worker dies."""
    return parcel
