"""What the figures of pages are made of: canvases, sources that the page's script fills, worlds and robots.

Sources that the script fills have names. A model's tags say which of its properties take a colour of the page's theme,
so that light and dark are decided in the style sheet alone.
"""

from __future__ import annotations

from base64 import b64encode
from io import BytesIO
from typing import TYPE_CHECKING, Any

import numpy as np
from bokeh.models import (
    BoxZoomTool,
    ColumnDataSource,
    PanTool,
    Range1d,
    ResetTool,
    SaveTool,
    WheelZoomTool,
)
from bokeh.plotting import figure

from viatool.report.occupancy import darkest

if TYPE_CHECKING:
    from viatool.world import Obstacles, OccupancyGrid, WorldMap

_MARGIN = 0.25  # metres of wall that are shown around the arena


def themed(model: Any, **colours: str) -> Any:
    """Let a property of a model follow the theme: ``themed(glyph, fill_color="wall")``."""
    model.tags = [*model.tags, {"theme": colours}]
    return model


def map_canvas(world_map: WorldMap) -> figure:
    """Return the map of the whole run, with what stands on it."""
    x_min, y_min, x_max, y_max = world_map.bounds
    plot = bare(
        "map",
        x_range=Range1d(x_min - _MARGIN, x_max + _MARGIN),
        y_range=Range1d(y_min - _MARGIN, y_max + _MARGIN),
        aspect_ratio=float(np.clip((x_max - x_min) / (y_max - y_min), 0.6, 2.0)),
        tools=[PanTool(), WheelZoomTool(), BoxZoomTool(match_aspect=True), ResetTool(), SaveTool()],
    )
    draw_world(plot, world_map)
    return plot


def situation_figure(world_map: WorldMap) -> figure:
    """Return the surroundings of one state or place: obstacles, what the robot sweeps, and the distances around it."""
    plot = bare(
        "situation",
        x_range=Range1d(-1.0, 1.0),
        y_range=Range1d(-1.0, 1.0),
        aspect_ratio=1.0,
        tools=[PanTool(), WheelZoomTool(), SaveTool()],
    )
    draw_world(plot, world_map)
    for name, colour, alpha in (("danger-tube", "halo", 0.22), ("collision-tube", "unsafe", 0.25)):
        tube = plot.patch("x", "y", source=source(name, "x y"), line_width=1.2, fill_alpha=alpha)
        themed(tube.glyph, fill_color=colour, line_color=colour)
    swept = plot.patch("x", "y", source=source("swept", "x y"), fill_alpha=0.75, line_color=None)
    themed(swept.glyph, fill_color="here")
    arcs = plot.multi_line("x", "y", source=source("arcs", "x y"), line_width=1.0)
    themed(arcs.glyph, line_color="ink")
    ends = plot.scatter("x", "y", source=source("arc-ends", "x y"), size=4)
    themed(ends.glyph, fill_color="ink", line_color="ink")
    counter = plot.line("x", "y", source=source("witness-path", "x y"), line_width=3.0)
    themed(counter.glyph, line_color="unsafe")
    closest = plot.scatter("x", "y", source=source("witness-pose", "x y"), marker="x", size=13, line_width=3)
    themed(closest.glyph, line_color="unsafe")
    draw_robot(plot)
    gap = plot.line("x", "y", source=source("gap", "x y"), line_width=1.5, line_dash=[5, 3])
    themed(gap.glyph, line_color="ink")
    bar = plot.line("x", "y", source=source("scale-bar", "x y"), line_width=3)
    themed(bar.glyph, line_color="ink")
    _label(plot, "scale-text")
    boxed = _label(plot, "gap-text")
    boxed.update(background_fill_alpha=0.85, padding=2, text_baseline="middle", text_font_style="bold")
    themed(boxed, background_fill_color="floor")
    return plot


def _label(plot: figure, name: str) -> Any:
    """Return the glyph of a text that the page's script places."""
    text = plot.text("x", "y", "text", source=source(name, "x y text"), text_align="center")
    text.glyph.update(text_font_size="12px", text_baseline="bottom")
    return themed(text.glyph, text_color="ink")


def draw_fan(plot: figure) -> None:
    """Draw what the LiDAR reads at the pose that is looked at."""
    fan = plot.wedge(
        "x", "y", "radius", "start", "end", source=source("fan", "x y radius start end"), level="overlay"
    )
    themed(fan.glyph, fill_color="fan", line_color="fan")
    fan.glyph.update(fill_alpha=0.25, line_alpha=0.7, line_width=0.6)


def draw_goal(plot: figure) -> None:
    """Mark the goal."""
    goal = plot.scatter("x", "y", source=source("goal", "x y"), marker="star", size=15, level="overlay")
    themed(goal.glyph, fill_color="goal", line_color="ink")


