"""Running cells: those that are finished are kept, the others are run, and all of them are summed up."""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import date
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import viatool
from viatool.errors import EmptyEvaluationError
from viatool.projects.file import Project
from viatool.projects.folder import LOG, PAGE, RECORD, SUMMARY, Results, standing_in
from viatool.projects.inputs import digest_of_inputs
from viatool.projects.matrix import ProjectCell
from viatool.projects.options import Catalogue
from viatool.projects.page import page_of
from viatool.projects.records import CellRecord, ConditionRecord, ProjectSummary, outcome_of, worst
from viatool.projects.selection import Selection
from viatool.report import KINDS, accepted_text, formats_of
from viatool.report.files import write_whole
from viatool.report.kinds import live_of
from viatool.report.outputs import format_named
from viatool.schedule import Piece, Progress, Scheduler, Span, ignore, locked

Invoke = Callable[[Sequence[str]], tuple[int, str]]
"""Carries out the words of a command line, and returns its exit code and what it said on stderr; picklable."""

INTERRUPTED = 130
ACCEPTED = "accepted.toml"
_HTML = ("bokeh", "jinja2")
_STEMS = {"json": "report", "html": "report", "markdown": "report"}
_SUFFIXES = {"json": ".json", "markdown": ".md", "github": ".txt"}


@dataclass(frozen=True)
class Request:
    """Which cells are run, and how.

    Parameters
    ----------
    selection : Selection
        Which cells are meant.
    last_failed : bool
        Of them only those that have not passed with their present inputs; all if there is none.
    resume : bool
        Keep what is finished with the same inputs, and go on with what was begun.
    output : Path, optional
        The folder of the results instead of the file's.
    today : date
        Decides which accepted findings have expired.
    """

    selection: Selection = field(default_factory=Selection)
    last_failed: bool = False
    resume: bool = False
    output: Path | None = None
    today: date = field(default_factory=date.today)

    def folder(self, project: Project) -> Path:
        """Return the folder of the results."""
        return project.root / project.file.output if self.output is None else self.output.absolute()

    def chosen(self, known: Mapping[str, CellRecord]) -> set[str]:
        """Return the names of the cells that are meant, of all with what is known of them.

        Raises
        ------
        EmptyEvaluationError
            If there is none.
        """
        meant = {name for name in known if self.selection(name)}
        if not meant:
            raise EmptyEvaluationError(
                f"no cell is meant by '{self.selection.expression}'", "see the cells with viatool run --list"
            )
        failed = {name for name in meant if known[name].code != 0}
        return failed if self.last_failed and failed else meant


@dataclass(frozen=True)
class _Errand:
    """What a worker needs to run a cell."""

    words: list[str]
    root: str


@dataclass(frozen=True)
class _Attempt:
    """How a command ended."""

    code: int
    said: str
    seconds: float


def run_cells(
    project: Project,
    cells: Sequence[ProjectCell],
    catalogue: Catalogue,
    invoke: Invoke,
    scheduler: Scheduler,
    request: Request | None = None,
    progress: Progress = ignore,
) -> ProjectSummary:
    """Run the cells of a project, and write summary and page.

    Parameters
    ----------
    project : Project
        The file, beside which relative paths begin.
    cells : sequence of ProjectCell
        All of its cells.
    catalogue : Catalogue
        Their commands.
    invoke : callable
        Carries out a command.
    scheduler : Scheduler
        Who does the work.
    request : Request, optional
        Which of them are run, and how.
    progress : callable
        Called when a cell is finished.

    Returns
    -------
    ProjectSummary
        Every cell; those that were not asked for as they are stored, if their inputs are still the same.

    Raises
    ------
    EmptyEvaluationError
        If no cell is meant.
    ConfigurationError
        If another process works in the folder, or it cannot be written.
    KeyboardInterrupt
        If a cell was interrupted; those that are finished are stored.
    """
    request = request or Request()
    results = Results(request.folder(project))
    runs = _runs(project, cells, catalogue, request)
    asked = request.chosen({name: run.known(results) for name, run in runs.items()})
    with locked(results.path):
        results.open()
        known = {name: run.known(results) for name, run in runs.items()}
        records = {name: record.model_copy(update={"run": name in asked}) for name, record in known.items()}
        kept = [name for name in asked if request.resume and known[name].settled]
        records.update({name: records[name].model_copy(update={"reused": True}) for name in kept})
        waiting = [runs[name] for name in runs if name in asked.difference(kept)]
        done = _carry_out(waiting, results, project.root, invoke, scheduler, resume=request.resume)
        for number, record in enumerate(done, len(kept) + 1):
            records[record.name] = record
            progress(
                "cells",
                number,
                len(asked),
                f"{record.name}: {record.outcome}  {record.stake or record.headline}".rstrip(),
            )
        results.close()
        summary = ProjectSummary(
            project=project.path.name,
            viatool=viatool.__version__,
            exit_code=worst(record.exit_code for record in records.values() if record.run),
            cells=list(records.values()),
        )
        write_whole(results.path / SUMMARY, (summary.model_dump_json(indent=2) + "\n").encode("utf-8"))
        write_whole(results.path / PAGE, page_of(summary).encode("utf-8"))
    return summary


def choose_cells(
    project: Project, cells: Sequence[ProjectCell], catalogue: Catalogue, request: Request
) -> list[ProjectCell]:
    """Return the cells that `run_cells` would run or keep.

    Raises
    ------
    EmptyEvaluationError
        If there is none.
    """
    results = Results(request.folder(project))
    runs = _runs(project, cells, catalogue, request)
    asked = request.chosen({name: run.known(results) for name, run in runs.items()})
    return [cell for cell in cells if cell.name in asked]


