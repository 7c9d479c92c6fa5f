"""Learning curves as lines of text, for a terminal beside a run."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from viatool.arrays import Floats
from viatool.schedule import Progress
from viatool.train.records import METRICS

WIDTH = 48
_LEVELS = "▁▂▃▄▅▆▇█"


@dataclass(frozen=True)
class LearningCurve:
    """A metric and how it is shown: from 0 to `top`, or to its largest value where that is None."""

    metric: str
    title: str
    form: str
    top: float | None = None


CURVES = (
    LearningCurve("success_rate", "success", ".1%", 1.0),
    LearningCurve("collision_rate", "collisions", ".1%", 1.0),
    LearningCurve("validation_success_rate", "validation", ".1%", 1.0),
    LearningCurve("episode_cost", "cost", ".2f"),
    LearningCurve("multiplier", "lambda", ".3f"),
    LearningCurve("var", "u", ".2f"),
)


def draw_curves(metrics: Path, width: int = WIDTH) -> list[str]:
    """Draw the ``metrics.csv`` of a run: one line for each curve, none for what was not measured yet.

    A line shows the mean over the seeds by epoch, and the last value with the range over the seeds.
    """
    if not metrics.exists():
        return []
    with metrics.open(newline="", encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    seeds = len({row["seed"] for row in rows})
    lines = []
    for curve in CURVES:
        values = np.array([float(row.get(curve.metric) or "nan") for row in rows]).reshape(-1, seeds)
        measured = values[np.isfinite(values).all(axis=1)]
        if len(measured):
            last = measured[-1]
            mean, low, high = (format(one, curve.form) for one in (last.mean(), last.min(), last.max()))
            spread = f" ({low} to {high})" if low != high else ""
            line = sparkline(values.mean(axis=1), width, curve.top)
            lines.append(f"{curve.title:>12}  {line:<{width}}  {mean}{spread}")
    return lines


def watching(progress: Progress, directory: Path) -> Progress:
    """Return a progress that draws the curves of a run, or of each of its batches, below every line."""

    def shown(stage: str, done: float, total: float, line: str = "", /) -> None:
        curves = [
            text
            for metrics in sorted([directory / METRICS, *directory.glob(f"batch-*/{METRICS}")])
            for text in draw_curves(metrics)
        ]
        progress(stage, done, total, *(["\n".join([line, *curves])] if line else []))

    return shown


def sparkline(values: Sequence[float] | Floats, width: int, top: float | None = None) -> str:
    """Draw values as blocks from 0 to `top`, by default their largest; NaN is a gap, and groups are averaged."""
    groups = np.array_split(np.asarray(values, dtype=np.float64), min(width, len(values)))
    known = [group[np.isfinite(group)] for group in groups]
    means = [float(group.mean()) if len(group) else None for group in known]
    highest = top or max((mean for mean in means if mean is not None), default=0.0) or 1.0
    return "".join(
        " " if mean is None else _LEVELS[round(min(max(mean / highest, 0.0), 1.0) * (len(_LEVELS) - 1))]
        for mean in means
    )
