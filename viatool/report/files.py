"""Whole-or-nothing output files and folders, and refusing a path before any long work is done for it."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeAlias

from viatool.errors import ConfigurationError
from viatool.whole_file import whole_file, whole_folder

Content: TypeAlias = str | bytes | Iterable[str] | Iterable[bytes]
"""What a file holds, whole or in parts; text is written as UTF-8."""

MANIFEST = "manifest.json"
"""In every folder that is written: size and sha256 of each of its other files."""
SCHEMA_VERSION = 1


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Give a temporary path that takes the place of `path` when the block succeeds.

    Parameters
    ----------
    path : Path
        The file to write.

    Yields
    ------
    Path
        A path in the same directory with the same suffix, for writers that look at the suffix.

    Raises
    ------
    ConfigurationError
        If the file cannot be written; nothing is left behind then, and an older file stays as it was.
    """
    check_writable(path)
    try:
        with whole_file(path) as draft:
            yield draft
    except OSError as error:
        raise _unwritable(path, error.strerror or str(error)) from error


def write_whole(path: Path, content: bytes | Iterable[bytes]) -> None:
    """Write a file, whole or not at all; its content may come in parts."""
    with replacing(path) as draft, draft.open("wb") as stream:
        stream.writelines([content] if isinstance(content, bytes) else content)


def check_writable(path: Path) -> None:
    """Refuse a path that cannot become a file.

    Raises
    ------
    ConfigurationError
        If the path is a directory, lies below a file, or may not be written.
    """
    if path.is_dir():
        raise _unwritable(path, "it is a directory")
    directory = next(folder for folder in path.absolute().parents if folder.exists())
    if not directory.is_dir():
        raise _unwritable(path, f"'{directory}' is not a directory")
    if not os.access(directory, os.W_OK) or (path.exists() and not os.access(path, os.W_OK)):
        raise _unwritable(path, "permission denied")


def as_bytes(content: Content) -> Iterator[bytes]:
    """Yield a content part by part, so that the files of long runs need not fit into memory."""
    for part in [content] if isinstance(content, str | bytes) else content:
        yield part if isinstance(part, bytes) else part.encode("utf-8", errors="backslashreplace")


def write_folder(path: Path, what: str, files: Mapping[str, Content]) -> None:
    """Write a folder with its manifest, whole or not at all.

    Parameters
    ----------
    path : Path
        Where it shall stand.
    what : str
        What the manifest says that it is: an older folder of the same is replaced.
    files : mapping
        Contents by name, with slashes between the parts of a name.

    Raises
    ------
    ConfigurationError
        If it cannot be written; an older folder stays as it was then.
    """
    check_folder(path, what)
    try:
        with whole_folder(path) as draft:
            listed = {name: _write_listed(draft / name, content) for name, content in files.items()}
            manifest = {"schema_version": SCHEMA_VERSION, "what": what, "files": listed}
            (draft / MANIFEST).write_text(json.dumps(manifest, indent=1) + "\n", encoding="utf-8")
    except OSError as error:
        raise _unwritable(path, error.strerror or str(error)) from error


def _write_listed(path: Path, content: Content) -> dict[str, Any]:
    """Write one file, and return what the manifest says of it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    digest, size = hashlib.sha256(), 0
    with path.open("wb") as stream:
        for part in as_bytes(content):
            stream.write(part)
            digest.update(part)
            size += len(part)
    return {"sha256": digest.hexdigest(), "bytes": size}


def check_folder(path: Path, what: str) -> None:
    """Refuse a path that cannot become a folder of something, or would take with it what is not of an older one.

    Raises
    ------
    ConfigurationError
        If the path is a file, may not be written, or is a folder with files that its manifest does not list.
    """
    if not path.is_dir():
        check_writable(path)
        if path.exists():
            raise _unwritable(path, "it is a file, and a folder is written")
        return
    check_writable(path / MANIFEST)
    there = {file.relative_to(path).as_posix() for file in path.rglob("*") if not file.is_dir()}
    foreign = sorted(there - _listed(path, what))
    if foreign:
        named = f"'{foreign[0]}'" + (f" and {len(foreign) - 1} other files" if len(foreign) > 1 else "")
        raise ConfigurationError(
            f"cannot write '{path}': it holds {named}, which are not of an older {what} folder",
            "choose a folder that is empty or does not exist yet",
        )


def _listed(path: Path, what: str) -> set[str]:
    """Return the files that the manifest of a folder of something lists, itself included; none of other folders."""
    try:
        manifest = json.loads((path / MANIFEST).read_text(encoding="utf-8"))
        return {MANIFEST, *manifest["files"]} if manifest["what"] == what else set()
    except (OSError, ValueError, KeyError, TypeError):
        return set()


def _unwritable(path: Path, reason: str) -> ConfigurationError:
    return ConfigurationError(f"cannot write '{path}': {reason}", "choose a writable path")
