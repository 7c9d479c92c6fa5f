"""The figures of the page, built with Bokeh: what never changes is in them, the page's script fills the rest.

Sources that the script fills have names. What changes with every state is on the overlay, a canvas of its own: the
paths of a long run are not painted anew for it. A model's tags say which of its properties take a colour of the page's
theme, so that light and dark are decided in the style sheet alone.
"""

from __future__ import annotations

from base64 import b64encode
from io import BytesIO
from typing import TYPE_CHECKING, Any

import numpy as np
from bokeh.models import (
    BoxZoomTool,
    ColumnDataSource,
    CrosshairTool,
    PanTool,
    Range1d,
    ResetTool,
    SaveTool,
    Span,
    WheelZoomTool,
)
from bokeh.plotting import figure
from numpy.typing import NDArray

from viatool.report.cells import darkest
from viatool.report.html.states import clearances
from viatool.report.palette import VERDICTS

if TYPE_CHECKING:
    from viatool.safety import Result
    from viatool.world import Obstacles, OccupancyGrid, WorldMap

Floats = NDArray[np.float64]

BINS = 40
_MARGIN = 0.25  # metres of wall that are shown around the arena


def themed(model: Any, **colours: str) -> Any:
    """Let a property of a model follow the theme: ``themed(glyph, fill_color="wall")``."""
    model.tags = [*model.tags, {"theme": colours}]
    return model


def map_figure(result: Result) -> figure:
    """Return the map of the whole run."""
    x_min, y_min, x_max, y_max = result.world_map.bounds
    plot = _bare(
        "map",
        x_range=Range1d(x_min - _MARGIN, x_max + _MARGIN),
        y_range=Range1d(y_min - _MARGIN, y_max + _MARGIN),
        aspect_ratio=float(np.clip((x_max - x_min) / (y_max - y_min), 0.6, 2.0)),
        tools=[PanTool(), WheelZoomTool(), BoxZoomTool(match_aspect=True), ResetTool(), SaveTool()],
    )
    _draw_world(plot, result.world_map)
    fan = plot.wedge(
        "x", "y", "radius", "start", "end", source=_source("fan", "x y radius start end"), level="overlay"
    )
    themed(fan.glyph, fill_color="fan", line_color="fan")
    fan.glyph.update(fill_alpha=0.25, line_alpha=0.7, line_width=0.6)
    halo = plot.multi_line("x", "y", source=_source("halo", "x y"), line_width=7)
    themed(halo.glyph, line_color="halo").line_alpha = 0.45
    track = plot.line("x", "y", source=_source("track", "x y"), line_width=9, level="overlay")
    themed(track.glyph, line_color="quiet").line_alpha = 0.3
    for level, verdict in enumerate(VERDICTS):
        path = plot.multi_line("x", "y", source=_source(f"path-{verdict}", "x y"), line_width=1.8 + level)
        themed(path.glyph, line_color=verdict)
        dots = plot.scatter(
            "x", "y", source=_source(f"dots-{verdict}", "x y"), size=3.0 + 4.5 * level, marker=_MARKERS[level]
        )
        dots.glyph.line_width = 1.0 + 0.6 * level
        themed(dots.glyph, line_color=verdict, fill_color=verdict)
    goal = plot.scatter("x", "y", source=_source("goal", "x y"), marker="star", size=15, level="overlay")
    themed(goal.glyph, fill_color="goal", line_color="ink")
    here = plot.scatter("x", "y", source=_source("here", "x y"), size=20, level="overlay")
    here.glyph.update(line_width=1.5, fill_alpha=0.0)
    themed(here.glyph, line_color="ink")
    _draw_robot(plot)
    return plot


_MARKERS = ("circle", "square", "x")  # of the verdicts: told apart without colours as well


