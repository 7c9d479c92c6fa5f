"""A study: tasks, data that sums up their records, and a page that is written from the data alone."""

from __future__ import annotations

import json
import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from viatool.errors import ConfigurationError
from viatool.report.files import write_whole
from viatool.studies.tasks import Record, Task

Data = Mapping[str, Any]


@dataclass(frozen=True)
class Options:
    """What a user decides about all studies.

    Parameters
    ----------
    preset : str
        Of the trainings.
    settings : tuple of str
        ``key=value`` over the preset, for every training.
    seeds : int
        S, policies of each method.
    seed : int
        Of the trainings.
    scenarios : int
        Held-out random scenarios of the evaluation.
    eps : float
        Sensor error of the verification.
    footprint : float
        Radius in metres of the disc from which the verification measures; 0 is the map's footprint.
    """

    preset: str = "study"
    settings: tuple[str, ...] = ()
    seeds: int = 5
    seed: int = 0
    scenarios: int = 500
    eps: float = 0.01
    footprint: float = 0.0

    def command(self, study: str) -> str:
        """Return the command line that gives these options."""
        words = ["viatool reproduce", study, f"--preset {self.preset}"]
        words += [f"--set {shlex.quote(setting)}" for setting in self.settings]
        words += [f"--seeds {self.seeds}"] + ([f"--seed {self.seed}"] if self.seed else [])
        words += [f"--scenarios {self.scenarios}"] if self.scenarios != Options.scenarios else []
        words += [f"--footprint {self.footprint:g}"] if self.footprint else []
        return " ".join(words)


@dataclass(frozen=True)
class Page:
    """What a study shows.

    Parameters
    ----------
    text : str
        Markdown.
    pictures : mapping
        Files beside the page, by name.
    """

    text: str
    pictures: Mapping[str, bytes] = field(default_factory=dict)


@dataclass(frozen=True)
class Study:
    """A named experiment.

    Parameters
    ----------
    name : str
        Of its page and data file.
    summary : str
        One line for people.
    plan : callable
        From `Options` to the tasks, each after those that it needs. Studies share tasks of the same name.
    collect : callable
        From the tasks and those records that exist so far, by task, to the data of the page: JSON values.
    render : callable
        From the data to the page; reads nothing else.
    """

    name: str
    summary: str
    plan: Callable[[Options], Sequence[Task]]
    collect: Callable[[Sequence[Task], Mapping[str, Record]], Data]
    render: Callable[[Data], Page]


def data_path(results: Path, study: Study) -> Path:
    """Return where the data of a study stands."""
    return results / "data" / f"{study.name}.json"


def write_data(
    study: Study, options: Options, tasks: Sequence[Task], records: Mapping[str, Record], results: Path
) -> None:
    """Sum up the records of a study."""
    own = {task.name: records[task.name] for task in tasks if task.name in records}
    counts = {"finished": len(own), "total": len(tasks)}
    command = options.command(study.name)
    data = {"study": study.name, "command": command, "tasks": counts, **study.collect(tasks, own)}
    lines = (f"{json.dumps(key)}: {json.dumps(value, allow_nan=False)}" for key, value in data.items())
    write_whole(data_path(results, study), ("{\n" + ",\n".join(lines) + "\n}\n").encode("utf-8"))


def write_page(study: Study, results: Path) -> Path:
    """Write the page of a study, and its pictures, from its data.

    Raises
    ------
    ConfigurationError
        If there is no data, or it is not this study's.
    """
    path = data_path(results, study)
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigurationError(
            f"cannot read {path}: {error.strerror}", f"run viatool reproduce {study.name} first"
        ) from error
    except ValueError as error:
        raise ConfigurationError(f"{path} is not JSON", "remove it and run the study again") from error
    if not isinstance(data, dict) or data.get("study") != study.name:
        raise ConfigurationError(f"{path} is not the data of {study.name}", "run the study again")
    page = study.render(data)
    target = results / f"{study.name}.md"
    for name, content in page.pictures.items():
        write_whole(results / name, content)
    write_whole(target, page.text.encode("utf-8"))
    return target
