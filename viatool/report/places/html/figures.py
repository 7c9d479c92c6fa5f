"""The map of places: a picture that the page's script paints anew for each slice, and the counterexample on it."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from bokeh.models import ColumnDataSource
from bokeh.plotting import figure

from viatool.report.html.canvas import (
    draw_fan,
    draw_goal,
    draw_here,
    draw_obstacles,
    draw_robot,
    map_canvas,
    situation_figure,
    source,
    themed,
)

if TYPE_CHECKING:
    from viatool.places import Certificate, Raster


def places_figure(certificate: Certificate, raster: Raster) -> figure:
    """Return the map with its places."""
    plot = map_canvas(certificate.world_map)
    left, right, bottom, top = raster.extent
    picture = ColumnDataSource({"image": [np.zeros((1, 1), dtype=np.uint32)]}, name="places-source")
    plot.image_rgba("image", x=left, y=bottom, dw=right - left, dh=top - bottom, source=picture)
    draw_obstacles(plot, certificate.world_map.obstacles)
    draw_obstacles(plot, certificate.scenario.obstacles)
    ends = {end: end for end in ("left", "right", "bottom", "top")}
    squares = plot.quad(**ends, source=source("failing", " ".join(ends)), fill_alpha=0.0, line_width=1.5)
    themed(squares.glyph, line_color="ill")
    draw_fan(plot)
    worst = plot.scatter("x", "y", source=source("worst", "x y"), marker="x", size=11, level="overlay")
    themed(worst.glyph, line_color="ink").line_width = 2
    draw_goal(plot)
    draw_here(plot)
    draw_robot(plot)
    return plot


def surroundings_figure(certificate: Certificate) -> figure:
    """Return the surroundings of a counterexample: the map with the obstacles of the scenario."""
    world_map, scenario = certificate.world_map, certificate.scenario
    return situation_figure(replace(world_map, obstacles=world_map.obstacles + scenario.obstacles))
