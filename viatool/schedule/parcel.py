"""The function that workers carry out, on its way to them: pickled once, opened once by each process."""

from __future__ import annotations

import hashlib
import os
import pickle
import platform
import sys
import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, TypeVar

from threadpoolctl import threadpool_limits

from viatool.errors import ConfigurationError, ViatoolError, WorkError
from viatool.schedule.pieces import Piece
from viatool.schedule.progress import Tell, telling
from viatool.versions import result_versions, version_of

Answer = TypeVar("Answer")

_MOST_OPEN = 4
_opened: dict[str, Callable[[Any], Any]] = {}
_lock = threading.Lock()


def numeric_threads() -> int:
    """Return how many threads the numeric libraries may use in one worker: what the user says, else 1.

    Workers fill the cores already, and the order in which several threads sum may change the last digit.
    """
    text = os.environ.get("OMP_NUM_THREADS", "")
    return int(text) if text.isdecimal() and int(text) > 0 else 1


_WHERE_USED = ("torch", "pybullet")  # by some kinds of work alone


def decisive_versions() -> dict[str, str]:
    """Return the versions in which two processes must agree to compute the same."""
    found = result_versions()
    major, minor, *_ = found["python"].split(".")
    others = {name: version_of(name) for name in ("scipy", *_WHERE_USED)}
    return {**found, "python": f"{major}.{minor}", **others}


def needed_versions() -> dict[str, str]:
    """Return those of them on which the work of this process depends, by what is imported so far."""
    return {
        name: text
        for name, text in decisive_versions().items()
        if name not in _WHERE_USED or name in sys.modules
    }


def describe_mismatch(here: dict[str, str], there: dict[str, str]) -> str:
    """Say in which versions another process differs; nothing if in none."""
    return ", ".join(
        f"{name} {there.get(name, 'missing')} instead of {wanted}"
        for name, wanted in here.items()
        if there.get(name) != wanted
    )


@dataclass(frozen=True)
class Parcel:
    """A function in a form that other processes can open.

    Parameters
    ----------
    content : bytes
        The pickled function.
    digest : str
        Of the content.
    versions : dict
        With which it was packed.
    threads : int
        Of the numeric libraries, in each process.
    """

    content: bytes
    digest: str
    versions: dict[str, str]
    threads: int

    @classmethod
    def of(cls, work: Callable[[Any], Any]) -> Parcel:
        """Pack a function."""
        content = pickle.dumps(work, protocol=5)
        return cls(content, hashlib.sha256(content).hexdigest(), needed_versions(), numeric_threads())

    def label(self) -> Parcel:
        """Return the parcel without its content, for processes that have opened it."""
        return replace(self, content=b"")

    def open(self) -> Callable[[Any], Any]:
        """Return the function; what it keeps between calls (such as sessions) lives as long as the process.

        Raises
        ------
        ConfigurationError
            If this process has other versions.
        """
        with _lock:
            if self.digest not in _opened:
                differing = describe_mismatch(self.versions, decisive_versions())
                if differing:
                    raise ConfigurationError(
                        f"a worker on {platform.node()} has {differing}",
                        "install the same versions on the workers as here",
                    )
                while len(_opened) >= _MOST_OPEN:
                    del _opened[next(iter(_opened))]
                _opened[self.digest] = pickle.loads(self.content)
            return _opened[self.digest]


def carry_out(parcel: Parcel, content: Any, tell: Tell) -> Any:
    """Do one piece of work in a worker's process.

    An error that viatool raises on purpose is the answer, not an accident: it is returned, for schedulers try again
    what raises.
    """
    try:
        work = parcel.open()
        threadpool_limits(limits=parcel.threads)  # of all that is loaded by now, in the thread that works
        with telling(tell):
            return work(content)
    except ViatoolError as error:
        return error


def checked(piece: Piece[Any], answer: Answer | ViatoolError) -> Answer:
    """Return an answer; an error is raised with the name of the piece."""
    if isinstance(answer, ViatoolError):
        raise type(answer)(f"{piece.name}: {answer.message}", answer.hint) from answer
    return answer


def failure(piece: Piece[Any], error: BaseException) -> WorkError:
    """Return what to raise when work ended with an exception that nobody raises on purpose."""
    if isinstance(error, MemoryError):
        return WorkError(f"{piece.name}: out of memory", "use fewer workers, or a machine with more memory")
    return WorkError(
        f"{piece.name}: internal error: {type(error).__name__}: {error}",
        "set VIATOOL_TRACEBACK=1, run again and report the traceback as a bug",
    )
