"""Running tasks: skip what is finished, go on with what was interrupted, here or wherever a scheduler works."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from viatool.errors import ViatoolError
from viatool.schedule import Piece, Scheduler, Serial, Span, locked, reporter, run_in_folder
from viatool.studies.progress import Board
from viatool.studies.tasks import Record, Task, execute, load_record

Records = dict[str, Record]
Outcome = Record | ViatoolError


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
    scheduler: Scheduler | None = None,
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
    scheduler : Scheduler, optional
        Who does the tasks; by default this process.
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
    WorkError
        If workers died over a task, or the cluster was lost.
    """
    with locked(output):
        records = find_records(tasks, output)
        waiting = [task for task in tasks if task.name not in records]
        board.begin(waiting, len(tasks))
        finished(records)
        failures: dict[str, ViatoolError] = {}
        attempts = run_in_folder(
            Serial() if scheduler is None else scheduler,
            output,
            _attempt,
            _as_needed(waiting, records),
            reads=lambda task: task.reads(output),
            told=lambda piece, message: board.put(piece.name, message),
        )
        for piece, outcome in attempts:
            board.end(piece.name, outcome)
            if isinstance(outcome, Record):
                records[piece.name] = outcome
                finished(records)
            else:
                failures[piece.name] = outcome
    if failures:
        raise _summary_of(failures, len(tasks) - len(records))
    return {task.name: records[task.name] for task in tasks}


def _as_needed(waiting: Sequence[Task], records: Records) -> Iterator[Piece[Task] | None]:
    """Yield every task when all that it needs is among the records, and None while there is none like that."""
    left = dict(enumerate(waiting))
    while left:
        ready = (number for number, task in left.items() if all(need in records for need in task.needs))
        number = next(ready, None)
        if number is None:
            yield None
        else:
            task = left.pop(number)
            yield Piece(Span(number, number + 1), task.name, task)


def _summary_of(failures: dict[str, ViatoolError], unfinished: int) -> ViatoolError:
    name, first = next(iter(failures.items()))
    return type(first)(  # so that a wrong input stays one
        f"{len(failures)} task(s) failed and {unfinished} remain unfinished; {name}: {first.message}",
        first.hint or "run the same command again to try only these",
    )


def _attempt(output: Path, task: Task) -> Outcome:
    """Do a task; an error that viatool explains is an outcome, any other one ends the run."""
    try:
        return execute(task, output, reporter())
    except ViatoolError as error:
        return error
