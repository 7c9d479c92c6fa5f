"""Pictures of trainings: learning curves, and the multiplier and the value at risk over the epochs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from io import BytesIO
from statistics import fmean
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from viatool.report.drawing import FAINT, INK
from viatool.studies.variants import EVERY, VARIANTS, Variant

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Curve = Mapping[str, Sequence[float | None]]
Curves = Mapping[str, Mapping[str, Curve]]
"""By variant and metric: ``mean``, ``low`` and ``high`` over the seeds for every epoch."""

DPI = 130
COLOUR = {
    "td3": "#22272E",
    "td7": "#8D949C",
    "sac-lag": "#D55E00",
    "rcpo": "#E69F00",
    "wcsac": "#CC79A7",
    "cvar-cpo": "#8A4F9E",
    "via-0.1": "#56B4E9",
    "via-0.5": "#009E73",
    "via-0.9": "#0072B2",
}
FAMILIES: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("unconstrained", ("td3", "td7")),
    ("expected cost", ("sac-lag", "rcpo")),
    ("CVaR", ("wcsac", "cvar-cpo", "via-0.9")),
    ("VIA by alpha", ("via-0.1", "via-0.5", "via-0.9")),
)
_LEARNING = (
    ("success_rate", "success", (0.5, 1.01)),
    ("collision_rate", "collisions", (0.0, 0.2)),
    ("episode_cost", "cost of an episode", (0.0, None)),
)
SMOOTHED = 5  # epochs of which a noisy curve is the mean
_EXACT = ("multiplier", "var")  # known, not measured on a few episodes
_WILD = 6  # the first sixth of the training does not stretch an axis of costs


def summary_of(values: Sequence[Sequence[float | None]]) -> dict[str, list[float | None]]:
    """Return mean, lowest and highest over the seeds of a metric, epochs first; None where nothing was measured."""
    known = [[value for value in seeds if value is not None] for seeds in values]
    kinds: dict[str, Callable[[list[float]], float]] = {"mean": fmean, "low": min, "high": max}
    return {
        name: [round(kind(seeds), 4) if seeds else None for seeds in known] for name, kind in kinds.items()
    }


def draw_learning(curves: Curves) -> bytes:
    """Draw success, collisions and cost over the epochs: a column for each family of methods."""
    figure, panels = _panels(len(_LEARNING), len(FAMILIES), (13.0, 7.6))
    for row, (metric, label, limits) in enumerate(_LEARNING):
        top = limits[1] if limits[1] is not None else _highest(curves, metric)
        for column, (family, names) in enumerate(FAMILIES):
            axes = panels[row][column]
            _draw_curves(axes, curves, [VARIANTS[name] for name in names], metric)
            axes.set_ylim(limits[0], top)
            if row == 0:
                axes.set_title(family, fontsize=10, color=INK, loc="left")
                if axes.get_lines():
                    axes.legend(fontsize=8, frameon=False, loc="lower right")
            if column == 0:
                axes.set_ylabel(label, fontsize=9, color=INK)
            if row == len(_LEARNING) - 1:
                axes.set_xlabel("epoch", fontsize=9, color=INK)
    return to_png(figure)


def _highest(curves: Curves, metric: str) -> float:
    """Return an upper end of the axis: of lambda and u for all seeds, of costs for the means after the start."""
    bounded = metric in _EXACT
    found = [curve[metric]["high" if bounded else "mean"] for curve in curves.values()]
    kept = [values if bounded else values[len(values) // _WILD :] for values in found]
    known = [value for values in kept for value in values if value is not None]
    return max(known, default=0.0) * (1.05 if bounded else 1.4) or 1.0


def draw_constraint(settings: Mapping[str, tuple[str, Curves, float]]) -> bytes:
    """Draw lambda, u and the CVaR of the cost over the epochs: a column for each setting.

    Parameters
    ----------
    settings : mapping
        By name: title, curves and the limit b.
    """
    constrained = [variant for variant in EVERY if variant.family != "unconstrained"]
    tracking = [variant for variant in constrained if variant.method in ("cvar-cpo", "via")]
    rows = (
        ("multiplier", "lambda", constrained),
        ("var", "u", tracking),
        ("cvar", "CVaR of the cost, at each method's own alpha", constrained),
    )
    figure, panels = _panels(len(rows), len(settings), (6.5 * len(settings), 8.4))
    for column, (title, curves, limit) in enumerate(settings.values()):
        for row, (metric, label, variants) in enumerate(rows):
            axes = panels[row][column]
            _draw_curves(axes, curves, variants, metric)
            axes.set_ylim(0.0, _highest(curves, metric))
            axes.set_ylabel(label, fontsize=9, color=INK)
            if metric == "cvar":
                axes.axhline(limit, color=INK, lw=0.9, ls=(0, (4, 3)))
                axes.annotate(
                    f"b = {limit:g}", (0.99, limit), xycoords=("axes fraction", "data"), ha="right", va="bottom",
                    fontsize=8, color=INK, annotation_clip=True, zorder=5,
                    bbox={"facecolor": "white", "alpha": 0.8, "edgecolor": "none", "pad": 1.0},
                )  # fmt: skip
                axes.set_xlabel("epoch", fontsize=9, color=INK)
        panels[0][column].set_title(title, fontsize=10, color=INK, loc="left")
    handles, labels = panels[0][0].get_legend_handles_labels()
    if handles:
        figure.legend(handles, labels, loc="outside lower center", ncols=7, fontsize=8, frameon=False)
    return to_png(figure)


def _draw_curves(axes: Axes, curves: Curves, variants: Sequence[Variant], metric: str) -> None:
    for variant in variants:
        if variant.name not in curves:
            continue
        mean, low, high = (
            np.array(curves[variant.name][metric][name], dtype=np.float64) for name in ("mean", "low", "high")
        )
        known = np.isfinite(mean)
        epochs, colour = np.flatnonzero(known) + 1, COLOUR[variant.name]
        if metric not in _EXACT:
            mean, low, high = (_smoothed(values[known]) for values in (mean, low, high))
        axes.fill_between(epochs, low, high, color=colour, alpha=0.1, lw=0)
        axes.plot(epochs, mean, color=colour, lw=1.5, label=variant.title)


def _smoothed(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the mean over `SMOOTHED` epochs around each, fewer at the ends."""
    window = np.ones(min(SMOOTHED, len(values)))
    counts = np.convolve(np.ones(len(values)), window, mode="same")
    averages: NDArray[np.float64] = np.convolve(values, window, mode="same") / counts
    return averages


def _panels(rows: int, columns: int, size: tuple[float, float]) -> tuple[Figure, list[list[Axes]]]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, layout="constrained", facecolor="white")
    panels = [
        [figure.add_subplot(rows, columns, row * columns + column + 1) for column in range(columns)]
        for row in range(rows)
    ]
    for axes in (axes for row in panels for axes in row):
        axes.grid(color=FAINT, lw=0.5, alpha=0.7)
        axes.tick_params(length=2, labelsize=8, colors=INK)
        for side in ("top", "right"):
            axes.spines[side].set_visible(False)
    return figure, panels


def to_png(figure: Any) -> bytes:
    """Return a picture; the same figure gives the same bytes."""
    content = BytesIO()
    figure.savefig(content, format="png", dpi=DPI, metadata={"Software": None})
    return content.getvalue()
