"""``viatool map``: what a map holds, and a picture of it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from viatool.cli import options
from viatool.cli.command import Command
from viatool.cli.terminal import open_console

if TYPE_CHECKING:
    from viatool.world.map_file import Unknown


@click.command(cls=Command)
@click.argument("maps", metavar="MAP...", type=options.MAP, nargs=-1, required=True)
@click.option(
    "--output",
    "-o",
    type=options.WRITABLE,
    metavar="FILE",
    help="With one map: draw it and its scenarios (png, svg, pdf).",
)
@options.unknown_option
def command(maps: tuple[Path, ...], output: Path | None, unknown: Unknown | None) -> None:
    """Check and summarise each MAP (native or of a ROS 2 map_server), and draw it."""
    from viatool.report import print_map
    from viatool.world import unreachable_scenarios

    if output is not None and len(maps) > 1:
        raise click.UsageError("--output draws one map, but several were given")
    for path in maps:
        world_map = options.open_map(path, unknown)
        for number in unreachable_scenarios(world_map):
            name = world_map.scenarios[number].name
            options.warn(f"{path}: scenario '{name}': no path leads to the goal at the collision clearance")
        if output is not None:
            from viatool.report.map_figure import write_map_figure

            write_map_figure(world_map, output)
        print_map(world_map, open_console())
