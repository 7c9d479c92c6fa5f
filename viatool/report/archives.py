"""Archives of arrays that hold the report they belong to, so that one file tells all: states, cells and tubes (npz)."""

from __future__ import annotations

import json
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viatool.errors import ConfigurationError
from viatool.report.document import Document

BESIDE = "run."
"""What stands before the names of arrays that are not of the table itself."""
_REPORT, _ASKED = f"{BESIDE}report", f"{BESIDE}asked"
_DAMAGE = (OSError, EOFError, ValueError, KeyError, zipfile.BadZipFile, zlib.error, NotImplementedError)


def as_array(content: Mapping[str, Any]) -> NDArray[np.uint8]:
    """Return plain data as the bytes of its JSON: an npz holds them without objects."""
    return np.frombuffer(json.dumps(content, allow_nan=False).encode("utf-8"), dtype=np.uint8)


def report_beside(document: Document) -> dict[str, NDArray[Any]]:
    """Return the array by which an archive holds the report that it belongs to."""
    return {_REPORT: as_array(document.content)}


def npz_of(document: Document, table: Mapping[str, NDArray[Any]]) -> bytes:
    """Return an archive of a table that fits into memory, with its report."""
    buffer = BytesIO()
    np.savez_compressed(buffer, **table, **report_beside(document))  # type: ignore[arg-type]  # names, no options
    return buffer.getvalue()


@dataclass(frozen=True)
class Archive:
    """An npz that some ``--output`` wrote.

    Parameters
    ----------
    path : Path
        Where it is.
    report : mapping
        The report JSON in it.
    asked : mapping
        What was asked, where it holds that; else empty.
    """

    path: Path
    report: Mapping[str, Any]
    asked: Mapping[str, Any]

    def arrays(self) -> tuple[dict[str, NDArray[Any]], dict[str, NDArray[Any]]]:
        """Return the arrays of the table, and those beside it by their names behind `BESIDE`.

        Raises
        ------
        ConfigurationError
            If one cannot be read.
        """
        try:
            with self.path.open("rb") as stream, np.load(stream, allow_pickle=False) as archive:
                every = {name: archive[name] for name in archive.files if name not in (_REPORT, _ASKED)}
        except _DAMAGE as error:
            raise _damaged(self.path, error) from error
        beside = {name.removeprefix(BESIDE): own for name, own in every.items() if name.startswith(BESIDE)}
        return {name: own for name, own in every.items() if not name.startswith(BESIDE)}, beside


def is_archive(path: Path) -> bool:
    """Tell by its first bytes whether a file is an archive; False if it cannot be read."""
    try:
        with path.open("rb") as stream:
            return stream.read(2) == b"PK"
    except OSError:
        return False


def load_archive(path: Path) -> Archive:
    """Read which report an archive holds.

    Raises
    ------
    ConfigurationError
        If it is damaged, or holds no report.
    """
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as archive:
            if _REPORT not in archive.files:
                raise _without_report(path, archive.files)
            report = json.loads(archive[_REPORT].tobytes())
            asked = json.loads(archive[_ASKED].tobytes()) if _ASKED in archive.files else {}
    except _DAMAGE as error:
        raise _damaged(path, error) from error
    if not isinstance(report, dict):
        raise _damaged(path, ValueError("its report is not an object"))
    return Archive(path, report, asked)


def _damaged(path: Path, error: Exception) -> ConfigurationError:
    return ConfigurationError(
        f"'{path}' is cut off or damaged: {error}", "write it again with --output, or give the report in JSON"
    )


def _without_report(path: Path, names: list[str]) -> ConfigurationError:
    listed = ", ".join(names[:6]) + (", ..." if len(names) > 6 else "")
    return ConfigurationError(
        f"'{path}' holds no report (arrays {listed}): another program or an older viatool wrote it",
        "write it again with --output states:PATH.npz, cells:PATH.npz or tube:PATH.npz, or give the report in JSON",
    )
