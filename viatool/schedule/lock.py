"""A folder in which one process works at a time."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from viatool.errors import ConfigurationError

LOCK = ".lock"
_TAKEN = (errno.EWOULDBLOCK, errno.EAGAIN, errno.EACCES, errno.EDEADLK)


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Make a folder and keep other processes out of it; the lock ends with the process, however it ends.

    On a file system without locks nobody is kept out.

    Raises
    ------
    ConfigurationError
        If another process holds it.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / LOCK).open("a+b") as stream:
        try:
            _lock(stream.fileno())
        except OSError as error:
            if error.errno in _TAKEN:
                raise ConfigurationError(
                    f"another viatool is working in {folder}", "wait for it, or choose another --output"
                ) from error
        yield


if os.name == "nt":  # pragma: no cover  # the other system's half

    def _lock(descriptor: int) -> None:
        import msvcrt

        msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined]

else:

    def _lock(descriptor: int) -> None:
        import fcntl

        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
