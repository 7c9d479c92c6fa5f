"""The verified run as a picture: an overview, one panel for each episode, and the closest call in detail."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from viatool.report.drawing import (
    HALO,
    INK,
    WALL,
    draw_floor,
    draw_halo,
    draw_obstacles,
    draw_path,
    draw_region,
    draw_task,
    swept_regions,
)
from viatool.report.foreign import one_line
from viatool.report.numbers import count, percentage
from viatool.report.palette import COLOUR, VERDICTS
from viatool.report.states.closest_call import draw_closest_call
from viatool.report.states.document import StatesDocument
from viatool.report.states.poses_figure import draw_places
from viatool.report.states.tubes import ALPHA, draw_tubes
from viatool.report.wording import describe_eps

if TYPE_CHECKING:
    from viatool.verification.result import Result

PANELS, COLUMNS = 10, 4


def draw_result(result: Result) -> Figure:
    """Draw a result.

    Returns
    -------
    matplotlib.figure.Figure
        The overview on the left, up to `PANELS` episodes on the right (if there are more, those with the most
        states that are not safe), the closest call last. Sampled poses are drawn as a map of places.
    """
    if not result.trajectory.connected:
        return draw_places(result)
    episodes = choose_episodes(result)
    figure = Figure(figsize=(15.5, 7.4), layout="constrained", facecolor="white")
    halves = figure.add_gridspec(1, 2, width_ratios=(1.0, 1.3))
    left, right = figure.add_subfigure(halves[0]), figure.add_subfigure(halves[1])
    _overview(left, result)
    rows = -(-(len(episodes) + 2) // COLUMNS)
    grid = right.add_gridspec(max(rows, 1), COLUMNS)
    for place, episode in enumerate(episodes):
        _panel(right.add_subplot(grid[divmod(place, COLUMNS)]), result, episode)
    draw_closest_call(right.add_subplot(grid[-1, -2:]), result)
    columns = 8 if result.horizon is None else 6
    figure.legend(
        handles=_legend(result), loc="outside lower center", ncols=columns, fontsize=9, frameon=False
    )
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


def _overview(figure: SubFigure, result: Result) -> None:
    axes = figure.add_subplot()
    draw_floor(axes, result.world_map)
    trajectory = result.trajectory
    draw_halo(axes, trajectory.poses, trajectory.episode, ~result.judgement.danger)
    draw_path(axes, trajectory.poses, trajectory.episode, result.verdict)
    for scenario in trajectory.scenarios[: 2 * PANELS]:
        if scenario is not None:
            draw_task(axes, scenario)
    axes.set(xlabel="x [m]", ylabel="y [m]")
    figure.suptitle(_title(result), fontsize=11, color=INK, x=0.02, ha="left")


def _title(result: Result) -> str:
    safe, total = int((result.verdict == "safe").sum()), len(result.verdict)
    policy, world_map = plain(Path(result.policy_path).name), plain(result.world_map.name)
    stake = StatesDocument(result.to_json()).stake.replace("; ", ";\n")
    return (
        f"{stake}\n"
        f"{policy} on {world_map}, eps {plain(describe_eps(result.eps))}, {result.criterion}\n"
        f"{percentage(safe, total)} of the states proved safe ({count(safe)} of {count(total)})"
    )


def plain(text: str) -> str:
    """Make a foreign string one line that matplotlib does not read as mathematics."""
    return one_line(text).replace("$", r"\$")


def _panel(axes: Axes, result: Result, episode: int) -> None:
    """Draw one episode: its own obstacles, the tube that has to stay free, and the path."""
    trajectory, scenario = result.trajectory, result.trajectory.scenarios[episode]
    draw_floor(axes, result.world_map)
    axes.set(xticks=[], yticks=[])
    if scenario is not None:
        draw_obstacles(axes, scenario.obstacles, facecolor=WALL, edgecolor=INK)
        draw_task(axes, scenario, size=0.6)
    states = trajectory.episode == episode
    if states.any():
        _tube(axes, result, states)
        draw_tubes(axes, result, states)
        poses, episodes = trajectory.poses[states], trajectory.episode[states]
        draw_halo(axes, poses, episodes, ~result.judgement.danger[states])
        draw_path(axes, poses, episodes, result.verdict[states], width=1.2)
    safe = int((result.verdict[states] == "safe").sum())
    name = plain(scenario.name) if scenario is not None else f"episode {episode}"
    outcome = trajectory.outcomes[episode]
    axes.set_title(f"{name}: {outcome}, {safe}/{int(states.sum())} safe", fontsize=7, color=INK, pad=2)


def _tube(axes: Axes, result: Result, states: NDArray[np.bool_]) -> None:
    """Shade the area that the swept footprint needs free: everything reachable, widened by d_col."""
    import shapely

    states = states & np.isfinite(result.commands[0]).all(axis=1)
    verdicts = result.verdict[states]
    regions = np.array(
        swept_regions(
            result.trajectory.poses[states],
            result.moving[0][states],
            result.moving[1][states],
            result.rules.interval,
            result.rules.kinematics,
        )
    )
    for level, verdict in enumerate(VERDICTS):
        chosen = regions[verdicts == verdict]
        if len(chosen):
            tube = shapely.union_all(chosen).buffer(result.rules.clearance.collision)
            draw_region(axes, tube, facecolor=COLOUR[verdict], alpha=0.22, zorder=1.2 + 0.1 * level)


def _legend(result: Result) -> Sequence[Line2D | Patch]:
    danger = int((~result.judgement.danger).sum())
    counts = {verdict: int((result.verdict == verdict).sum()) for verdict in VERDICTS}
    widths = {"safe": 2.0, "unknown": 3.0, "unsafe": 4.0}
    paths = [
        Line2D([], [], color=COLOUR[v], lw=widths[v], label=f"{v} ({count(counts[v])})") for v in VERDICTS
    ]
    return [
        *paths,
        Line2D([], [], color=HALO, lw=6.0, alpha=0.5, label=f"danger distance not proved ({count(danger)})"),
        Patch(facecolor=COLOUR["safe"], alpha=0.22, label="reachable tube + d_col"),
        *_tube_legend(result),
        Line2D([], [], marker="^", mfc="white", mec=INK, ls="", label="start"),
        Line2D([], [], marker="*", ms=9, mfc="#F0E442", mec=INK, ls="", label="goal"),
        Patch(facecolor=WALL, edgecolor=INK, label="obstacle or outside"),
    ]


def _tube_legend(result: Result) -> Sequence[Patch]:
    """Name what the tubes are, if there are any."""
    if result.horizon is None:
        return []
    steps, verdicts = result.horizon.horizon.steps, result.horizon.verdict
    return [
        Patch(
            facecolor=COLOUR[verdict],
            alpha=ALPHA,
            label=f"tube of {steps} intervals, {verdict} ({count(int((verdicts == verdict).sum()))})",
        )
        for verdict in VERDICTS
        if (verdicts == verdict).any()
    ]
