"""``--verbose`` of every command: what is read, decided and done, with the seconds since it began, on stderr."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from viatool.cli.started import seconds_since_start

if TYPE_CHECKING:
    from logging import LogRecord


def verbose_option() -> click.Option:
    """Return the option; it acts by itself, so that no command has to know of it."""
    return click.Option(
        ["--verbose"],
        is_flag=True,
        is_eager=True,
        expose_value=False,
        callback=_tell_everything,
        help="Say on stderr what is read, which engine runs, why it was chosen, and how long every stage takes.",
    )


def _tell_everything(ctx: click.Context, param: click.Parameter, wanted: bool) -> None:
    """Print the notes of all rooms until the command ends."""
    if not wanted or ctx.resilient_parsing:
        return
    import logging

    class Notes(logging.Handler):
        """Writes each note in a line, as far as stderr is what it was."""

        def emit(self, record: LogRecord) -> None:
            """Write a note."""
            _write(record.getMessage())

    notes, own = Notes(), logging.getLogger("viatool")
    before = own.level
    own.addHandler(notes)
    own.setLevel(logging.INFO)

    def leave() -> None:
        _write(_spent())
        own.removeHandler(notes)
        own.setLevel(before)

    ctx.call_on_close(leave)


def _write(text: str) -> None:
    from viatool.report.foreign import shown

    click.echo(f"[{seconds_since_start():7.2f} s] {shown(text)}", err=True)


def _spent() -> str:
    """Return what the command took, in words."""
    import sys
    import time

    try:
        import resource
    except ImportError:  # not on Windows
        return f"done: {time.process_time():.2f} s of the processor"
    unit = 2**20 if sys.platform == "darwin" else 2**10  # bytes there, kilobytes elsewhere
    largest = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit
    return f"done: {time.process_time():.2f} s of the processor, at most {largest:,.0f} MB of memory"
