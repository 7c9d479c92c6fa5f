"""The verified run as a picture: an overview, one panel for each episode, and the closest call in detail."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from viatool.report.closest_call import draw_closest_call
from viatool.report.drawing import (
    FLOOR,
    INK,
    WALL,
    draw_floor,
    draw_obstacles,
    draw_path,
    draw_region,
    draw_task,
    swept_regions,
)
from viatool.report.files import replacing
from viatool.report.numbers import count, percentage
from viatool.report.palette import COLOUR, VERDICTS
from viatool.report.wording import describe_eps

if TYPE_CHECKING:
    from viatool.safety import Result

SUFFIXES = (".png", ".svg", ".pdf")
PANELS, COLUMNS = 10, 4
DPI = 160


def write(result: Result, path: Path) -> None:
    """Write the picture of a result as png, svg or pdf."""
    with replacing(path) as draft:
        draw_result(result).savefig(draft, dpi=DPI, metadata=_undated(path))


def _undated(path: Path) -> dict[str, None]:
    """Leave out the date, so that the same result gives the same file."""
    return {} if path.suffix.lower() == ".png" else {"Date" if path.suffix.lower() == ".svg" else "CreationDate": None}


def draw_result(result: Result) -> Figure:
    """Draw a result.

    Returns
    -------
    matplotlib.figure.Figure
        The overview on the left, up to `PANELS` episodes on the right (those with the most states that are not
        safe, if there are more), the closest call last.
    """
    episodes = choose_episodes(result)
    figure = Figure(figsize=(15.5, 8.4), layout="constrained", facecolor="white")
    left, right = figure.subfigures(1, 2, width_ratios=(1.0, 1.35), wspace=0.01)
    _overview(left, result)
    rows = -(-(len(episodes) + 2) // COLUMNS)
    grid = right.add_gridspec(max(rows, 1), COLUMNS)
    for place, episode in enumerate(episodes):
        _panel(right.add_subplot(grid[divmod(place, COLUMNS)]), result, episode)
    draw_closest_call(right.add_subplot(grid[-1, -2:]), result)
    return figure


def choose_episodes(result: Result) -> list[int]:
    """Return the episodes that get a panel: all, or those with the most unsafe and then unknown states."""
    trajectory, verdicts = result.trajectory, result.verdict
    unsafe, unknown = (
        np.bincount(trajectory.episode[verdicts == verdict], minlength=trajectory.episodes)
        for verdict in ("unsafe", "unknown")
    )
    worst_first = np.lexsort((-unknown, -unsafe))
    return sorted(int(episode) for episode in worst_first[:PANELS])


def _overview(figure: Figure, result: Result) -> None:
    axes = figure.add_subplot()
    draw_floor(axes, result.world_map)
    trajectory = result.trajectory
    for episode in range(trajectory.episodes):
        states = trajectory.episode == episode
        if states.any():
            draw_path(axes, trajectory.poses[states], result.verdict[states])
        scenario = trajectory.scenarios[episode]
        if scenario is not None and trajectory.episodes <= 2 * PANELS:
            draw_task(axes, scenario)
    axes.set(xlabel="x [m]", ylabel="y [m]")
    axes.set_title(_title(result), fontsize=11, color=INK, loc="left")
    figure.legend(handles=_legend(result), loc="outside lower center", ncols=4, fontsize=8, frameon=False)


def _title(result: Result) -> str:
    safe, total = int((result.verdict == "safe").sum()), len(result.verdict)
    name = plain(Path(result.policy_path).name)
    return (
        f"{name} on {plain(result.world_map.name)}, eps {plain(describe_eps(result.eps))}, {result.criterion}\n"
        f"{percentage(safe, total)} of the states proved safe ({count(safe)} of {count(total)})"
    )


def plain(text: str) -> str:
    """Escape what matplotlib would read as mathematics."""
    return text.replace("$", r"\$")
