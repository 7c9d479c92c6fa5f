"""Tables for spreadsheets: written some rows at a time, and with names that no spreadsheet takes for a formula."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Iterator, Sequence
from io import StringIO

from viatool.report.foreign import shown

_CHARACTERS = 1_000_000
_FORMULA_STARTS = ("=", "+", "-", "@")


def table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> Iterator[str]:
    """Yield rows below a row of names, some at a time."""
    stream = StringIO(newline="")
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(head)
    for row in rows:
        writer.writerow(row)
        if stream.tell() > _CHARACTERS:
            yield stream.getvalue()
            stream.seek(0)
            stream.truncate()
    yield stream.getvalue()


def inert(text: str) -> str:
    """Keep a name on its line, and keep a spreadsheet from reading it as a formula."""
    text = shown(text)
    return f"'{text}" if text.lstrip().startswith(_FORMULA_STARTS) else text
