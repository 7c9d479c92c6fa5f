"""The one place where an exception becomes an exit code and a message."""

from __future__ import annotations

import contextlib
import errno
import os
import re
import sys
import traceback
from collections.abc import Iterator

import click

from viatool.errors import EmptyEvaluationError, InputError, ViatoolError

PASSED = 0
GATE_FAILED = 1
UNUSABLE_INPUT = 2
INTERNAL_ERROR = 3
NOTHING_EVALUATED = 5
INTERRUPTED = 130
BROKEN_PIPE = 141

TRACEBACK_VARIABLE = "VIATOOL_TRACEBACK"
_EXTRA_OF_MODULE = {
    "torch": "train",
    "tensorboard": "train",
    "gymnasium": "train",
    "pybullet": "sim",
    "rosbags": "ros",
    "imageio_ffmpeg": "sim",
    "dask": "cluster",
    "distributed": "cluster",
    "bokeh": "html",
    "jinja2": "html",
}


class ReaderGone(Exception):  # noqa: N818  # nothing went wrong
    """Who reads the output has closed the pipe."""


@contextlib.contextmanager
def reader_may_go() -> Iterator[None]:
    """Call a closed pipe by a name of its own: click and rich would leave with 1, the code of a failed gate."""
    try:
        yield
    except BrokenPipeError as error:
        raise ReaderGone from error
    except SystemExit as left:
        if isinstance(left.__context__, BrokenPipeError):  # of a console of rich
            raise ReaderGone from left
        raise


def explain(error: BaseException) -> tuple[int, str]:
    """Translate an exception.

    Parameters
    ----------
    error : BaseException
        Whatever ended the command.

    Returns
    -------
    tuple of (int, str)
        The exit code of the contract, and what stderr shall say (nothing if empty).
    """
    if isinstance(error, KeyboardInterrupt | click.Abort):
        return INTERRUPTED, "interrupted"
    if isinstance(error, click.UsageError):
        return UNUSABLE_INPUT, _usage(error)
    if isinstance(error, click.ClickException):
        return UNUSABLE_INPUT, compose(error.format_message())
    if isinstance(error, EmptyEvaluationError):
        return NOTHING_EVALUATED, compose(error.message, error.hint)
    if isinstance(error, InputError):
        return UNUSABLE_INPUT, compose(error.message, error.hint)
    if isinstance(error, ViatoolError):
        _trace(error)
        return INTERNAL_ERROR, compose(error.message, error.hint)
    if isinstance(error, ModuleNotFoundError) and (error.name or "").split(".")[0] in _EXTRA_OF_MODULE:
        return UNUSABLE_INPUT, _missing_extra((error.name or "").split(".")[0])
    if isinstance(error, OSError):
        return _operating_system(error)
    if isinstance(error, ReaderGone):
        return _closed_pipe()
    return _internal(error)


def compose(message: str, hint: str = "") -> str:
    """Write a message the way every failure is written: ``error: ...`` and, below it, ``hint: ...``."""
    text = f"error: {message}\nhint: {hint}" if hint else f"error: {message}"
    # Names of files and fields come from others and shall not steer the terminal.
    text = "".join(character if character.isprintable() or character == "\n" else "?" for character in text)
    return re.sub(":(?=:)", ": ", text)  # nor give a command to a CI system that reads the log


def _usage(error: click.UsageError) -> str:
    message = error.format_message()
    command = error.ctx.command_path if error.ctx else "viatool"
    return compose(message, f"run '{command} --help' for the options")


def _missing_extra(module: str) -> str:
    extra = _EXTRA_OF_MODULE[module]
    return compose(
        f"this command needs the Python package '{module}', which the base install leaves out",
        f"run pip install 'viatool[{extra}]', or from a checkout pip install '.[{extra}]'",
    )


def _closed_pipe() -> tuple[int, str]:
    """Give the interpreter's last flush somewhere to go, for the reader has gone."""
    with contextlib.suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return BROKEN_PIPE, ""


def _operating_system(error: OSError) -> tuple[int, str]:
    if error.errno == errno.EPIPE:
        return _closed_pipe()
    name = f"{error.filename}: " if error.filename else ""
    return UNUSABLE_INPUT, compose(f"{name}{error.strerror or error}", "check the path and its permissions")


def _trace(error: BaseException) -> None:
    """Print where an error comes from, when that is asked for."""
    if os.environ.get(TRACEBACK_VARIABLE):
        traceback.print_exception(error)


def _internal(error: BaseException) -> tuple[int, str]:
    _trace(error)
    text = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
    return INTERNAL_ERROR, compose(
        f"internal error: {text}", f"set {TRACEBACK_VARIABLE}=1, run again and report the traceback as a bug"
    )
