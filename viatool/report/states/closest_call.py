"""The closest call in detail: where every command of one state leads, and the distances to be kept."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from viatool.arrays import Floats
from viatool.report.drawing import FLOOR, HALO, INK, WALL, draw_region, swept_regions
from viatool.report.palette import COLOUR
from viatool.setting.rules import Rules

if TYPE_CHECKING:
    from shapely.geometry.base import BaseGeometry

    from viatool.verification.result import Result

_BEYOND = 0.6  # of the way to the nearest obstacle, that is shown behind its border
_LEAST_VIEW = 0.06  # metres from the middle of the view to its border, at least


def closest_state(result: Result) -> int | None:
    """Return the state to look at: the unsafe one whose counterexample comes nearest, else the nearest unknown one.

    Returns
    -------
    int or None
        None if the commands of no state were bounded.
    """
    from viatool.world import Scenes

    trajectory = result.trajectory
    bounded = np.isfinite(result.commands[0]).all(axis=1)
    if not bounded.any():
        return None
    scenes = Scenes.of(result.world_map, trajectory.scenarios)
    clearance = scenes.clearance(trajectory.poses[:, :2], trajectory.episode)
    clearance[result.witnesses.state] = result.witnesses.clearance
    rank = np.select([result.verdict == "unsafe", result.verdict == "unknown"], [0, 1], 2)
    return int(np.lexsort((clearance, rank, ~bounded))[0])


def draw_closest_call(axes: Axes, result: Result) -> None:
    """Draw one state: the area swept by all reachable commands, the nine samples, the limits and what is near."""
    import shapely

    axes.set_xticks([])
    axes.set_yticks([])
    state = closest_state(result)
    if state is None:
        axes.set_axis_off()
        return
    trajectory, rules = result.trajectory, result.rules
    pose, lower, upper = trajectory.poses[state], result.moving[0][state], result.moving[1][state]
    region = swept_regions(pose[None], lower[None], upper[None], rules.interval, rules.kinematics)[0]
    blocked = _blocked(result, int(trajectory.episode[state]))
    way = np.asarray(shapely.shortest_line(region, blocked).coords)
    _frame(axes, region, way)
    _draw_limits(axes, result, blocked)
    verdict = str(result.verdict[state])
    draw_region(axes, region, facecolor=COLOUR[verdict], edgecolor=COLOUR[verdict], alpha=0.45, zorder=4)
    arcs = _nine_arcs(pose, lower, upper, rules)
    for arc in arcs:
        axes.plot(*arc.T, color=INK, lw=0.5, alpha=0.7, zorder=5)
    _draw_robot(axes, pose)
    _draw_way(axes, way, rules)
    _draw_scale(axes)
    axes.set_title(
        f"closest call: episode {trajectory.episode[state]}, t = {trajectory.time[state]:.1f} s, {verdict}",
        fontsize=8,
        color=COLOUR[verdict],
        fontweight="bold",
    )
    axes.legend(
        handles=_legend(verdict), fontsize=6, loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False
    )


def _blocked(result: Result, episode: int) -> BaseGeometry:
    from viatool.world import Scenes

    return Scenes.of(result.world_map, [result.trajectory.scenarios[episode]]).shapely(0)


def _frame(axes: Axes, region: BaseGeometry, way: Floats) -> None:
    """Show the swept area, and of the nearest obstacle as much behind its border as there is room before it."""
    beyond = way[1] + _BEYOND * (way[1] - way[0])
    corners = np.array([region.bounds[:2], region.bounds[2:], way[1], beyond])
    lower, upper = corners.min(axis=0), corners.max(axis=0)
    (x, y), half = 0.5 * (lower + upper), max(0.6 * float((upper - lower).max()), _LEAST_VIEW)
    axes.set(xlim=(x - half, x + half), ylim=(y - half, y + half), aspect="equal", facecolor=FLOOR)


def _draw_way(axes: Axes, way: Floats, rules: Rules) -> None:
    """Draw the way to the nearest obstacle, with its length if that is what the footprint has left."""
    axes.plot(*way.T, color=INK, lw=0.9, ls=(0, (4, 2)), zorder=5)
    if rules.footprint.kind == "polygon":
        return
    left = float(np.hypot(*(way[1] - way[0]))) - rules.footprint.radius
    box = {"boxstyle": "round,pad=0.15", "facecolor": "white", "edgecolor": "none", "alpha": 0.85}
    x, y = way.mean(axis=0).tolist()
    axes.text(x, y, f"{100.0 * left:.1f} cm", ha="center", va="center", fontsize=7, zorder=8, bbox=box)


def _draw_limits(axes: Axes, result: Result, blocked: BaseGeometry) -> None:
    """Shade what is nearer to an obstacle than the danger and the collision distance."""
    import shapely

    x_min, x_max = axes.get_xlim()
    y_min, y_max = axes.get_ylim()
    reach = result.rules.clearance.danger + (x_max - x_min)
    near = blocked.intersection(shapely.box(x_min - reach, y_min - reach, x_max + reach, y_max + reach))
    quarter = 64
    for distance, colour, alpha in (
        (result.rules.clearance.danger, HALO, 0.18),
        (result.rules.clearance.collision, COLOUR["unsafe"], 0.22),
    ):
        limit = near.buffer(distance / np.cos(np.pi / (4 * quarter)), quad_segs=quarter)
        draw_region(axes, limit, facecolor=colour, edgecolor=colour, alpha=alpha, zorder=1.5)
    draw_region(axes, near, facecolor=WALL, edgecolor=INK, alpha=1.0, zorder=2)


def _nine_arcs(pose: Floats, lower: Floats, upper: Floats, rules: Rules) -> Floats:
    """Return the paths of the lower, middle and upper value of both commands, (9, T, 2) metres."""
    shares = np.full((9, len(lower)), 0.5)
    shares[:, :2] = [(v, omega) for v in (0.0, 0.5, 1.0) for omega in (0.0, 0.5, 1.0)]
    actions, times = lower + shares * (upper - lower), np.linspace(0.0, rules.interval, 12)
    return rules.kinematics.drive(pose[None, None], actions[:, None], times, rules.interval)[..., :2]


def _draw_robot(axes: Axes, pose: Floats) -> None:
    x, y, heading = pose
    marker = (3, 0, float(np.degrees(heading)) - 90.0)
    axes.plot(x, y, marker=marker, ms=8, mfc="none", mec=INK, mew=1.0, ls="", zorder=6)


def _draw_scale(axes: Axes) -> None:
    """Draw a bar of a round length at the lower left."""
    x_min, x_max = axes.get_xlim()
    y_min, _ = axes.get_ylim()
    side = x_max - x_min
    length = max(size for size in (0.01, 0.02, 0.05, 0.1, 0.2, 0.5) if size <= max(0.4 * side, 0.01))
    x, y = x_min + 0.05 * side, y_min + 0.06 * side
    axes.plot([x, x + length], [y, y], color=INK, lw=2.0, solid_capstyle="butt", zorder=7)
    axes.text(
        x + 0.5 * length,
        y + 0.02 * side,
        f"{100 * length:g} cm",
        ha="center",
        fontsize=7,
        color=INK,
        zorder=7,
    )


def _legend(verdict: str) -> list[Patch | Line2D]:
    return [
        Patch(facecolor=COLOUR[verdict], alpha=0.45, label="swept by every\nreachable command"),
        Line2D([], [], color=INK, lw=0.7, label="the nine samples"),
        Patch(facecolor=COLOUR["unsafe"], alpha=0.3, label="below d_col"),
        Patch(facecolor=HALO, alpha=0.25, label="below d_danger"),
    ]
