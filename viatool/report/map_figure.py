"""A picture of a map and its scenarios."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from matplotlib.figure import Figure

from viatool.errors import ConfigurationError
from viatool.report.drawing import FAINT, INK, draw_floor, draw_obstacles, draw_task
from viatool.report.files import replacing
from viatool.report.foreign import one_line
from viatool.report.numbers import counted

if TYPE_CHECKING:
    from viatool.world import WorldMap

SUFFIXES = (".png", ".svg", ".pdf")


def draw_map(world_map: WorldMap) -> Figure:
    """Draw the arena, the obstacles and every fixed scenario; a scenario's own obstacles faintly."""
    figure = Figure(figsize=(7.0, 7.2), layout="constrained")
    axes = figure.add_subplot()
    draw_floor(axes, world_map)
    for scenario in world_map.scenarios:
        draw_obstacles(axes, scenario.obstacles, facecolor="none", edgecolor=FAINT)
        start, goal = scenario.start[:2], scenario.goal
        axes.plot(*zip(start, goal, strict=True), color=INK, lw=0.6, ls=(0, (1, 3)), zorder=3)
        draw_task(axes, scenario)
    grid = world_map.obstacles.grid
    what = [counted(len(world_map.obstacles), "obstacle")] if len(world_map.obstacles) or grid is None else []
    if grid is not None:
        what.append(f"{grid.cells.shape[1]} x {grid.cells.shape[0]} cells")
    title = f"{world_map.name}: {', '.join([*what, counted(len(world_map.scenarios), 'scenario')])}"
    axes.set_title(one_line(title).replace("$", r"\$"), fontsize=10, color=INK)
    axes.set(xlabel="x [m]", ylabel="y [m]")
    return figure


def write_map_figure(world_map: WorldMap, path: Path) -> None:
    """Write the picture of a map as png, svg or pdf."""
    if path.suffix.lower() not in SUFFIXES:
        raise ConfigurationError(f"'{path}' ends in '{path.suffix}'", f"end it in {' or '.join(SUFFIXES)}")
    with replacing(path) as draft:
        draw_map(world_map).savefig(draft, dpi=160)
