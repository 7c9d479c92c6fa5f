"""``viatool compare``: two stored reports side by side."""

from __future__ import annotations

from pathlib import Path

import click

from viatool.cli import options
from viatool.cli.command import Command
from viatool.cli.terminal import open_console


@click.command(cls=Command)
@click.argument("before", type=options.READABLE)
@click.argument("after", type=options.READABLE)
def command(before: Path, after: Path) -> None:
    """Show two reports in JSON of one kind, BEFORE and AFTER, side by side."""
    from viatool.report import load_document, print_comparison

    print_comparison(load_document(before), load_document(after), open_console())
