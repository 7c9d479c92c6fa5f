"""GitHub Actions: workflow commands for annotations, and the Markdown report in the job's summary."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from viatool.report.document import Annotated
from viatool.report.foreign import one_line
from viatool.report.formats.markdown import markdown
from viatool.report.ruling import Ruling
from viatool.report.sections import Annotation, Check

SUFFIXES = ()
NEEDS = Annotated
LIBRARIES = ()
SUMMARY_VARIABLE = "GITHUB_STEP_SUMMARY"
MOST_EVIDENCE = 10  # sentences of a condition that failed
MOST_OF_A_KIND = 10  # GitHub shows no more annotations of a kind for each step


def render(document: Annotated, checks: Sequence[Check], suffix: str) -> str:
    """Return the workflow commands, and append the Markdown report to the job's summary if there is one.

    Notes
    -----
    What was at stake is a notice. There are errors exactly if the gate fails or could not be decided. At most
    `MOST_OF_A_KIND` errors and as many warnings; the last one counts what is left out.
    """
    summary = os.environ.get(SUMMARY_VARIABLE)
    if summary:
        with Path(summary).open("a", encoding="utf-8") as stream:
            stream.write(markdown(document, checks) + "\n")
    ruling = Ruling(checks)
    failed = [
        Annotation(
            ruling.of_check(c),
            f"gate {'not decided' if c.open else 'failed'}: {c.condition}",
            " ".join([c.figures, *c.some_evidence(MOST_EVIDENCE)]),
        )
        for c in checks
        if not c.passed
    ]
    stake = document.headline.stake
    told = [Annotation("notice", "at stake", stake)] if stake else []
    found = [*told, *failed, *(replace(a, level=ruling.of_annotation(a)) for a in document.annotations())]
    file = document.record.map.path
    return "".join(
        f"{command(annotation, file)}\n"
        for level in ("notice", "error", "warning")
        for annotation in _limited([a for a in found if a.level == level])
    )


def _limited(annotations: Sequence[Annotation]) -> list[Annotation]:
    if len(annotations) <= MOST_OF_A_KIND:
        return list(annotations)
    kept = list(annotations[: MOST_OF_A_KIND - 1])
    left_out = len(annotations) - len(kept)
    return [*kept, Annotation(annotations[0].level, f"and {left_out} more", "see the report")]


def command(annotation: Annotation, file: str) -> str:
    """Return one workflow command; nothing in the texts can end it or start another."""
    place = f"file={_property(file)},title={_property(annotation.title)}"
    return f"::{annotation.level} {place}::{_data(annotation.message)}"


def _data(text: str) -> str:
    return one_line(text).replace("%", "%25")


def _property(text: str) -> str:
    return _data(text).replace(":", "%3A").replace(",", "%2C")
