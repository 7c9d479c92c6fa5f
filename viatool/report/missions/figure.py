"""Missions as a picture: the tube from start to goal, the runs that were driven against it, and the verdict."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Patch, PathPatch
from matplotlib.path import Path

from viatool.report.drawing import INK, WALL, draw_floor, draw_obstacles, draw_task
from viatool.report.foreign import one_line
from viatool.report.palette import COLOUR
from viatool.report.sections import Headline

if TYPE_CHECKING:
    from viatool.missions import Mission, Missions

_SIDE = 3.4  # inches
_MOST = 20  # missions that are drawn
_TONES = {"proved": "safe", "refuted": "unsafe", "unknown": "unknown"}


def draw_missions(missions: Missions, headline: Headline) -> Figure:
    """Draw each mission by itself below a headline."""
    shown = missions.missions[:_MOST]
    columns = min(5, max(1, len(shown)))
    rows = -(-len(shown) // columns) or 1
    size = (_SIDE * max(columns, 2), _SIDE * rows + 0.7)
    figure = Figure(figsize=size, layout="constrained", facecolor="white")
    for place, mission in enumerate(shown):
        _draw(figure.add_subplot(rows, columns, place + 1), mission, missions)
    rest = len(missions.missions) - len(shown)
    title = (headline.stake or f"{headline}") + (f"; {rest} more are not drawn" if rest else "")
    figure.suptitle(one_line(title), fontsize=10, color=INK)
    return figure


def _draw(axes: Axes, mission: Mission, missions: Missions) -> None:
    draw_floor(axes, missions.world_map)
    draw_obstacles(axes, mission.scenario.obstacles, facecolor=WALL, edgecolor=INK)
    axes.add_patch(_goal(mission, missions))
    colour = COLOUR[_TONES[mission.verdict]]
    tube = mission.proof.tube
    low, high = tube.lower[:, :2], tube.upper[:, :2]
    corners = np.stack(
        [low, np.column_stack([high[:, 0], low[:, 1]]), high, np.column_stack([low[:, 0], high[:, 1]])],
        axis=1,
    )
    axes.add_collection(
        PolyCollection(list(corners), facecolor=colour, edgecolor=colour, lw=0.4, zorder=3, rasterized=True)
    )
    paths = [path[np.isfinite(path).all(axis=1)] for path in mission.paths]
    axes.add_collection(LineCollection(paths, colors=INK, linewidths=0.3, alpha=0.7, zorder=4))
    if len(mission.crashes):
        axes.plot(*mission.crashes.place[:, :2].T, ls="", marker="x", ms=7, color=COLOUR["unsafe"], zorder=7)
    draw_task(axes, mission.scenario, size=0.8)
    name = one_line(mission.scenario.name).replace("$", r"\$")
    axes.set_title(f"{name}: {mission.verdict}", fontsize=8, color=INK, pad=3)


def _goal(mission: Mission, missions: Missions) -> Patch:
    """Return the outline of where runs arrive; what is free reaches to the edge of the map."""
    look: dict[str, Any] = {"facecolor": "none", "edgecolor": INK, "lw": 0.6, "ls": "--"}
    region = mission.scenario.region
    if region is None:
        return Circle(mission.scenario.goal, missions.goal_radius, **look)
    import shapely

    places = shapely.get_parts(region.places(missions.world_map.bounds))
    rings = [np.array(place.exterior.coords) for place in places if place.geom_type == "Polygon"]
    return PathPatch(Path.make_compound_path(*(Path(ring) for ring in rings)), **look)
