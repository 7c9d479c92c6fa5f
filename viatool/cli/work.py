"""Options that say who does the work, and where it is kept in case it is cut short."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal, TypeVar

import click

from viatool.cli.options import WRITABLE

Command = TypeVar("Command", bound=Callable[..., Any])


class WorkersType(click.ParamType):  # type: ignore[type-arg]  # generic only in newer click
    """A number of processes, or ``auto``."""

    name = "workers"

    def get_metavar(self, param: click.Parameter, ctx: click.Context | None = None) -> str:
        """Show what may be written."""
        return "N|auto"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> int | Literal["auto"]:
        """Read one of both."""
        if value == "auto":
            return "auto"
        if isinstance(value, int) or (str(value).isdecimal() and int(value) > 0):
            return int(value)
        return self.fail(f"'{value}' is neither a number of workers of at least 1 nor auto", param, ctx)


def worker_options(what: str) -> Callable[[Command], Command]:
    """Return what adds the options of who does the work; `what` names the work that is shared out."""

    def add(command: Command) -> Command:
        workers = click.option(
            "--workers",
            type=WorkersType(),
            default=1,
            show_default=True,
            help=f"Processes that work on the {what}; auto takes one for each core. The result is the same.",
        )
        scheduler = click.option(
            "--scheduler",
            metavar="ADDRESS",
            help="Work on a Dask cluster instead: tcp://HOST:PORT, or its scheduler file (json).",
        )
        return workers(scheduler(command))

    return add


def work_options(command: Command) -> Command:
    """Add the options of long work."""
    checkpoint = click.option(
        "--checkpoint",
        type=WRITABLE,
        metavar="DIR",
        help="Keep finished states there, so that --resume can continue whatever ended the run.",
    )
    resume = click.option("--resume", is_flag=True, help="Continue from what --checkpoint keeps.")
    return worker_options("states")(checkpoint(resume(command)))


def _always(folder: Path) -> bool:
    return True


@contextmanager
def keeping(
    folder: Path | None,
    what: str = "finished states are",
    how: str = "--resume",
    holds: Callable[[Path], bool] = _always,
) -> Iterator[None]:
    """Say where finished work is kept, and how to go on with it, when the user interrupts it.

    Where a folder does not hold any yet, it says that instead.
    """
    try:
        yield
    except KeyboardInterrupt:
        if folder is not None and folder.is_dir():
            kept = f"{what} kept in '{folder}'; continue with {how}"
            nothing = f"nothing is saved yet in '{folder}'; {how} begins anew"
            click.echo(kept if holds(folder) else nothing, err=True)
        raise
