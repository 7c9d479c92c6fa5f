"""The folder of a project's outputs: one folder for each cell, which is there whole or not at all."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from pydantic import ValidationError

from viatool.errors import ConfigurationError
from viatool.projects.records import CellRecord
from viatool.report.files import write_whole

RECORD = "cell.json"
LOG = "log.txt"
SUMMARY = "summary.json"
PAGE = "index.html"
_IGNORED = b"# Made by viatool run.\n*\n"


@dataclass(frozen=True)
class Results:
    """The folder.

    Parameters
    ----------
    path : Path
        Made when it is missing.
    """

    path: Path

    def open(self) -> None:
        """Make the folder, and clear what an interrupted run left half done.

        Raises
        ------
        ConfigurationError
            If it cannot be written.
        """
        try:
            shutil.rmtree(self._drafts, ignore_errors=True)
            self._drafts.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ConfigurationError(
                f"cannot write into '{self.path}': {error.strerror}",
                "choose another folder with --output DIR",
            ) from error
        write_whole(self.path / ".gitignore", _IGNORED)

    def close(self) -> None:
        """Remove what is of use only while cells are run."""
        shutil.rmtree(self._drafts, ignore_errors=True)
        with suppress(OSError):  # as long as something is in it, it stays
            (self.path / "unfinished").rmdir()

    @property
    def _drafts(self) -> Path:
        return self.path / ".drafts"

    def cell(self, name: str) -> Path:
        """Return the folder of a finished cell."""
        return self.path / "cells" / name

    def unfinished(self, inputs: str) -> Path:
        """Return where a cell with these inputs keeps its work while it is not finished."""
        return self.path / "unfinished" / inputs[:16]

    def draft(self) -> Path:
        """Return a new folder for a cell that is run."""
        return Path(tempfile.mkdtemp(dir=self._drafts))

    def publish(self, draft: Path, name: str) -> None:
        """Let a finished draft take the place of a cell's folder."""
        place = self.cell(name)
        place.parent.mkdir(parents=True, exist_ok=True)
        draft.chmod(0o755)
        if place.exists():
            place.rename(self._drafts / f"{draft.name}-before")
        draft.rename(place)
        shutil.rmtree(self._drafts / f"{draft.name}-before", ignore_errors=True)

    def record(self, name: str) -> CellRecord | None:
        """Return what is stored of a cell; None if nothing is, or its files are not whole."""
        try:
            text = (self.cell(name) / RECORD).read_text(encoding="utf-8")
            record = CellRecord.model_validate_json(text)
        except (OSError, ValidationError, UnicodeDecodeError):
            return None
        return record if all((self.path / file).exists() for file in record.reports.values()) else None


@contextmanager
def standing_in(folder: Path) -> Iterator[None]:
    """Let relative paths begin in a folder."""
    before = Path.cwd()
    os.chdir(folder)
    try:
        yield
    finally:
        os.chdir(before)
