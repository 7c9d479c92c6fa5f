"""The page of a diagnosis: what its template speaks of, filled in one place."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from viatool.report.foreign import one_line
from viatool.report.formats.figure import render as picture_of
from viatool.report.html.shell import assemble
from viatool.report.sections import Check

if TYPE_CHECKING:
    from viatool.report.diagnoses.record import ReadingRecord
    from viatool.report.diagnoses.run import DiagnosisRun

SCRIPTS = ("figures.js", "theme.js", "diagnosis.js")
TONES = {"specified": "safe", "another": "unsafe", "undecided": "unknown", "none": "unknown"}
"""How the style sheet calls the colour of each verdict."""


def render_page(document: DiagnosisRun, checks: Sequence[Check]) -> str:
    """Return the page of a diagnosis."""
    record, head = document.record, document.headline
    picture = picture_of(document, (), ".svg")
    assert isinstance(picture, bytes)
    return assemble(
        document,
        __package__,
        "diagnosis.html",
        SCRIPTS,
        title="viatool doctor",
        data={},
        figures=(),
        checks=checks,
        headline={
            "rate": head.rate,
            "rest": f"{head.rest}: {head.figures}",
            "policy": one_line(record.policy.path),
            "map": one_line(record.map.path),
            "source": ", ".join(document.subject),
        },
        tone=TONES[record.verdict],
        facts=document.facts,
        edits=document.change.rows if document.change is not None else (),
        edits_head=document.change.head if document.change is not None else (),
        head=document.head,
        readings=[_reading(document, one) for one in record.readings],
        picture=b64encode(picture).decode(),
    )


def _reading(document: DiagnosisRun, one: ReadingRecord) -> dict[str, Any]:
    return {
        "cells": document.row(one),
        "own": one is document.specified,
        "best": one is document.best,
        "alike": one.as_good,
        "edits": [(edit.key, edit.now or "leave it out", edit.was or "nothing") for edit in one.edits],
    }
