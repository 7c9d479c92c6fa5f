"""Files and folders that appear whole or not at all."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def whole_file(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Give a temporary path beside `path` that takes its place when the block ends without an exception.

    Parameters
    ----------
    path : path
        Where the finished file shall stand. Its folder is made when it is missing.

    Yields
    ------
    Path
        A path with the same suffix in the same folder, to be written by the caller.

    Notes
    -----
    The replacement is one rename within a folder, so a reader sees the old file or the new one, never a part.
    When the block raises, the temporary file is removed and an older file at `path` stays as it was.
    """
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    descriptor, name = tempfile.mkstemp(prefix=f".{target.stem}-", suffix=target.suffix, dir=target.parent)
    os.close(descriptor)
    draft = Path(name)
    try:
        yield draft
        draft.chmod(_usual_mode(target))
        draft.replace(target)
    finally:
        draft.unlink(missing_ok=True)


def remove_drafts(folder: str | os.PathLike[str]) -> None:
    """Remove what killed processes left of their drafts in a folder; nobody else may be writing there."""
    for draft in Path(folder).glob(".*-????????.*"):
        draft.unlink(missing_ok=True)


def _usual_mode(target: Path) -> int:
    """Return the permissions that `target` has, or that a plain `open` would have given it."""
    if target.exists():
        return target.stat().st_mode & 0o777
    return 0o666 & ~_umask()


def _umask() -> int:
    """Return which permissions new files do not get."""
    umask = os.umask(0)
    os.umask(umask)
    return umask


@contextmanager
def whole_folder(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Give a temporary folder beside `path` that takes its place when the block ends without an exception.

    Parameters
    ----------
    path : path
        Where the finished folder shall stand; what is there goes away then, so let it be looked at before.

    Yields
    ------
    Path
        An empty folder, to be filled by the caller.

    Notes
    -----
    Both renames are within one folder. When the block raises, an older folder stays as it was.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    draft = Path(tempfile.mkdtemp(prefix=f".{path.name}.", dir=path.parent))
    try:
        yield draft
        draft.chmod(0o777 & ~_umask())
        _take_place(draft, path)
    except BaseException:
        shutil.rmtree(draft, ignore_errors=True)
        raise


def _take_place(draft: Path, path: Path) -> None:
    """Put a folder in the place of another, which is put back if that fails."""
    if not path.exists():
        draft.rename(path)
        return
    aside = Path(tempfile.mkdtemp(prefix=f".{path.name}.", dir=path.parent))
    older = path.rename(aside / path.name)
    try:
        draft.rename(path)
    except BaseException:
        older.rename(path)
        raise
    shutil.rmtree(aside, ignore_errors=True)
