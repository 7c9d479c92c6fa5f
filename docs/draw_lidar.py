"""Draw the pictures of lidar.md with the rays that a specification has.

python docs/draw_lidar.py  # writes docs/images/lidar.svg and docs/images/lidar-bins.svg
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon, Wedge

from viatool.channels.channel import LidarSpecification

IMAGES = Path(__file__).resolve().parent / "images"
INK, FAINT, FIRST, LAST, BINS = "#22272e", "#9aa3ad", "#0072b2", "#d55e00", ("#56b4e9", "#e69f00", "#009e73")
TURN = 2.0 * math.pi
PANELS: dict[str, dict[str, Any]] = {
    "field_of_view: 3.14159, rays: 9": {"field_of_view": math.pi, "rays": 9},
    "the same, order: clockwise": {"field_of_view": math.pi, "rays": 9, "order": "clockwise"},
    "start: 0.0, step: 0.7854, rays: 8\n(0 to 2 pi without the end)": {
        "start": 0.0, "step": TURN / 8, "rays": 8,
    },
    "start: 0.0, step: 0.8976, rays: 8\n(0 to 2 pi with the end: refused)": {
        "start": 0.0, "step": TURN / 7, "rays": 8,
    },
}  # fmt: skip


def angles_of(lidar: dict[str, Any]) -> np.ndarray:
    """Return where the rays point; a specification with a ray twice is none, but can be drawn."""
    if lidar.get("step") == TURN / 7:
        return lidar["start"] + lidar["step"] * np.arange(lidar["rays"])
    return LidarSpecification(maximum_range=1.0, **lidar).lidar().angles()


def robot(axes: Axes) -> None:
    """Draw the robot and its frame: x ahead (to the right of the picture), y to its left."""
    axes.add_patch(Polygon([[0.2, 0.0], [-0.13, 0.14], [-0.13, -0.14]], facecolor=INK, alpha=0.85, zorder=5))
    for x, y, name in ((0.62, 0.0, "x, ahead"), (0.0, 0.62, "y, left")):
        axes.annotate("", (x, y), (0, 0), arrowprops={"arrowstyle": "-|>", "color": INK, "lw": 1.4}, zorder=4)
        axes.text(x + 0.03, y + 0.05, name, fontsize=8, color=INK, zorder=6)
    axes.set(xlim=(-1.35, 1.35), ylim=(-1.35, 1.35), aspect="equal")
    axes.axis("off")


def rays(axes: Axes, angles: np.ndarray) -> None:
    """Draw rays with their numbers, and an arc from the first on that tells their order."""
    seen: dict[int, list[int]] = {}
    for number, angle in enumerate(angles):
        seen.setdefault(round(math.degrees(angle) * 10) % 3600, []).append(number)
    last = len(angles) - 1
    for numbers in seen.values():
        angle = angles[numbers[0]]
        colour = FIRST if 0 in numbers else LAST if last in numbers else FAINT
        x, y = math.cos(angle), math.sin(angle)
        axes.plot([0, x], [0, y], color=colour, lw=2.2 if colour != FAINT else 1.2, zorder=2)
        text = " = ".join(map(str, numbers))
        colour = LAST if len(numbers) > 1 else colour if colour != FAINT else INK
        axes.text(1.15 * x, 1.15 * y, text, ha="center", va="center", color=colour, fontsize=9, weight="bold")
    arc = np.linspace(angles[0], angles[0] + 2.4 * (angles[1] - angles[0]), 30)
    axes.plot(0.8 * np.cos(arc), 0.8 * np.sin(arc), color=FIRST, lw=1.5, zorder=3)
    ends = [0.8 * np.array([math.cos(a), math.sin(a)]) for a in arc[[-2, -1]]]
    axes.annotate("", ends[1], ends[0], arrowprops={"arrowstyle": "-|>", "color": FIRST, "lw": 1.5}, zorder=3)


def conventions() -> Figure:
    """Draw order, direction and ends."""
    figure = Figure(figsize=(9.0, 9.4), layout="constrained", facecolor="white")
    for axes, (title, lidar) in zip(figure.subplots(2, 2).flat, PANELS.items(), strict=True):
        robot(axes)
        rays(axes, angles_of(lidar))
        axes.set_title(title, fontsize=10, family="monospace", color=INK)
    return figure


def bins() -> Figure:
    """Draw nine rays in three bins at a wall and a post."""
    figure = Figure(figsize=(9.0, 4.2), layout="constrained", facecolor="white")
    left, right = figure.subplots(1, 2, width_ratios=(1.0, 1.2))
    angles = angles_of({"field_of_view": math.pi, "rays": 9})
    ranges = np.array([0.95, 0.9, 1.0, 0.9, 0.55, 0.9, 1.1, 1.05, 1.1])
    for group, colour in enumerate(BINS):
        ends = np.degrees(angles[[3 * group, 3 * group + 2]])
        left.add_patch(Wedge((0, 0), 1.18, ends[0] - 5, ends[1] + 5, facecolor=colour, alpha=0.25))
        middle = math.radians(ends.mean())
        left.text(
            1.3 * math.cos(middle), 1.28 * math.sin(middle), f"bin {group}", ha="center", va="center",
            fontsize=9, weight="bold", color=INK,
        )  # fmt: skip
    for number, (angle, reading) in enumerate(zip(angles, ranges, strict=True)):
        x, y = reading * math.cos(angle), reading * math.sin(angle)
        colour = BINS[number // 3]
        left.plot([0, x], [0, y], color=colour, lw=1.4)
        left.plot([x], [y], "o", color=colour, ms=5)
        right.bar(number, reading, color=colour, alpha=0.55, width=0.8)
    robot(left)
    left.set(xlim=(-0.4, 1.5))
    for group, least in enumerate(ranges.reshape(3, 3).min(axis=1)):
        right.plot([3 * group - 0.45, 3 * group + 2.45], [least, least], color=INK, lw=2.2)
        right.text(3 * group + 1, 0.04, f"bin {group} reads {least:g}", ha="center", fontsize=9, color=INK)
    right.set(xticks=range(9), xlabel="ray", ylabel="range [m]", ylim=(0, 1.3))
    right.spines[["top", "right"]].set_visible(False)
    left.set_title("rays: 9, bins: 3", fontsize=10, family="monospace", color=INK)
    right.set_title("reduce: minimum", fontsize=10, family="monospace", color=INK)
    return figure


if __name__ == "__main__":
    with mpl.rc_context({"svg.hashsalt": "viatool", "svg.fonttype": "none", "font.family": "sans-serif"}):
        for name, figure in (("lidar", conventions()), ("lidar-bins", bins())):
            figure.savefig(IMAGES / f"{name}.svg", metadata={"Date": None})
