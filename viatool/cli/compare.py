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
@click.option(
    "--output",
    "-o",
    multiple=True,
    metavar="FORMAT:PATH",
    help="Write the comparison as markdown or html (a page that opens offline). Repeatable.",
)
@options.quiet_option
def command(before: Path, after: Path, output: tuple[str, ...], quiet: bool) -> None:
    """Show two reports of one kind, BEFORE and AFTER, side by side.

    What is the same in both, such as a scenario, is paired, and rates of what was drawn independently have an interval
    of their difference. State tables (npz) of verify are paired state by state where they hold the same poses, as of
    one recording.
    """
    from viatool.report import load_shown, print_comparison
    from viatool.report.compared import comparison_output, write_comparison

    outputs = [comparison_output(text) for text in output]
    old, new = load_shown(before), load_shown(after)
    write_comparison(old, new, outputs)
    if not quiet:
        print_comparison(old, new, open_console())