def situation_figure(result: Result) -> figure:
    """Return the surroundings of one state: obstacles, what the robot sweeps, and the distances around it."""
    plot = _bare(
        "situation",
        x_range=Range1d(-1.0, 1.0),
        y_range=Range1d(-1.0, 1.0),
        aspect_ratio=1.0,
        tools=[PanTool(), WheelZoomTool(), SaveTool()],
    )
    _draw_world(plot, result.world_map)
    for name, colour, alpha in (("danger-tube", "halo", 0.22), ("collision-tube", "unsafe", 0.25)):
        tube = plot.patch("x", "y", source=_source(name, "x y"), line_width=1.2, fill_alpha=alpha)
        themed(tube.glyph, fill_color=colour, line_color=colour)
    swept = plot.patch("x", "y", source=_source("swept", "x y"), fill_alpha=0.75, line_color=None)
    themed(swept.glyph, fill_color="here")
    arcs = plot.multi_line("x", "y", source=_source("arcs", "x y"), line_width=1.0)
    themed(arcs.glyph, line_color="ink")
    ends = plot.scatter("x", "y", source=_source("arc-ends", "x y"), size=4)
    themed(ends.glyph, fill_color="ink", line_color="ink")
    counter = plot.line("x", "y", source=_source("witness-path", "x y"), line_width=3.0)
    themed(counter.glyph, line_color="unsafe")
    closest = plot.scatter("x", "y", source=_source("witness-pose", "x y"), marker="x", size=13, line_width=3)
    themed(closest.glyph, line_color="unsafe")
    _draw_robot(plot)
    bar = plot.line("x", "y", source=_source("scale-bar", "x y"), line_width=3)
    themed(bar.glyph, line_color="ink")
    text = plot.text("x", "y", "text", source=_source("scale-text", "x y text"), text_align="center")
    text.glyph.update(text_font_size="12px", text_baseline="bottom")
    themed(text.glyph, text_color="ink")
    return plot


def commands_figure(result: Result) -> figure:
    """Return the plane of commands: the reachable box, the nine samples, and what else is known."""
    linear, angular = (result.actions[column] for column in result.columns)
    plot = _framed("commands", f"v [{linear.unit}]", f"ω [{angular.unit}]", height=300)
    plot.x_range, plot.y_range = Range1d(0.0, 0.5), Range1d(-1.0, 1.0)
    limits = plot.quad("left", "right", "bottom", "top", source=_source("limits", "left right bottom top"))
    themed(limits.glyph, line_color="ink").update(fill_alpha=0.0, line_dash="dashed")
    box = plot.quad("left", "right", "bottom", "top", source=_source("box", "left right bottom top"))
    themed(box.glyph, fill_color="here", line_color="here").update(fill_alpha=0.35, line_width=1.5)
    nine = plot.scatter("v", "omega", source=_source("nine", "v omega"), size=8)
    themed(nine.glyph, fill_color="floor", line_color="ink")
    found = plot.scatter("v", "omega", source=_source("witness-command", "v omega"), marker="x", size=14)
    themed(found.glyph, line_color="unsafe").line_width = 3
    return plot


def width_figure(result: Result, place: int) -> figure:
    """Return the width of one command along the episode of the state that is looked at."""
    action = result.actions[result.columns[place]]
    across = "t [s]" if result.trajectory.connected else "pose"
    plot = _framed(f"width-{place}", across, f"width of {'vω'[place]} [{action.unit}]", height=190)
    line = plot.line("x", "y", source=_source(f"width-line-{place}", "x y"), line_width=1.2)
    themed(line.glyph, line_color="quiet")
    for level, verdict in enumerate(VERDICTS):
        dots = plot.scatter(
            "x",
            "y",
            source=_source(f"width-{place}-{verdict}", "x y"),
            size=3.5 + 2 * level,
            marker=_MARKERS[level],
        )
        themed(dots.glyph, line_color=verdict, fill_color=verdict)
    now = Span(location=0.0, dimension="height", name=f"now-{place}", line_dash="dotted", level="overlay")
    plot.add_layout(themed(now, line_color="ink"))
    plot.add_tools(CrosshairTool(dimensions="height"))
    return plot