def draw_here(plot: figure) -> None:
    """Mark the pose that is looked at."""
    here = plot.scatter("x", "y", source=source("here", "x y"), size=20, level="overlay")
    here.glyph.update(line_width=1.5, fill_alpha=0.0)
    themed(here.glyph, line_color="ink")


def bare(name: str, **settings: Any) -> figure:
    """Return a figure without axes, on walls."""
    plot = figure(
        name=name,
        sizing_mode="stretch_width",
        toolbar_location="right",
        toolbar_inner=True,
        min_border=0,
        border_fill_alpha=0.0,
        outline_line_color=None,
        **settings,
    )
    plot.axis.visible = False
    plot.grid.visible = False
    plot.toolbar.update(logo=None, autohide=True, active_scroll=None)
    return themed(plot, background_fill_color="wall")


def framed(name: str, across: str, up: str, *, height: int) -> figure:
    """Return a figure with axes, without tools."""
    plot = figure(
        name=name,
        sizing_mode="stretch_width",
        height=height,
        x_axis_label=across,
        y_axis_label=up,
        tools="",
        toolbar_location=None,
        background_fill_alpha=0.0,
        border_fill_alpha=0.0,
        outline_line_color=None,
        min_border_right=14,
    )
    for axis in plot.axis:
        axis.axis_label_text_font_style = "normal"
        axis.major_label_text_font_size = axis.axis_label_text_font_size = "12px"
        themed(
            axis,
            **dict.fromkeys(
                (
                    "axis_label_text_color",
                    "major_label_text_color",
                    "axis_line_color",
                    "major_tick_line_color",
                ),
                "quiet",
            ),
        )
        axis.minor_tick_line_color = None
    for grid in plot.grid:
        themed(grid, grid_line_color="rule")
    return plot


def source(name: str, columns: str) -> ColumnDataSource:
    """Return an empty source that the page's script finds by its name."""
    return ColumnDataSource({column: [] for column in columns.split()}, name=f"{name}-source")


def draw_world(plot: figure, world_map: WorldMap) -> None:
    """Draw the arena, the map's obstacles, and those that the page's script adds for an episode."""
    arena = plot.patch(*world_map.arena.T, line_width=1.0)
    themed(arena.glyph, fill_color="floor", line_color="ink")
    if world_map.obstacles.grid is not None:
        _draw_cells(plot, world_map.obstacles.grid)
    draw_obstacles(plot, world_map.obstacles)
    name = plot.name
    circles = plot.circle("x", "y", radius="radius", source=source(f"{name}-circles", "x y radius"))
    polygons = plot.patches("x", "y", source=source(f"{name}-polygons", "x y"))
    for added in (circles, polygons):
        themed(added.glyph, fill_color="wall", line_color="ink")


def draw_obstacles(plot: figure, obstacles: Obstacles) -> None:
    """Draw circles and polygons."""
    x, y, radius = obstacles.circles.T
    drawn = [plot.circle(x, y, radius=radius)]
    drawn.append(plot.patches([p[:, 0] for p in obstacles.polygons], [p[:, 1] for p in obstacles.polygons]))
    for shape in drawn:
        themed(shape.glyph, fill_color="wall", line_color="ink")


def _draw_cells(plot: figure, grid: OccupancyGrid) -> None:
    """Draw an occupancy grid as one picture, in two greys that stand out on light and on dark floors."""
    from PIL import Image

    kinds, block = darkest(grid.cells)
    shades = np.array([(0, 0, 0, 0), (90, 98, 107, 255), (150, 157, 165, 110)], dtype=np.uint8)
    content = BytesIO()
    Image.fromarray(shades[kinds[::-1]]).save(content, format="PNG", optimize=True)
    x, y, yaw = grid.origin
    side = grid.resolution * block
    plot.image_url(
        url=["data:image/png;base64," + b64encode(content.getvalue()).decode("ascii")],
        x=x,
        y=y,
        w=side * kinds.shape[1],
        h=side * kinds.shape[0],
        angle=yaw,
        anchor="bottom_left",
    )


def draw_robot(plot: figure) -> None:
    """Draw the outline of the footprint, and an arrow along the heading."""
    outline = plot.patch(
        "x", "y", source=source(f"{plot.name}-footprint", "x y"), fill_alpha=0.25, level="overlay"
    )
    themed(outline.glyph, fill_color="ink", line_color="ink")
    robot = plot.patch("x", "y", source=source(f"{plot.name}-robot", "x y"), line_width=1.2, level="overlay")
    themed(robot.glyph, fill_color="floor", line_color="ink")
