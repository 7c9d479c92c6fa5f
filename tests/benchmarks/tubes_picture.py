"""The picture of trajectory tubes: a path with the tubes of some of its states, and three of them with runs inside."""

from __future__ import annotations

import numpy as np
import shapely
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from viatool.report.drawing import INK, WALL, draw_floor, draw_obstacles, draw_region, draw_task
from viatool.report.palette import COLOUR
from viatool.report.states.tubes import tube_regions

APART = 8  # states between the tubes that are drawn
SHARES = (0.5, 0.9, 1.0)


def draw(path, world, trajectory, chosen, tubes, examples):
    """Write the picture; examples are runs (R, K, 3) by row of the tubes."""
    steps = tubes.lower.shape[1]
    episode = trajectory.episode[chosen]
    undecided = np.bincount(episode[~tubes.safe], minlength=trajectory.episodes)
    scenario = trajectory.scenarios[int(undecided.argmax())]
    rows = np.flatnonzero(episode == undecided.argmax())
    figure = Figure(figsize=(13.0, 6.4), layout="constrained", facecolor="white")
    grid = figure.add_gridspec(3, 2, width_ratios=(1.9, 1.0))
    axes = figure.add_subplot(grid[:, 0])
    scene(axes, world, scenario)
    draw_task(axes, scenario)
    axes.plot(*trajectory.poses[chosen[rows], :2].T, color=INK, lw=0.9, zorder=4)
    for row in rows[::APART]:
        tube(axes, trajectory.poses[chosen[row]], tubes, row)
    axes.set(xlabel="x [m]", ylabel="y [m]")
    axes.set_title(
        f"{scenario.name}: where every run may be over {steps} intervals, from every {APART}th state",
        fontsize=10,
        color=INK,
        loc="left",
    )
    widths = np.hypot(*np.moveaxis((tubes.upper - tubes.lower)[rows, -1, :2], 1, 0))
    there = rows[np.isfinite(widths)]
    order = there[np.argsort(widths[np.isfinite(widths)])]
    for place, share in enumerate(SHARES):
        row = order[min(int(share * len(order)), len(order) - 1)]
        zoom(
            figure.add_subplot(grid[place, 1]),
            world,
            scenario,
            trajectory.poses[chosen[row]],
            tubes,
            row,
            examples,
        )
    figure.savefig(path, dpi=130)


def scene(axes, world, scenario):
    draw_floor(axes, world)
    draw_obstacles(axes, scenario.obstacles, facecolor=WALL, edgecolor=INK)


def tube(axes, pose, tubes, row, alpha=0.6):
    region = shapely.union_all(tube_regions(pose[None], tubes.lower[row][None], tubes.upper[row][None]))
    colour = COLOUR["safe" if tubes.safe[row] else "unknown"]
    draw_region(axes, region, facecolor=colour, edgecolor=colour, alpha=alpha, zorder=3.0)


def zoom(axes, world, scenario, pose, tubes, row, examples):
    scene(axes, world, scenario)
    tube(axes, pose, tubes, row, alpha=0.35)
    runs = np.concatenate([np.broadcast_to(pose, (len(examples[row]), 1, 3)), examples[row]], axis=1)
    axes.add_collection(LineCollection(list(runs[:, :, :2]), colors=INK, linewidths=0.4, alpha=0.6, zorder=4))
    for low, high in zip(tubes.lower[row][:, :2], tubes.upper[row][:, :2], strict=True):
        axes.add_patch(Rectangle(low, *(high - low), facecolor="none", edgecolor=INK, lw=0.6, zorder=3.5))
    low = np.minimum(np.nanmin(tubes.lower[row], axis=0), pose)[:2] - 0.02
    high = np.maximum(np.nanmax(tubes.upper[row], axis=0), pose)[:2] + 0.02
    middle, half = 0.5 * (low + high), 0.5 * np.max((high - low) / (2.0, 1.0))
    axes.set(xlim=middle[0] + np.array([-2, 2]) * half, ylim=middle[1] + np.array([-1, 1]) * half)
    width = (tubes.upper - tubes.lower)[row, -1]
    axes.set_title(
        f"width at the end {100 * np.hypot(*width[:2]):.1f} cm, {width[2]:.2f} rad; "
        f"at least {np.min(tubes.clearance[row]):.2f} m off",
        fontsize=8,
        color=INK,
        loc="left",
    )
