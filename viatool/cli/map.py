"""``viatool map``: what a map holds, and a picture of it."""

from __future__ import annotations

from pathlib import Path

import click

from viatool.cli import options
from viatool.cli.terminal import open_console


@click.command()
@click.argument("maps", metavar="MAP...", type=options.READABLE, nargs=-1, required=True)
@click.option(
    "--output",
    "-o",
    type=options.WRITABLE,
    metavar="FILE",
    help="Draw the one map and its scenarios (png, svg, pdf).",
)
def command(maps: tuple[Path, ...], output: Path | None) -> None:
    """Summarise each MAP, and draw it."""
    from viatool.report import print_map
    from viatool.world import load_map

    if output is not None and len(maps) > 1:
        raise click.UsageError("--output draws one map, and several were given")
    for path in maps:
        world_map = load_map(path)
        if output is not None:
            from viatool.report.map_figure import write_map_figure

            write_map_figure(world_map, output)
        print_map(world_map, open_console())
