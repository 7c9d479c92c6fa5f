"""Tasks: the smallest pieces of a study that are done once, and the records that they leave."""

from __future__ import annotations

import hashlib
import json
import time
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from viatool.errors import ConfigurationError
from viatool.report.files import write_whole
from viatool.schedule import Progress


class Task(ABC):
    """One piece of work that either has a record or is still to be done.

    A task is sent to other processes, so it is plain data. It may be done in a copy of the output folder that holds
    only what it `reads`. It must cope with what an interrupted attempt left.
    """

    @property
    @abstractmethod
    def name(self) -> str:
        """Where its record stands: a path below the output folder, such as ``lab/td3/train``."""

    @property
    def needs(self) -> tuple[str, ...]:
        """Names of the tasks whose results it reads."""
        return ()

    def reads(self, output: Path) -> Iterable[Path]:
        """Return the files and folders that it looks at, below the output folder and relative to it."""
        return ()

    @property
    def work(self) -> float:
        """How long it takes, about, in seconds; only ratios matter."""
        return 1.0

    @abstractmethod
    def parameters(self) -> dict[str, Any]:
        """Return all that its result depends on, as JSON values."""

    @abstractmethod
    def run(self, output: Path, progress: Progress) -> dict[str, Any]:
        """Do the work and return the result as JSON values."""


@dataclass(frozen=True)
class Record:
    """What a finished task leaves behind.

    Parameters
    ----------
    task : str
        Its name.
    parameters : mapping
        What it was done with.
    result : mapping
        What it gave.
    seconds : float
        Wall time of the attempt that finished it.
    finished : str
        Date, ``YYYY-MM-DD``.
    """

    task: str
    parameters: Mapping[str, Any]
    result: Mapping[str, Any]
    seconds: float
    finished: str


def record_path(output: Path, name: str) -> Path:
    """Return where the record of a task stands."""
    return output / f"{name}.json"


def digest(parameters: Mapping[str, Any]) -> str:
    """Return a short fingerprint of parameters, for tasks that depend on other tasks."""
    return hashlib.sha256(json.dumps(parameters, sort_keys=True).encode()).hexdigest()[:16]


def execute(task: Task, output: Path, progress: Progress) -> Record:
    """Do a task and write its record, whole or not at all."""
    started = time.perf_counter()
    result = task.run(output, progress)
    seconds = round(time.perf_counter() - started, 1)
    record = Record(task.name, task.parameters(), result, seconds, time.strftime("%Y-%m-%d"))
    content = json.dumps(record.__dict__, indent=1, allow_nan=False) + "\n"
    write_whole(record_path(output, task.name), content.encode("utf-8"))
    return record


def load_record(task: Task, output: Path) -> Record | None:
    """Read the record of a task; None if there is none, or only a damaged one.

    Raises
    ------
    ConfigurationError
        If the task was finished with other parameters.
    """
    path = record_path(output, task.name)
    try:
        record = Record(**json.loads(path.read_text(encoding="utf-8")))
    except FileNotFoundError:
        return None
    except (OSError, ValueError, TypeError):  # not JSON, or not the fields of a record
        return None
    expected = json.loads(json.dumps(task.parameters()))
    if record.parameters != expected:
        raise ConfigurationError(
            f"{path} was made with different settings: {_difference(record.parameters, expected)}",
            "choose another --output, or remove that folder",
        )
    return record


def _difference(found: Mapping[str, Any], expected: Mapping[str, Any]) -> str:
    names = [name for name in {**found, **expected} if found.get(name) != expected.get(name)]
    shown = [f"{name} {found.get(name)!r}, not {expected.get(name)!r}" for name in names[:3]]
    return "; ".join(shown) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
