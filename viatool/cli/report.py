"""``viatool report``: a stored report in other formats."""

from __future__ import annotations

from pathlib import Path

import click

from viatool.cli import options
from viatool.cli.command import Command
from viatool.cli.reporting import read_outputs, tell


@click.command(cls=Command)
@click.argument("report", type=options.READABLE)
@click.option(
    "--output",
    "-o",
    multiple=True,
    metavar="FORMAT:PATH",
    help="Write the report in another format: json or markdown; of a certificate also github; of a simulation and "
    "of margins also csv, junit, sarif and github; of margins also figure and html. PATH - is stdout. Repeatable.",
)
@options.quiet_option
def command(report: Path, output: tuple[str, ...], quiet: bool) -> None:
    """Show REPORT, a report in JSON that verify, certify, mission, margin or simulate wrote.

    Formats that need more than the JSON holds are written by the command that wrote the report.
    """
    from viatool.report import load_document

    document = load_document(report)
    outputs = read_outputs(output, type(document))
    tell(document, outputs, (), quiet=quiet)
