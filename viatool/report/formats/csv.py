"""A row for each part of the run, for spreadsheets: no name in it is taken for a formula."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from io import StringIO

from viatool.report.document import Tabled
from viatool.report.foreign import shown
from viatool.report.ruling import Ruling
from viatool.report.sections import Check

SUFFIXES = (".csv",)
NEEDS = Tabled
LIBRARIES = ()
FAILS = "fails"
_CHARACTERS = 1_000_000
_FORMULA_STARTS = ("=", "+", "-", "@")


def render(document: Tabled, checks: Sequence[Check], suffix: str) -> Iterator[str]:
    """Yield the rows below a row of names, some at a time; with a gate, each with the conditions that it fails.

    Close places that fail a condition follow behind the rows.
    """
    stream = StringIO(newline="")
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(map(_inert, [*document.columns(), *([FAILS] if checks else [])]))
    for row in _judged(document, Ruling(checks)) if checks else document.rows():
        writer.writerow(map(_inert, row))
        if stream.tell() > _CHARACTERS:
            yield stream.getvalue()
            stream.seek(0)
            stream.truncate()
    yield stream.getvalue()


def _judged(document: Tabled, ruling: Ruling) -> Iterator[Sequence[object]]:
    for row, keys in zip(document.rows(), document.row_keys(), strict=False):
        yield [*row, "; ".join(ruling.conditions(keys))]
    for finding in ruling.found_besides(()):
        besides = document.row_of(finding)
        if besides is not None:
            yield [*besides, "; ".join(ruling.conditions((finding.key,)))]


def _inert(cell: object) -> object:
    """Keep a name on its line, and keep a spreadsheet from reading it as a formula; numbers stay as they are."""
    if not isinstance(cell, str) or _is_number(cell):
        return cell
    text = shown(cell)
    return f"'{text}" if text.lstrip().startswith(_FORMULA_STARTS) else text


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return text.isascii() and "_" not in text
