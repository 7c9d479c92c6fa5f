"""The rays of a policy's LiDAR on the robot: their order, their direction, and the ends of the scan."""

from __future__ import annotations

from collections.abc import Sequence
from io import BytesIO

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from viatool.arrays import Floats
from viatool.report.palette import COLOUR
from viatool.world import Lidar

_INK, _FAINT = "#22272e", "#c3c9cf"
_MOST_DRAWN = 90
_LENGTH = 1.0


def draw_rays(lidar: Lidar, outline: Floats, seen: Sequence[float] = (), title: str = "") -> Figure:
    """Draw where rays point, in the order in which the policy observes them.

    Parameters
    ----------
    lidar : Lidar
        The LiDAR.
    outline : ndarray
        (P, 2) corners of the robot in its frame, in metres.
    seen : sequence of float
        Readings of the rays in metres, if there are some: drawn as dots.
    title : str
        Above it.
    """
    figure = Figure(figsize=(6.0, 6.4), layout="constrained")
    axes = figure.add_subplot()
    angles = lidar.angles()
    readings = np.asarray(seen, dtype=np.float64)
    shown = readings.size == angles.size
    near = readings[np.isfinite(readings) & (readings >= lidar.minimum_range)] if shown else readings[:0]
    length = float(np.quantile(near, 0.7)) if near.size else max(_LENGTH, 3.0 * float(np.abs(outline).max()))
    every = max(1, -(-angles.size // _MOST_DRAWN))
    for number in range(0, angles.size, every):
        axes.plot(*_ray(angles[number], length), color=_FAINT, lw=0.7, zorder=1)
    last = angles.size - 1
    ends = (("first", 0, COLOUR["safe"], "-", 1.12), ("last", last, COLOUR["unsafe"], (0, (3, 2)), 1.22))
    for name, number, colour, line, reach in ends:
        label = f"{name} ray, number {number}, at {np.degrees(angles[number]):.1f} degrees"
        axes.plot(*_ray(angles[number], reach * length), color=colour, lw=2.2, ls=line, zorder=3, label=label)
    _arrow(axes, angles, 0.55 * length)
    axes.add_patch(Polygon(outline, closed=True, facecolor=_INK, alpha=0.25, edgecolor=_INK, zorder=4))
    axes.annotate(
        "", (0.5 * length, 0.0), (0.0, 0.0), arrowprops={"arrowstyle": "->", "lw": 2.0, "color": _INK}
    )
    axes.annotate("ahead, x", (0.5 * length, 0.0), (4, 4), textcoords="offset points", fontsize=9)
    axes.annotate("left, y", (0.0, 0.4 * length), ha="center", fontsize=9, color=_INK)
    if shown:
        kept = np.isfinite(readings) & (readings <= 1.3 * length)
        axes.plot(
            *(readings[kept] * np.stack([np.cos(angles[kept]), np.sin(angles[kept])])), ".", ms=4, color=_INK
        )
    axes.legend(loc="lower left", fontsize=9, framealpha=0.9)
    axes.set_title(title.replace("$", r"\$"), fontsize=9, color=_INK)
    axes.set(xlabel="x [m], ahead", ylabel="y [m], to the left", aspect="equal")
    axes.set_xlim(-1.35 * length, 1.35 * length)
    axes.set_ylim(-1.35 * length, 1.35 * length)
    return figure


def rays_picture(lidar: Lidar, outline: Floats, seen: Sequence[float] = (), title: str = "") -> bytes:
    """Return `draw_rays` as a png."""
    content = BytesIO()
    draw_rays(lidar, outline, seen, title).savefig(
        content, dpi=140, format="png", metadata={"Software": None}
    )
    return content.getvalue()


def _ray(angle: float, length: float) -> tuple[list[float], list[float]]:
    return [0.0, length * np.cos(angle)], [0.0, length * np.sin(angle)]


def _arrow(axes: object, angles: Floats, radius: float) -> None:
    """Draw which way rays follow each other, over an eighth of the scan."""
    end = max(2, angles.size // 8)
    if angles.size < end or angles.size < 2:
        return
    turned = np.unwrap(angles[:end])
    x, y = radius * np.cos(turned), radius * np.sin(turned)
    axes.plot(x, y, color=COLOUR["safe"], lw=1.5, zorder=3)  # type: ignore[attr-defined]  # of matplotlib
    axes.annotate(  # type: ignore[attr-defined]
        "",
        (x[-1], y[-1]),
        (x[-2], y[-2]),
        arrowprops={"arrowstyle": "->", "color": COLOUR["safe"], "lw": 2.0},
    )
