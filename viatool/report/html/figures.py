"""The figures of the page, built with Bokeh: what never changes is in them, the page's script fills the rest.

What changes with every state is on the overlay, a canvas of its own: the paths of a long run are not painted anew for
it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from bokeh.models import CrosshairTool, Range1d, Span
from bokeh.plotting import figure

from viatool.report.html.canvas import (
    draw_fan,
    draw_goal,
    draw_here,
    draw_robot,
    framed,
    map_canvas,
    source,
    themed,
)
from viatool.report.palette import VERDICTS

if TYPE_CHECKING:
    from viatool.verification.result import Result


def map_figure(result: Result) -> figure:
    """Return the map of the whole run."""
    plot = map_canvas(result.world_map)
    draw_fan(plot)
    halo = plot.multi_line("x", "y", source=source("halo", "x y"), line_width=7)
    themed(halo.glyph, line_color="halo").line_alpha = 0.45
    track = plot.line("x", "y", source=source("track", "x y"), line_width=9, level="overlay")
    themed(track.glyph, line_color="quiet").line_alpha = 0.3
    for level, verdict in enumerate(VERDICTS):
        path = plot.multi_line("x", "y", source=source(f"path-{verdict}", "x y"), line_width=1.8 + level)
        themed(path.glyph, line_color=verdict)
        dots = plot.scatter(
            "x", "y", source=source(f"dots-{verdict}", "x y"), size=3.0 + 4.5 * level, marker=_MARKERS[level]
        )
        dots.glyph.line_width = 1.0 + 0.6 * level
        themed(dots.glyph, line_color=verdict, fill_color=verdict)
        hollow = plot.scatter(
            "x", "y", source=source(f"close-{verdict}", "x y"), size=4.0 + 2.0 * level, marker=_CLOSE[level]
        )
        themed(hollow.glyph, line_color=verdict).fill_alpha = 0.0
    draw_goal(plot)
    draw_here(plot)
    draw_robot(plot)
    return plot


_CLOSE = ("circle", "square", "diamond")  # hollow
_MARKERS = ("circle", "square", "x")  # of the verdicts: told apart without colours as well


def commands_figure(result: Result) -> figure:
    """Return the plane of commands: the reachable box, the nine samples, and what else is known."""
    linear, angular = result.actions[:2]
    plot = framed("commands", f"v [{linear.unit}]", f"ω [{angular.unit}]", height=300)
    plot.x_range, plot.y_range = Range1d(0.0, 0.5), Range1d(-1.0, 1.0)
    limits = plot.quad("left", "right", "bottom", "top", source=source("limits", "left right bottom top"))
    themed(limits.glyph, line_color="ink").update(fill_alpha=0.0, line_dash="dashed")
    box = plot.quad("left", "right", "bottom", "top", source=source("box", "left right bottom top"))
    themed(box.glyph, fill_color="here", line_color="here").update(fill_alpha=0.35, line_width=1.5)
    nine = plot.scatter("v", "omega", source=source("nine", "v omega"), size=8)
    themed(nine.glyph, fill_color="floor", line_color="ink")
    found = plot.scatter("v", "omega", source=source("witness-command", "v omega"), marker="x", size=14)
    themed(found.glyph, line_color="unsafe").line_width = 3
    return plot


def width_figure(result: Result, place: int) -> figure:
    """Return the width of one command along the episode of the state that is looked at."""
    action = result.actions[place]
    across = "t [s]" if result.trajectory.connected else "pose"
    plot = framed(f"width-{place}", across, f"width of {'vω'[place]} [{action.unit}]", height=190)
    line = plot.line("x", "y", source=source(f"width-line-{place}", "x y"), line_width=1.2)
    themed(line.glyph, line_color="quiet")
    for level, verdict in enumerate(VERDICTS):
        dots = plot.scatter(
            "x",
            "y",
            source=source(f"width-{place}-{verdict}", "x y"),
            size=3.5 + 2 * level,
            marker=_MARKERS[level],
        )
        themed(dots.glyph, line_color=verdict, fill_color=verdict)
    now = Span(location=0.0, dimension="height", name=f"now-{place}", line_dash="dotted", level="overlay")
    plot.add_layout(themed(now, line_color="ink"))
    plot.add_tools(CrosshairTool(dimensions="height"))
    return plot