def _runs(
    project: Project, cells: Sequence[ProjectCell], catalogue: Catalogue, request: Request
) -> dict[str, _Run]:
    with standing_in(project.root):
        return {cell.name: _Run.of(project, cell, catalogue, request.today) for cell in cells}


@dataclass(frozen=True)
class _Run:
    """A cell that may be run: its words, its files, and the digest of its inputs."""

    cell: ProjectCell
    words: list[str]
    files: dict[str, str]
    inputs: str
    keeps: bool

    @classmethod
    def of(cls, project: Project, cell: ProjectCell, catalogue: Catalogue, today: date) -> _Run:
        files = _report_files(project, cell.kind)
        words = [cell.kind, *cell.arguments(catalogue)]
        inputs = digest_of_inputs(cell, words, list(files), today)
        keeps = any(parameter.name == "checkpoint" for parameter in catalogue.command(cell.kind).params)
        return cls(cell, words, files, inputs, keeps)

    @property
    def unknown(self) -> CellRecord:
        """Return the record of a cell of which nothing is known."""
        cell = self.cell
        return CellRecord(
            name=cell.name,
            check=cell.check,
            kind=cell.kind,
            policy=cell.policy,
            map=cell.map,
            axes=dict(cell.axes),
            command=["viatool", *self.words],
            inputs=self.inputs,
        )

    def known(self, results: Results) -> CellRecord:
        """Return what is stored of it, as long as its inputs are the same."""
        stored = results.record(self.cell.folder)
        if stored is None or stored.inputs != self.inputs:
            return self.unknown
        return stored.model_copy(update={"run": False, "reused": False})

    def errand(self, draft: Path, results: Results, root: Path, *, resume: bool) -> _Errand:
        """Return what a worker is given, which writes into a draft."""
        words = [*self.words, "--quiet"]
        words += [f"--output={name}:{draft / file}" for name, file in self.files.items()]
        if self.cell.accepted:
            write_whole(draft / ACCEPTED, accepted_text(self.cell.accepted).encode("utf-8"))
            words.append(f"--accepted={draft / ACCEPTED}")
        if self.keeps:
            unfinished = results.unfinished(self.inputs)
            if not resume:
                shutil.rmtree(unfinished, ignore_errors=True)
            words += [f"--checkpoint={unfinished}", *(["--resume"] if resume else [])]
        return _Errand(words, str(root))

    def finish(self, attempt: _Attempt, draft: Path, results: Results) -> CellRecord:
        """Write the record of an attempt, and let the draft become the folder of the cell."""
        verdict, code = _json_of(draft / self.files["gate"]), attempt.code
        if code == 0 and not verdict:  # nothing says that it passed
            code = 3
        conditions = [ConditionRecord.model_validate(one) for one in verdict.get("conditions", ())]
        place = results.cell(self.cell.folder).relative_to(results.path).as_posix()
        record = self.unknown.model_copy(
            update={
                "code": code,
                "outcome": outcome_of(code, conditions),
                "stake": verdict.get("stake", ""),
                "headline": verdict.get("headline", ""),
                "figures": verdict.get("figures", ""),
                "conditions": conditions,
                "message": attempt.said if code else "",
                "seconds": round(attempt.seconds, 3),
                "reports": {n: f"{place}/{f}" for n, f in self.files.items() if (draft / f).exists()},
                "run": True,
            }
        )
        write_whole(draft / LOG, attempt.said.encode("utf-8", errors="backslashreplace"))
        write_whole(draft / RECORD, (record.model_dump_json(indent=2) + "\n").encode("utf-8"))
        results.publish(draft, self.cell.folder)
        shutil.rmtree(results.unfinished(self.inputs), ignore_errors=True)
        return record


def _carry_out(
    runs: Sequence[_Run], results: Results, root: Path, invoke: Invoke, scheduler: Scheduler, *, resume: bool
) -> Iterator[CellRecord]:
    """Run cells, and yield the record of each as soon as it is stored."""
    drafts: dict[str, Path] = {}

    def errands() -> Iterator[Piece[_Errand]]:
        for number, run in enumerate(runs):
            drafts[run.cell.name] = results.draft()
            errand = run.errand(drafts[run.cell.name], results, root, resume=resume)
            yield Piece(Span(number, number + 1), run.cell.name, errand)

    for piece, attempt in scheduler.run(partial(_attempt, invoke), errands()):
        if attempt.code == INTERRUPTED:
            raise KeyboardInterrupt
        yield runs[piece.span.first].finish(attempt, drafts[piece.name], results)


def _attempt(invoke: Invoke, errand: _Errand) -> _Attempt:
    """Run one cell, in whatever process this is."""
    began = time.perf_counter()
    with standing_in(Path(errand.root)):
        code, said = invoke(errand.words)
    return _Attempt(code, said, time.perf_counter() - began)


def _report_files(project: Project, kind: str) -> dict[str, str]:
    """Return the names of the files that a cell writes, by format."""
    asked = project.file.reports
    if asked is None:
        asked = ["html"] if all(find_spec(name) is not None for name in _HTML) else ["markdown"]
    document = next(live_of(stored) for stored in KINDS if kind == stored.COMMAND)
    served = formats_of(document)
    formats = dict.fromkeys(["json", "gate", *(name for name in asked if name in served)])
    return {name: f"{_STEMS.get(name, name)}{_suffix(name)}" for name in formats}


def _suffix(name: str) -> str:
    return _SUFFIXES.get(name) or next(iter(format_named(name).SUFFIXES), "")


def _json_of(path: Path) -> dict[str, Any]:
    """Return what a cell wrote; nothing if it did not come that far."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}
