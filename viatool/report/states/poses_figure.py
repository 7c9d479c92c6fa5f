"""A map of places: where the policy is proved safe, where it can be made to fail, and where nobody knows."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from viatool.arrays import Indices
from viatool.report.drawing import INK, WALL, draw_floor, draw_obstacles
from viatool.report.foreign import one_line
from viatool.report.numbers import count, percentage
from viatool.report.palette import COLOUR, VERDICTS
from viatool.report.states.document import StatesDocument
from viatool.report.wording import describe_eps

if TYPE_CHECKING:
    from viatool.verification.result import Result


PANELS, COLUMNS = 12, 4


def draw_places(result: Result) -> Figure:
    """Draw one panel for each scenario; if there are many, those with the most states that are not safe.

    Each place has the colour of its worst heading; ticks are the headings, dark where one is not safe.
    """
    trajectory, verdicts = result.trajectory, result.verdict
    lost = np.bincount(trajectory.episode[verdicts != "safe"], minlength=trajectory.episodes)
    chosen = sorted(np.argsort(-lost, kind="stable")[:PANELS].tolist())
    columns = min(COLUMNS, len(chosen))
    rows = -(-len(chosen) // columns)
    size = 7.5 if len(chosen) == 1 else 4.0
    x_min, y_min, x_max, y_max = result.world_map.bounds
    height = size * float(np.clip((y_max - y_min) / (x_max - x_min), 0.25, 4.0)) + 0.4
    figure = Figure(figsize=(size * columns, height * rows + 1.0), layout="constrained", facecolor="white")
    grid = figure.add_gridspec(rows, columns)
    for place, episode in enumerate(chosen):
        _panel(figure.add_subplot(grid[divmod(place, columns)]), result, episode, size)
    figure.suptitle(_title(result), fontsize=10, color=INK)
    figure.legend(handles=_legend(result), loc="outside lower center", ncols=5, fontsize=8, frameon=False)
    return figure


def _panel(axes: Axes, result: Result, episode: int, size: float) -> None:
    states, scenario = result.trajectory.episode == episode, result.trajectory.scenarios[episode]
    poses, verdicts = result.trajectory.poses[states], result.verdict[states]
    draw_floor(axes, result.world_map)
    safe = f"{int((verdicts == 'safe').sum())}/{len(verdicts)} safe"
    if scenario is not None:
        draw_obstacles(axes, scenario.obstacles, facecolor=WALL, edgecolor=INK)
        axes.plot(*scenario.goal, marker="*", ms=11, mfc="#F0E442", mec=INK, mew=0.7, ls="", zorder=6)
        safe = f"{one_line(scenario.name)}: {safe}".replace("$", r"\$")
    axes.set_title(safe, fontsize=8, color=INK, pad=2)
    if not len(poses):
        return
    places, index = np.unique(poses[:, :2], axis=0, return_inverse=True)
    rank = np.zeros(len(places), dtype=np.int64)
    np.maximum.at(rank, index.reshape(-1), _rank(verdicts))
    x_min, y_min, x_max, y_max = result.world_map.bounds
    spacing = np.sqrt((x_max - x_min) * (y_max - y_min) / len(places))
    points = 72.0 * 0.85 * size * spacing / max(x_max - x_min, y_max - y_min)
    for level, verdict in enumerate(VERDICTS):
        there = places[rank == level]
        area = float(np.clip((0.7 * points) ** 2, 1.0, 400.0))
        alpha, above = (0.9, 3.0 + level) if level else (0.3, 3.0)
        axes.scatter(
            there[:, 0],
            there[:, 1],
            s=area,
            marker="s",
            color=COLOUR[verdict],
            lw=0,
            alpha=alpha,
            zorder=above,
        )
        ways = poses[verdicts == verdict]
        axes.quiver(
            ways[:, 0], ways[:, 1], np.cos(ways[:, 2]), np.sin(ways[:, 2]),
            color=INK if level else COLOUR[verdict], angles="xy", scale_units="xy", scale=2.5 / spacing,
            width=0.002, headwidth=1, headlength=0, headaxislength=0, zorder=3.5 + level,
        )  # fmt: skip


def _rank(verdicts: NDArray[np.str_]) -> Indices:
    """Return the place of each verdict in `VERDICTS`, which run from good to bad."""
    return np.select([verdicts == verdict for verdict in VERDICTS], range(len(VERDICTS)))


def _title(result: Result) -> str:
    verdicts = result.verdict
    safe, total = int((verdicts == "safe").sum()), len(verdicts)
    name = one_line(result.world_map.name).replace("$", r"\$")
    eps = one_line(describe_eps(result.eps)).replace("$", r"\$")
    return (
        f"{StatesDocument(result.to_json()).stake}\n"
        f"Poses on {name}, eps {eps}, {result.criterion}: {percentage(safe, total)} proved safe "
        f"({count(safe)} of {count(total)})"
    )


def _legend(result: Result) -> Sequence[Patch | Line2D]:
    counts = {verdict: int((result.verdict == verdict).sum()) for verdict in VERDICTS}
    return [
        *(Patch(color=COLOUR[v], label=f"{v} ({count(counts[v])} poses)") for v in VERDICTS),
        Line2D([], [], marker="*", ms=9, mfc="#F0E442", mec=INK, ls="", label="goal"),
        Patch(facecolor=WALL, edgecolor=INK, label="obstacle or outside"),
    ]
