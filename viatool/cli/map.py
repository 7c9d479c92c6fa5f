"""``viatool map``: what a map holds, and a picture of it."""

from __future__ import annotations

from pathlib import Path

import click

from viatool.cli import options
from viatool.cli.terminal import open_console


@click.command()
@click.argument("map_path", metavar="MAP", type=options.READABLE)
@click.option(
    "--output",
    "-o",
    type=options.WRITABLE,
    metavar="FILE",
    help="Draw the map and its scenarios (png, svg, pdf).",
)
def command(map_path: Path, output: Path | None) -> None:
    """Summarise MAP and draw it."""
    from viatool.report import print_map
    from viatool.world import load_map

    world_map = load_map(map_path)
    if output is not None:
        from viatool.report.map_figure import write_map_figure

        write_map_figure(world_map, output)
    print_map(world_map, open_console())
