"""A diagnosis as a picture: how each reading does, and the paths as specified and under the best reading."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from viatool.report.drawing import INK, draw_floor
from viatool.report.foreign import one_line
from viatool.report.numbers import percentage
from viatool.report.palette import COLOUR

if TYPE_CHECKING:
    from viatool.doctor import Diagnosis
    from viatool.report.diagnoses.document import DiagnosisDocument
    from viatool.report.diagnoses.record import ReadingRecord
    from viatool.simulate import Drive

_OUTCOMES = {"success": COLOUR["safe"], "timeout": COLOUR["unknown"], "collision": COLOUR["unsafe"]}
_BARS = 14
_LETTERS = 46


def draw_diagnosis(diagnosis: Diagnosis, document: DiagnosisDocument) -> Figure:
    """Draw a diagnosis."""
    drives = diagnosis.drives
    figure = Figure(figsize=(12.0 if drives else 9.0, 6.4), layout="constrained")
    grid = figure.add_gridspec(
        max(len(drives), 1), 2 if drives else 1, width_ratios=(1.9, 1.0)[: 1 + bool(drives)]
    )
    _draw_bars(figure.add_subplot(grid[:, 0]), document)
    shown = [document.specified, document.best]
    for row, (drive, reading) in enumerate(zip(drives, shown, strict=False)):
        _draw_paths(figure.add_subplot(grid[row, 1]), diagnosis, drive, reading)
    found = document.finding
    figure.suptitle(_plain(found[0].upper() + found[1:], 150), fontsize=9, color=INK)
    return figure


def _draw_bars(axes: Axes, document: DiagnosisDocument) -> None:
    readings = document.record.readings[:_BARS]
    if document.specified not in readings:
        readings = [*readings[:-1], document.specified]
    places = np.arange(len(readings))
    if document.record.method == "driven":
        _draw_outcomes(axes, readings)
    else:
        _draw_differences(axes, readings)
    axes.set_yticks(places, [_plain(one.name, _LETTERS) for one in readings], fontsize=7)
    for label, one in zip(axes.get_yticklabels(), readings, strict=True):
        label.set_fontweight("bold" if one is document.best or one is document.specified else "normal")
    axes.invert_yaxis()
    axes.tick_params(length=2, labelsize=7, colors=INK)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def _draw_outcomes(axes: Axes, readings: list[ReadingRecord]) -> None:
    left = np.zeros(len(readings))
    for outcome, colour in _OUTCOMES.items():
        wide = np.array([100.0 * getattr(one.driven, outcome).rate for one in readings])
        axes.barh(np.arange(len(readings)), wide, left=left, color=colour, height=0.7, label=outcome)
        left += wide
    for place, one in enumerate(readings):
        assert one.driven is not None
        ends = [100.0 * end for end in one.driven.success.interval]
        axes.plot(ends, [place, place], color=INK, lw=1.0, marker="|", ms=5)
    axes.set_xlabel("scenarios [%]; the line is the 95 % interval of the goals reached", fontsize=8)
    axes.legend(fontsize=7, loc="upper center", bbox_to_anchor=(0.5, -0.08), ncols=3, frameon=False)


def _draw_differences(axes: Axes, readings: list[ReadingRecord]) -> None:
    for name, height, colour in (("most", 0.7, COLOUR["unknown"]), ("median", 0.35, COLOUR["safe"])):
        wide = [100.0 * getattr(one.compared.difference, name) for one in readings if one.compared]
        label = "nine of ten states stay within" if name == "most" else "median"
        axes.barh(np.arange(len(readings)), wide, color=colour, height=height, label=label)
    axes.set_xlabel("difference of the commands [% of their range]", fontsize=8)
    axes.legend(fontsize=7, loc="upper center", bbox_to_anchor=(0.5, -0.08), ncols=2, frameon=False)


def _draw_paths(axes: Axes, diagnosis: Diagnosis, drive: Drive, reading: ReadingRecord) -> None:
    draw_floor(axes, diagnosis.world_map)
    trajectory = drive.trajectory
    firsts = np.searchsorted(trajectory.episode, np.arange(trajectory.episodes + 1))
    paths = [
        np.vstack([trajectory.poses[first:last, :2], drive.ends[episode, :2]])
        for episode, (first, last) in enumerate(pairwise(firsts.tolist()))
    ]
    for level, (outcome, colour) in enumerate(_OUTCOMES.items()):
        chosen = [path for path, end in zip(paths, trajectory.outcomes, strict=True) if end == outcome]
        axes.add_collection(
            LineCollection(chosen, colors=colour, linewidths=0.8, alpha=0.6, zorder=4 + level)
        )
    share = percentage(reading.share.part, reading.share.total, 0)
    axes.set_title(_plain(f"{reading.name}: {share}", _LETTERS + 8), fontsize=8, color=INK)


def _plain(text: str, most: int) -> str:
    """Return a text that is drawn as it is, on one line."""
    line = one_line(text)
    return (line if len(line) <= most else f"{line[: most - 1]}…").replace("$", r"\$")
