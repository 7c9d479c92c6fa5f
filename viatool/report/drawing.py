"""Drawing on matplotlib axes: maps, scenarios, driven paths by verdict, and the area that must stay free."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PatchCollection
from matplotlib.patches import Circle, PathPatch, Polygon
from matplotlib.path import Path as Outline
from numpy.typing import NDArray

from viatool.arrays import Booleans, Floats, Indices
from viatool.motion.kinematics import DIFFERENTIAL
from viatool.motion.law import Kinematics
from viatool.report.occupancy import draw_cells
from viatool.report.palette import COLOUR, VERDICTS

if TYPE_CHECKING:
    from shapely.geometry.base import BaseGeometry

    from viatool.world import Obstacles, Scenario, WorldMap


FLOOR, WALL, INK, FAINT, HALO = "#FBFBFA", "#8D949C", "#22272E", "#C9CED4", "#CC79A7"
_MOST_VECTORS = 20_000  # lines in a vector file before they become pixels
_MARGIN = 0.25  # metres of wall that are shown around the arena


def draw_floor(axes: Axes, world_map: WorldMap) -> None:
    """Draw the arena, its outside and the obstacles that every scenario has; equal axes in metres."""
    x_min, y_min, x_max, y_max = world_map.bounds
    axes.set_facecolor(WALL)
    axes.add_patch(Polygon(world_map.arena, closed=True, facecolor=FLOOR, edgecolor=INK, linewidth=0.8))
    draw_obstacles(axes, world_map.obstacles, facecolor=WALL, edgecolor=INK)
    axes.set(xlim=(x_min - _MARGIN, x_max + _MARGIN), ylim=(y_min - _MARGIN, y_max + _MARGIN), aspect="equal")
    axes.tick_params(length=2, labelsize=7, colors=INK)
    for spine in axes.spines.values():
        spine.set_visible(False)


def draw_obstacles(axes: Axes, obstacles: Obstacles, *, facecolor: str, edgecolor: str) -> None:
    """Draw circles, polygons and the cells of a grid."""
    if obstacles.grid is not None:
        draw_cells(axes, obstacles.grid, colour=edgecolor)
    patches = [Circle((x, y), radius) for x, y, radius in obstacles.circles]
    polygons = [Polygon(corners, closed=True) for corners in obstacles.polygons]
    axes.add_collection(
        PatchCollection(
            [*patches, *polygons], facecolor=facecolor, edgecolor=edgecolor, linewidth=0.6, zorder=2
        )
    )


def draw_task(axes: Axes, scenario: Scenario, *, size: float = 1.0) -> None:
    """Mark start (a triangle that points along the heading) and goal (a star)."""
    x, y, heading = scenario.start
    marker = (3, 0, np.degrees(heading) - 90.0)
    axes.plot(x, y, marker=marker, ms=7 * size, mfc="white", mec=INK, mew=0.9, ls="", zorder=6)
    axes.plot(*scenario.goal, marker="*", ms=10 * size, mfc="#F0E442", mec=INK, mew=0.7, ls="", zorder=6)


def draw_path(
    axes: Axes, poses: Floats, episode: Indices, verdicts: NDArray[np.str_], *, width: float = 1.6
) -> None:
    """Draw driven paths, each stretch in the colour of the verdict of the state in which it starts.

    Parameters
    ----------
    axes : Axes
        Where.
    poses : ndarray
        (N, 3) metres and radians; the states of an episode stand in the order of time.
    episode : ndarray
        (N,) the episode of each state.
    verdicts : ndarray
        (N,) safe, unsafe or unknown.
    width : float
        Of the line, in points.
    """
    for level, verdict in enumerate(VERDICTS):
        chosen = _stretches(poses, episode, verdicts == verdict)
        wide = width * (1.0 + 0.5 * level)
        _add_lines(axes, chosen, colour=COLOUR[verdict], width=wide, zorder=4 + 0.1 * level)
    marked = poses[verdicts == "unsafe", :2]
    axes.plot(*marked.T, ls="", marker="x", ms=3 * width, mew=0.8, color=COLOUR["unsafe"], zorder=5)


def draw_halo(axes: Axes, poses: Floats, episode: Indices, marked: Booleans) -> None:
    """Underlay the stretches that start in a marked state (N,)."""
    _add_lines(axes, _stretches(poses, episode, marked), colour=HALO, width=6.0, zorder=3.5, alpha=0.5)


def _stretches(poses: Floats, episode: Indices, marked: Booleans) -> Floats:
    """Return the stretches from each marked state to the next one of its episode, (L, 2, 2)."""
    joined = marked[:-1] & (episode[:-1] == episode[1:])
    return np.asarray(np.stack([poses[:-1, :2], poses[1:, :2]], axis=1)[joined])


def _add_lines(
    axes: Axes, lines: Floats, *, colour: str, width: float, zorder: float, alpha: float = 1.0
) -> None:
    many = len(lines) > _MOST_VECTORS
    axes.add_collection(
        LineCollection(
            list(lines),
            colors=colour,
            linewidths=width,
            alpha=alpha,
            capstyle="round" if alpha == 1.0 else "butt",
            zorder=zorder,
            rasterized=many,
        )
    )


def draw_region(
    axes: Axes,
    region: BaseGeometry,
    *,
    facecolor: str,
    alpha: float,
    edgecolor: str = "none",
    zorder: float = 1.0,
) -> None:
    """Fill a shapely polygon or multipolygon, holes left open."""
    for part in getattr(region, "geoms", [region]):
        if part.is_empty or part.geom_type != "Polygon":
            continue
        rings = [part.exterior, *part.interiors]
        outline = Outline.make_compound_path(*(Outline(np.asarray(ring.coords)[:, :2]) for ring in rings))
        axes.add_patch(
            PathPatch(
                outline, facecolor=facecolor, alpha=alpha, edgecolor=edgecolor, linewidth=0.7, zorder=zorder
            )
        )


def swept_regions(
    poses: Floats, lower: Floats, upper: Floats, interval: float, kinematics: Kinematics = DIFFERENTIAL
) -> Sequence[BaseGeometry]:
    """Return where the robot's origin can be during one interval, for drawing: B convex polygons.

    Parameters
    ----------
    poses : ndarray
        (B, 3) metres and radians.
    lower, upper : ndarray
        (B, A) ends of the commands, behind them those of the state of the motion if it has one.
    interval : float
        Seconds.
    kinematics : Kinematics
        How the robot moves.

    Notes
    -----
    Sound: no, the hull of sampled arcs; proofs use `viatool.safety`.
    """
    import shapely

    axes = lower.shape[1]
    corner = (np.arange(2**axes)[:, None] >> np.arange(axes)) & 1
    corners = np.where(corner, upper[:, None], lower[:, None])  # (B, K, A)
    times = np.linspace(0.0, interval, 4)
    points = kinematics.drive(poses[:, None, None], corners[:, :, None], times, interval)[..., :2]
    batch = points.reshape(len(poses), points.shape[1] * points.shape[2], 2)
    return list(shapely.convex_hull(shapely.multipoints(batch)))
