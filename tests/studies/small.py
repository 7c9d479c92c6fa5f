"""Small tasks, and a study of them, that tests can interrupt."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from viatool.errors import ViatoolError
from viatool.report.files import write_whole
from viatool.schedule import Progress
from viatool.studies.study import Options, Page, Study
from viatool.studies.tasks import Record, Task


@dataclass(frozen=True)
class Count(Task):
    """Adds up; leaves a line in ``log`` for every attempt, and goes on from what an earlier attempt reached."""

    label: str
    upto: int = 3
    needed: tuple[str, ...] = ()
    fails: bool = False
    seconds: float = 0.0

    @property
    def name(self) -> str:
        return f"small/{self.label}"

    @property
    def needs(self) -> tuple[str, ...]:
        return self.needed

    def parameters(self) -> dict[str, Any]:
        return {"upto": self.upto, "fails": self.fails}

    def run(self, output: Path, progress: Progress) -> dict[str, Any]:
        folder = output / self.name
        folder.mkdir(parents=True, exist_ok=True)
        with (output / "log").open("a", encoding="utf-8") as log:
            log.write(f"{self.label}\n")
        if self.fails:
            raise ViatoolError("it does not work", "mend it")
        state = folder / "state"
        reached = int(state.read_text()) if state.exists() else 0
        for number in range(reached + 1, self.upto + 1):
            time.sleep(self.seconds)
            write_whole(state, str(number).encode())
            progress(f"at {number}", number, self.upto)
        return {"sum": sum(range(self.upto + 1))}


def plan(options: Options) -> list[Task]:
    return [Count("a", options.seeds), Count("b", needed=("small/a",))]


def collect(tasks: Sequence[Task], records: Mapping[str, Record]) -> dict[str, Any]:
    return {"sums": {name: record.result["sum"] for name, record in records.items()}}


def render(data: Mapping[str, Any]) -> Page:
    tasks = data["tasks"]
    sums = "".join(f"{name}: {value}\n" for name, value in data["sums"].items())
    return Page(f"{tasks['finished']} of {tasks['total']}\n{sums}", {"picture.svg": b"<svg/>"})


SMALL = Study("small", "adds up", plan, collect, render)
