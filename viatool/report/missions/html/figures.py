"""The figures of the page of missions: the map with tube and runs, and the distance that both keep over time."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bokeh.plotting import figure

from viatool.report.html.canvas import framed, map_canvas, source, themed

if TYPE_CHECKING:
    from viatool.missions import Missions

_BOX = "left right bottom top"


def tubes_figure(missions: Missions) -> figure:
    """Return the map; what is drawn of a mission and an interval, the page's script fills in."""
    plot = map_canvas(missions.world_map)
    ends = {end: end for end in _BOX.split()}
    goal = plot.patches("x", "y", source=source("goal", "x y"), fill_alpha=0.35, line_width=1.5)
    themed(goal.glyph, fill_color="goal", line_color="ink")
    for name, fill, line in (("whole", 0.10, 0.0), ("tube", 0.55, 1.0)):
        boxes = plot.quad(**ends, source=source(name, _BOX), fill_alpha=fill, line_alpha=line, line_width=0.7)
        themed(boxes.glyph, fill_color="here", line_color="here")
    start = plot.quad(**ends, source=source("start", _BOX), fill_alpha=0.0, line_width=1.5)
    themed(start.glyph, line_color="ink")
    ways = plot.multi_line("x", "y", source=source("ways", "x y"), line_width=0.8, line_alpha=0.6)
    themed(ways.glyph, line_color="ink")
    robots = plot.scatter("x", "y", source=source("robots", "x y"), size=4, level="overlay")
    themed(robots.glyph, fill_color="ink", line_color="ink")
    end = plot.scatter(
        "x", "y", source=source("end", "x y"), marker="x", size=13, line_width=3, level="overlay"
    )
    themed(end.glyph, line_color="unsafe")
    return plot


def clearance_figure() -> figure:
    """Return the distance that tube and runs keep over time."""
    plot = framed("clearance", "time [s]", "distance [m]", height=260)
    for name, colour, width in (("limit", "unsafe", 1.5), ("driven", "ink", 1.2), ("kept", "here", 2.5)):
        line = plot.line("x", "y", source=source(name, "x y"), line_width=width)
        themed(line.glyph, line_color=colour)
    now = plot.scatter("x", "y", source=source("now", "x y"), size=9)
    themed(now.glyph, fill_color="here", line_color="ink")
    return plot
