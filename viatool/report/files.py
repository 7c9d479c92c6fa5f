"""Whole-or-nothing output files, and refusing a path before any long work is done for it."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from viatool.errors import ConfigurationError
from viatool.whole_file import whole_file


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


def _unwritable(path: Path, reason: str) -> ConfigurationError:
    return ConfigurationError(f"cannot write '{path}': {reason}", "choose a writable path")