def histograms(result: Result) -> list[figure]:
    """Return the distributions over all states: widths of both commands, and the clearance at the pose."""
    units = [result.actions[column] for column in result.columns]
    widths = result.reachable.width[:, list(result.columns)]
    shown = [
        ("histogram-v", f"width of v [{units[0].unit}]", widths[:, 0]),
        ("histogram-omega", f"width of ω [{units[1].unit}]", widths[:, 1]),
        ("histogram-clearance", "clearance at the pose [m]", clearances(result)),
    ]
    return [_histogram(name, across, values, result) for name, across, values in shown]


def _histogram(name: str, across: str, values: Floats, result: Result) -> figure:
    """Stack the counts of the verdicts; a square root keeps the few that are not safe in sight."""
    plot = _framed(name, across, "states", height=210)
    finite = np.isfinite(values)
    edges = np.histogram_bin_edges(values[finite], BINS) if finite.any() else np.linspace(0.0, 1.0, BINS + 1)
    floor = np.zeros(len(edges) - 1)
    for verdict in reversed(VERDICTS):
        counts = np.histogram(values[finite & (result.verdict == verdict)], edges)[0]
        source = ColumnDataSource(
            {
                "left": edges[:-1],
                "right": edges[1:],
                "bottom": np.sqrt(floor),
                "top": np.sqrt(floor + counts),
            },
            name=f"{name}-{verdict}",
        )
        bars = plot.quad("left", "right", "bottom", "top", source=source, line_width=0)
        themed(bars.glyph, fill_color=verdict)
        floor = floor + counts
    ticks = _root_ticks(float(floor.max(initial=1.0)))
    plot.yaxis.ticker = [float(np.sqrt(tick)) for tick in ticks]
    plot.yaxis.major_label_overrides = {float(np.sqrt(tick)): f"{tick:,}" for tick in ticks}
    plot.y_range = Range1d(0.0, 1.05 * float(np.sqrt(floor.max(initial=1.0))))
    return plot


def _root_ticks(largest: float) -> list[int]:
    """Return round counts from 0 to the largest, evenly spread on a square-root axis."""
    ticks = [0]
    for share in (0.06, 0.25, 0.56, 1.0):
        power = 10 ** int(np.floor(np.log10(max(share * largest, 1.0))))
        tick = int(share * largest // power * power)
        if tick > ticks[-1]:
            ticks.append(tick)
    return ticks


def _bare(name: str, **settings: Any) -> figure:
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


def _framed(name: str, across: str, up: str, *, height: int) -> figure:
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
        min_border_right=14,
    )
    themed(plot, outline_line_color="rule")
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


def _source(name: str, columns: str) -> ColumnDataSource:
    return ColumnDataSource({column: [] for column in columns.split()}, name=f"{name}-source")


def _draw_world(plot: figure, world_map: WorldMap) -> None:
    """Draw the arena, the map's obstacles, and those that the page's script adds for an episode."""
    arena = plot.patch(*world_map.arena.T, line_width=1.0)
    themed(arena.glyph, fill_color="floor", line_color="ink")
    if world_map.obstacles.grid is not None:
        _draw_cells(plot, world_map.obstacles.grid)
    _draw_obstacles(plot, world_map.obstacles)
    name = plot.name
    circles = plot.circle("x", "y", radius="radius", source=_source(f"{name}-circles", "x y radius"))
    polygons = plot.patches("x", "y", source=_source(f"{name}-polygons", "x y"))
    for added in (circles, polygons):
        themed(added.glyph, fill_color="wall", line_color="ink")


def _draw_obstacles(plot: figure, obstacles: Obstacles) -> None:
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


def _draw_robot(plot: figure) -> None:
    """Draw the outline of the footprint, and an arrow along the heading."""
    outline = plot.patch(
        "x", "y", source=_source(f"{plot.name}-footprint", "x y"), fill_alpha=0.25, level="overlay"
    )
    themed(outline.glyph, fill_color="ink", line_color="ink")
    robot = plot.patch("x", "y", source=_source(f"{plot.name}-robot", "x y"), line_width=1.2, level="overlay")
    themed(robot.glyph, fill_color="floor", line_color="ink")
