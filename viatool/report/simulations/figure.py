"""A simulation as a picture: all paths by outcome, clearances, and times to the goal."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from viatool.report.drawing import FAINT, INK, draw_floor, draw_obstacles, draw_task
from viatool.report.foreign import one_line
from viatool.report.numbers import counted, percentage
from viatool.report.palette import COLOUR
from viatool.simulate.statistics import episode_steps

if TYPE_CHECKING:
    from viatool.simulate import Simulation

_OUTCOMES = {"success": COLOUR["safe"], "timeout": COLOUR["unknown"], "collision": COLOUR["unsafe"]}
_MOST_TASKS = 30  # scenarios whose own obstacles, start and goal are drawn


def draw_simulation(simulation: Simulation) -> Figure:
    """Draw a simulation."""
    figure = Figure(figsize=(11.0, 6.6), layout="constrained")
    grid = figure.add_gridspec(2, 2, width_ratios=(1.7, 1.0))
    _draw_paths(figure.add_subplot(grid[:, 0]), simulation)
    upper, lower = (figure.add_subplot(grid[row, 1]) for row in range(2))
    _draw_clearances(upper, simulation)
    _draw_times(lower, simulation)
    robot = simulation.world_map.robot.name
    words = [f"{simulation.engine} engine, {robot}", *simulation.conditions.words()]
    share = simulation.statistics.success
    title = f"{counted(share.total, 'episode')} on {simulation.world_map.name}: {percentage(share.count, share.total)} "
    title += f"reach the goal ({', '.join(words)})"
    figure.suptitle(one_line(title).replace("$", r"\$"), fontsize=10, color=INK)
    return figure


def _draw_paths(axes: Axes, simulation: Simulation) -> None:
    trajectory, ends = simulation.drive.trajectory, simulation.drive.ends
    draw_floor(axes, simulation.world_map)
    tasks = [scenario for scenario in trajectory.scenarios if scenario is not None]
    if len(tasks) <= _MOST_TASKS:
        for scenario in tasks:
            draw_obstacles(axes, scenario.obstacles, facecolor="none", edgecolor=FAINT)
            draw_task(axes, scenario, size=0.7)
    firsts = np.searchsorted(trajectory.episode, np.arange(trajectory.episodes + 1))
    paths = [
        np.vstack([trajectory.poses[first:last, :2], ends[episode, :2]])
        for episode, (first, last) in enumerate(pairwise(firsts.tolist()))
    ]
    for level, (outcome, colour) in enumerate(_OUTCOMES.items()):
        chosen = [path for path, found in zip(paths, trajectory.outcomes, strict=True) if found == outcome]
        axes.add_collection(
            LineCollection(
                chosen, colors=colour, linewidths=0.8 + 0.4 * level, alpha=0.6, zorder=4 + level,
                rasterized=len(chosen) > 200,
            )
        )  # fmt: skip
        if outcome != "success" and chosen:
            last = np.array([path[-1] for path in chosen])
            axes.plot(*last.T, ls="", marker="x", ms=5, mew=1.2, color=colour, zorder=7)
    handles = [
        Line2D([], [], color=colour, label=f"{outcome}: {int((trajectory.outcomes == outcome).sum())}")
        for outcome, colour in _OUTCOMES.items()
    ]
    axes.legend(
        handles=handles, fontsize=7, loc="upper center", bbox_to_anchor=(0.5, -0.04), ncols=3, frameon=False
    )


def _draw_clearances(axes: Axes, simulation: Simulation) -> None:
    found, clearance = simulation.statistics, simulation.world_map.clearance
    edges = found.clearance_edges
    width = edges[1] - edges[0]
    axes.bar(
        edges, found.clearance_counts, width=width, align="edge", color=FAINT, edgecolor=INK, linewidth=0.3
    )
    for name, value in (("collision", clearance.collision), ("danger", clearance.danger)):
        colour = COLOUR["unsafe" if name == "collision" else "unknown"]
        axes.axvline(value, color=colour, lw=1.2, label=f"{name} {value:g} m")
    axes.set_xlabel(f"clearance after a step [m]; the last bar holds {edges[-1]:g} m and more", fontsize=8)
    axes.set_ylabel("steps", fontsize=8)
    _trim(axes)
    axes.legend(fontsize=7, frameon=False)


def _draw_times(axes: Axes, simulation: Simulation) -> None:
    trajectory = simulation.drive.trajectory
    seconds = episode_steps(trajectory) * simulation.world_map.robot.control_interval
    groups = [seconds[trajectory.outcomes == outcome] for outcome in _OUTCOMES]
    bins = np.linspace(0.0, float(seconds.max()), 31)
    axes.hist(groups, bins=list(bins), stacked=True, color=list(_OUTCOMES.values()))
    axes.set_xlabel("duration of an episode [s]", fontsize=8)
    axes.set_ylabel("episodes", fontsize=8)
    _trim(axes)


def _trim(axes: Axes) -> None:
    axes.tick_params(length=2, labelsize=7, colors=INK)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
