"""The state table: one row for each state, as arrays for other programs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any
from zipfile import ZIP_DEFLATED, ZipFile

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from viatool.report.archives import BESIDE, report_beside
from viatool.report.document import StateTable, StateTabled
from viatool.report.sections import Check

SUFFIXES = (".npz",)
NEEDS = StateTabled
LIBRARIES = ()
_ROWS = 16_384
_FAST = 1  # level of compression: nearly as small as the usual 6, and several times as fast


def render(document: StateTabled, checks: Sequence[Check], suffix: str) -> Iterator[bytes]:
    """Yield the tables of states as one npz archive, some rows at a time, with the report that they belong to.

    With a gate, ``conditions`` (C,) are those that do not hold, and ``fails`` (N, C) tells which states each counts.
    """
    kept = {f"{BESIDE}{name}": array for name, array in document.kept_beside().items()}
    return tables(document, checks, {**report_beside(document), **kept})


def tables(
    document: StateTabled, checks: Sequence[Check], beside: Mapping[str, NDArray[Any]] | None = None
) -> Iterator[bytes]:
    """Yield the tables of states as one npz archive, some rows at a time, with other arrays beside them."""
    outlet = _Outlet()
    with ZipFile(outlet, "w", ZIP_DEFLATED, compresslevel=_FAST) as archive:
        for prefix, table in document.state_tables().items():
            for _ in _written(archive, prefix, _judged(table, checks) if checks else table):
                yield outlet.take()
        for name, array in (beside or {}).items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                npy.write_array(member, np.ascontiguousarray(array), allow_pickle=False)
            yield outlet.take()
    yield outlet.take()


def _judged(table: StateTable, checks: Sequence[Check]) -> StateTable:
    """Add which states make which conditions fail."""
    failed = [check for check in checks if not check.passed]
    conditions = np.array([check.condition for check in failed], dtype=np.str_)
    keys = [frozenset(finding.key for finding in check.failing) for check in failed]

    def rows(chosen: slice) -> Mapping[str, NDArray[Any]]:
        there = range(table.size)[chosen]
        fails = np.array([[table.keys(row) in failing for failing in keys] for row in there], dtype=np.bool_)
        added = {"fails": fails.reshape(len(there), len(failed)), "conditions": conditions}
        return {**table.rows(chosen), **added}

    return replace(table, rows=rows, episode_columns=(*table.episode_columns, "conditions"))


def _written(archive: ZipFile, prefix: str, table: StateTable) -> Iterator[None]:
    """Write the arrays of a table, pausing after some rows."""
    spans = [slice(start, start + _ROWS) for start in range(0, table.size, _ROWS)]
    for name, column in table.rows(slice(0, 0)).items():
        per_state = name not in table.episode_columns
        count = table.size if per_state else len(column)
        with archive.open(f"{prefix}{name}.npy", "w", force_zip64=True) as member:
            shape = (count, *column.shape[1:])
            npy.write_array_header_1_0(
                member,
                {"descr": npy.dtype_to_descr(column.dtype), "fortran_order": False, "shape": shape},
            )
            for rows in spans if per_state else spans[:1]:
                member.write(np.ascontiguousarray(table.rows(rows)[name]).tobytes())
                yield


class _Outlet:
    """A file that is only written to, and emptied now and then."""

    def __init__(self) -> None:
        self._parts: list[bytes] = []

    def write(self, data: bytes, /) -> int:
        """Take some bytes."""
        self._parts.append(bytes(data))
        return len(data)

    def flush(self) -> None:
        """Do nothing: there is nothing behind."""

    def close(self) -> None:
        """Do nothing: there is nothing behind."""

    def take(self) -> bytes:
        """Return what was written since the last time."""
        parts, self._parts = self._parts, []
        return b"".join(parts)
