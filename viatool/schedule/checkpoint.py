"""Finished pieces of a run in a folder, from which the run continues after whatever ended it."""

from __future__ import annotations

import json
import os
import re
import zipfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viatool.errors import ConfigurationError
from viatool.schedule.pieces import Span
from viatool.whole_file import whole_file

Arrays = Mapping[str, NDArray[Any]]

MANIFEST = "manifest.json"
SCHEMA_VERSION = 1
_FINISHED = re.compile(r"units-(\d+)-(\d+)\.npz")


class Checkpoint:
    """A folder with a manifest, which says what run it is of, and one file for each finished piece.

    Parameters
    ----------
    folder : path
        Made when it is missing.
    run : mapping
        What the answers depend on, by name; plain data for JSON.
    resume : bool
        Whether finished pieces of the same run are wanted. A folder that is empty so far is fine either way.

    Raises
    ------
    ConfigurationError
        If the folder holds pieces of another run, or of the same one without `resume`, or cannot be used.

    Notes
    -----
    Every file is written whole and then renamed, so a kill at any moment leaves finished pieces alone. A file that
    was damaged later is told by its checksums and counts as missing.
    """

    def __init__(self, folder: str | os.PathLike[str], run: Mapping[str, Any], *, resume: bool) -> None:
        self.folder = Path(folder)
        manifest = self.folder / MANIFEST
        described = json.loads(json.dumps({"schema_version": SCHEMA_VERSION, "run": dict(run)}))
        try:
            if manifest.is_file():
                self._check(manifest, described["run"], resume=resume)
                return
            if self.folder.is_dir() and any(_FINISHED.fullmatch(path.name) for path in self.folder.iterdir()):
                raise ConfigurationError(
                    f"the checkpoint '{self.folder}' has lost its {MANIFEST}", "give a new folder"
                )
            with whole_file(manifest) as draft:
                draft.write_text(json.dumps(described, indent=2) + "\n", encoding="utf-8")
        except OSError as error:
            raise ConfigurationError(
                f"cannot use the folder '{self.folder}' for a checkpoint: {error.strerror or error}",
                "choose a writable folder",
            ) from error

    def _check(self, manifest: Path, run: Mapping[str, Any], *, resume: bool) -> None:
        """Refuse the manifest of another run."""
        try:
            stored = json.loads(manifest.read_text(encoding="utf-8"))
            before = stored["run"] if stored["schema_version"] == SCHEMA_VERSION else {}
            names = [name for name in {**before, **run} if before.get(name) != run.get(name)]
        except (ValueError, TypeError, KeyError, AttributeError) as error:
            raise ConfigurationError(
                f"'{manifest}' is not the manifest of a checkpoint", "give a new folder"
            ) from error
        if names:
            listed = "; ".join(
                f"{name} was {_short(before.get(name))}, is {_short(run.get(name))}" for name in names
            )
            raise ConfigurationError(
                f"the checkpoint '{self.folder}' belongs to another run: {listed}",
                "repeat the options of that run, or give a new folder",
            )
        if not resume:
            raise ConfigurationError(
                f"the folder '{self.folder}' holds a checkpoint of this run",
                "continue it with --resume, or give a new folder",
            )

    def finished(
        self, wanted: Callable[[Span], bool] = lambda span: True
    ) -> Iterator[tuple[Span, dict[str, NDArray[Any]]]]:
        """Yield the wanted ones of the pieces that are finished, in their order, without any unit twice."""
        spans = {}
        for path in self.folder.iterdir():
            named = _FINISHED.fullmatch(path.name)
            if named:
                spans[Span(int(named[1]), int(named[2]))] = path
        reached = 0
        for span in sorted(filter(wanted, spans)):
            arrays = _read(spans[span]) if span.first >= reached else None
            if arrays is not None:
                reached = span.last
                yield span, arrays

    def write(self, span: Span, arrays: Arrays, name: str) -> None:
        """Store a finished piece.

        Raises
        ------
        ConfigurationError
            If it cannot be written, as when the disk is full; names the piece.
        """
        try:
            with whole_file(self.folder / f"units-{span.first:08d}-{span.last:08d}.npz") as draft:
                np.savez(draft, allow_pickle=False, **arrays)
        except OSError as error:
            raise ConfigurationError(
                f"{name}: cannot be stored in the checkpoint '{self.folder}': {error.strerror or error}",
                "make room and continue with --resume; what was stored before is kept",
            ) from error


def _read(path: Path) -> dict[str, NDArray[Any]] | None:
    """Return the arrays of a piece; None if the file is damaged."""
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}
    except (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile):
        return None


def _short(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= 60 else f"{text[:28]} ... {text[-28:]}"
