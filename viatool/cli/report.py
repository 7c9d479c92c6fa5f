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
    "--map",
    "map_path",
    type=options.MAP,
    metavar="FILE",
    help="The map of a state table, if it is elsewhere now.",
)
@click.option(
    "--output",
    "-o",
    multiple=True,
    metavar="FORMAT:PATH",
    help="Write the report in another format. Of a state table every format of verify but evidence; of a report in "
    "JSON json, markdown, html and gate, of missions and margins also csv, junit, sarif and github, of margins also "
    "figure. PATH - is stdout. Repeatable.",
)
@options.quiet_option
def command(report: Path, map_path: Path | None, output: tuple[str, ...], quiet: bool) -> None:
    """Show REPORT, a stored report, or write it in other formats.

    REPORT is one in JSON that verify, certify, mission, margin, simulate or doctor wrote, or a state table (npz) of
    verify, from which pages, pictures and everything else that verify writes can be made. Arrays of cells, tubes and
    margins (npz) hold their report as well.
    """
    from viatool.report import load_shown

    document = load_shown(report, map_path)
    outputs = read_outputs(output, type(document))
    tell(document, outputs, (), quiet=quiet)
