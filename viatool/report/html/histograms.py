"""Distributions over the states of a result, each with the words that say of which ones."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from bokeh.models import ColumnDataSource, Range1d
from bokeh.plotting import figure

from viatool.arrays import Booleans, Floats
from viatool.report.html.canvas import framed, themed
from viatool.report.html.states import clearances
from viatool.report.numbers import count
from viatool.report.palette import VERDICTS

if TYPE_CHECKING:
    from viatool.verification.result import Result

BINS = 40


@dataclass(frozen=True)
class Distribution:
    """A distribution over states, and in words which ones."""

    plot: figure
    caption: str

    @property
    def name(self) -> str:
        """Return what the figure is called."""
        return str(self.plot.name)


def histograms(every: Result, driven: int) -> list[Distribution]:
    """Return the distributions over the driven states: widths of both commands, clearance; and over close places."""
    units, widths, kept = every.actions, every.reachable.width, clearances(every)
    states = _Those(every, np.arange(len(every.trajectory)) < driven, "driven states")
    if not every.trajectory.connected:
        states = replace(states, called="states")
    found = [
        states.histogram("histogram-v", "width of v", units[0].unit, widths[:, 0]),
        states.histogram("histogram-omega", "width of ω", units[1].unit, widths[:, 1]),
        states.histogram("histogram-clearance", "clearance at the pose", "m", kept),
    ]
    if not states.chosen.all():
        beside = _Those(every, ~states.chosen, "close places")
        found.append(beside.histogram("histogram-close", "clearance at the place", "m", kept))
    return found


@dataclass(frozen=True)
class _Those:
    """Some of the states of a result, and what they are called."""

    result: Result
    chosen: Booleans
    called: str

    def histogram(self, name: str, what: str, unit: str, values: Floats) -> Distribution:
        """Stack the counts of the verdicts; a square root keeps the few that are not safe in sight."""
        plot = framed(name, f"{what} [{unit}]", self.called, height=210)
        finite = self.chosen & np.isfinite(values)
        edges = (
            np.histogram_bin_edges(values[finite], BINS) if finite.any() else np.linspace(0.0, 1.0, BINS + 1)
        )
        floor = np.zeros(len(edges) - 1)
        for verdict in reversed(VERDICTS):
            counts = np.histogram(values[finite & (self.result.verdict == verdict)], edges)[0]
            source = ColumnDataSource(
                {
                    "left": edges[:-1],
                    "right": edges[1:],
                    "bottom": np.sqrt(floor),
                    "top": np.sqrt(floor + counts),
                },
                name=f"{name}-{verdict}",
            )
            bars = plot.quad("left", "right", "bottom", "top", source=source, line_width=0)
            themed(bars.glyph, fill_color=verdict)
            floor = floor + counts
        ticks = _root_ticks(float(floor.max(initial=1.0)))
        plot.yaxis.ticker = [float(np.sqrt(tick)) for tick in ticks]
        plot.yaxis.major_label_overrides = {float(np.sqrt(tick)): f"{tick:,}" for tick in ticks}
        plot.y_range = Range1d(0.0, 1.05 * float(np.sqrt(floor.max(initial=1.0))))
        counted, total = int(finite.sum()), int(self.chosen.sum())
        bounded = "all" if counted == total else f"the {count(counted)} bounded ones of"
        return Distribution(plot, f"{what[0].upper()}{what[1:]}, {bounded} {count(total)} {self.called}")


def _root_ticks(largest: float) -> list[int]:
    """Return round counts from 0 to the largest, evenly spread on a square-root axis."""
    ticks = [0]
    for share in (0.06, 0.25, 0.56, 1.0):
        power = 10 ** int(np.floor(np.log10(max(share * largest, 1.0))))
        tick = int(share * largest // power * power)
        if tick > ticks[-1]:
            ticks.append(tick)
    return ticks
