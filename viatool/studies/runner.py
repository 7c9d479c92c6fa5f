"""Running tasks: skip what is finished, go on with what was interrupted, in this process or in several."""

from __future__ import annotations

import multiprocessing
import os
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from viatool.errors import ConfigurationError, ViatoolError
from viatool.studies.progress import Board, Message
from viatool.studies.tasks import Record, Task, execute, load_record

Records = dict[str, Record]
Outcome = Record | ViatoolError

LOCK = ".lock"
_SECONDS_BETWEEN_MESSAGES = 0.5
_to_parent: Any = None  # of a worker process: the queue of its messages


def find_records(tasks: Sequence[Task], output: Path) -> Records:
    """Return the records of the tasks that are finished.

    Raises
    ------
    ConfigurationError
        If one of them was finished with other parameters.
    """
    found = {task.name: load_record(task, output) for task in tasks}
    return {name: record for name, record in found.items() if record is not None}


def run_tasks(
    tasks: Sequence[Task],
    output: Path,
    board: Board,
    *,
    workers: int = 1,
    finished: Callable[[Records], None] = lambda records: None,
) -> Records:
    """Finish all tasks.

    Parameters
    ----------
    tasks : sequence of Task
        Each after the tasks that it needs; names are unique.
    output : Path
        The folder of the records. Only one process at a time works in it.
    board : Board
        Shows how far everything is.
    workers : int
        Processes that work side by side; 1 is this process alone.
    finished : callable
        Called with all records so far, at the start and after each task.

    Returns
    -------
    dict
        The records by the names of the tasks, in their order.

    Raises
    ------
    ConfigurationError
        If another process works in the folder, or records were made with other parameters.
    ViatoolError
        If a task failed; everything that does not need it is finished first.
    """
    output.mkdir(parents=True, exist_ok=True)
    with _locked(output):
        records = find_records(tasks, output)
        waiting = [task for task in tasks if task.name not in records]
        board.begin(waiting, len(tasks))
        finished(records)
        failures: dict[str, ViatoolError] = {}
        with _executor(workers, board) as executor:
            running: dict[Future[Outcome], Task] = {}
            while waiting or running:
                while len(running) < workers and (task := _take_ready(waiting, records)) is not None:
                    running[executor.submit(_attempt, task, output)] = task
                if not running:
                    break  # what is left needs something that failed
                for future in wait(running, _SECONDS_BETWEEN_MESSAGES, FIRST_COMPLETED).done:
                    task, outcome = running.pop(future), future.result()
                    board.end(task.name, outcome)
                    if isinstance(outcome, Record):
                        records[task.name] = outcome
                        finished(records)
                    else:
                        failures[task.name] = outcome
                board.receive()
    if failures:
        raise _summary_of(failures, len(tasks) - len(records))
    return {task.name: records[task.name] for task in tasks}


def _take_ready(waiting: list[Task], records: Records) -> Task | None:
    """Remove and return the first task whose needs are finished."""
    for index, task in enumerate(waiting):
        if all(need in records for need in task.needs):
            return waiting.pop(index)
    return None


def _summary_of(failures: dict[str, ViatoolError], unfinished: int) -> ViatoolError:
    name, first = next(iter(failures.items()))
    return type(first)(  # so that a wrong input stays one
        f"{len(failures)} task(s) failed and {unfinished} remain unfinished; {name}: {first.message}",
        first.hint or "run the same command again to try only these",
    )


def _attempt(task: Task, output: Path) -> Outcome:
    """Do a task in this process; an error that viatool explains is an outcome, any other one ends the run."""
    try:
        return execute(task, output, _Messages(task.name))
    except ViatoolError as error:
        return error


class _Messages:
    """Progress of one task, sent to the board a few times a second."""

    def __init__(self, task: str) -> None:
        self._task, self._last = task, 0.0

    def advance(self, fraction: float, note: str = "") -> None:
        """Send how far the task is."""
        now = time.monotonic()
        if now - self._last >= _SECONDS_BETWEEN_MESSAGES:
            self._last = now
            _to_parent.put(Message(self._task, fraction, note))

    def say(self, line: str) -> None:
        """Leave the lines of single trainings out: `metrics.csv` has them."""


class _ThisProcess(Executor):
    """Runs a call when it is submitted."""

    def submit(self, call: Callable[..., Any], /, *arguments: Any, **named: Any) -> Future[Any]:
        """Run the call now; what it raises is raised here."""
        future: Future[Any] = Future()
        future.set_result(call(*arguments, **named))
        return future


@contextmanager
def _executor(workers: int, board: Board) -> Iterator[Executor]:
    """Give something to submit tasks to; their messages reach the board."""
    global _to_parent
    if workers == 1:
        _to_parent = board
        yield _ThisProcess()
        return
    context = multiprocessing.get_context("spawn")  # a fork of a process with threads may hang
    board.messages = context.Queue()
    with ProcessPoolExecutor(workers, context, initializer=_begin_worker, initargs=(board.messages,)) as pool:
        try:
            yield pool
        except BaseException:
            for child in multiprocessing.active_children():
                child.terminate()
            raise


def _begin_worker(queue: Any) -> None:
    """Keep the queue, and end with the parent: a worker that outlives it would write into the next attempt."""
    global _to_parent
    _to_parent = queue
    parent = multiprocessing.parent_process()
    assert parent is not None

    def end_with_parent() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=end_with_parent, daemon=True).start()


@contextmanager
def _locked(output: Path) -> Iterator[None]:
    """Keep other processes out of a folder; the lock ends with the process, however it ends."""
    with (output / LOCK).open("a+b") as stream:
        try:
            _lock(stream.fileno())
        except OSError as error:
            raise ConfigurationError(
                f"another viatool reproduce works in {output}", "wait for it, or choose another --output"
            ) from error
        yield


if os.name == "nt":  # pragma: no cover  # the other system's half

    def _lock(descriptor: int) -> None:
        import msvcrt

        msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined]

else:

    def _lock(descriptor: int) -> None:
        import fcntl

        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
