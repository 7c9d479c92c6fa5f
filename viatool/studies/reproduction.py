"""The whole job: run the tasks of some studies, and publish data and pages while they arrive."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

from viatool.schedule import Scheduler
from viatool.studies import study_named
from viatool.studies.progress import Board
from viatool.studies.runner import Records, run_tasks
from viatool.studies.study import Options, write_data, write_page
from viatool.studies.tasks import Task

_SECONDS_BETWEEN_PAGES = 60.0


def reproduce(
    names: Sequence[str],
    options: Options,
    output: Path,
    results: Path,
    board: Board,
    *,
    scheduler: Scheduler | None = None,
) -> list[Path]:
    """Run studies and write their data and pages.

    Parameters
    ----------
    names : sequence of str
        Of the studies; tasks that several of them name are done once.
    options : Options
        For all of them.
    output, results : Path
        Folders of the records and of the pages.
    board : Board
        Shows how far everything is.
    scheduler : Scheduler, optional
        Who does the tasks; by default this process.

    Returns
    -------
    list of Path
        The pages. They are also written now and then on the way, and when something stops the run: a page says
        how much of its data is there.
    """
    plans = {name: study_named(name).plan(options) for name in names}
    tasks: dict[str, Task] = {task.name: task for plan in plans.values() for task in plan}
    known: Records = {}
    last = time.monotonic()

    def publish_now_and_then(records: Records) -> None:
        nonlocal known, last
        known = records
        if time.monotonic() - last >= _SECONDS_BETWEEN_PAGES:
            publish(plans, options, records, results)
            last = time.monotonic()

    try:
        run_tasks(list(tasks.values()), output, board, scheduler=scheduler, finished=publish_now_and_then)
    finally:
        pages = publish(plans, options, known, results)
    return pages


def publish(
    plans: dict[str, Sequence[Task]], options: Options, records: Records, results: Path
) -> list[Path]:
    """Write data and page of every study of which some task is finished."""
    pages = []
    for name, tasks in plans.items():
        if any(task.name in records for task in tasks):
            study = study_named(name)
            write_data(study, options, tasks, records, results)
            pages.append(write_page(study, results))
    return pages


def render(names: Sequence[str], results: Path) -> list[Path]:
    """Write the pages of studies from the data in `results` alone."""
    return [write_page(study_named(name), results) for name in names]
