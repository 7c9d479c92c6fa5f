"""Margins as a picture: the proved and the refuted share of the contested states against the error."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from viatool.report.drawing import FAINT, INK
from viatool.report.foreign import one_line
from viatool.report.margins.curves import between, proved_curve, withstood_curve
from viatool.report.numbers import count

if TYPE_CHECKING:
    from viatool.report.margins.document import MarginsDocument

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#22272E")
"""Of the policies, told apart by people with any colour vision (Okabe and Ito's set)."""


def draw_margins(document: MarginsDocument) -> Figure:
    """Draw the curves of all policies: what is proved falls, what is not refuted falls later."""
    figure = Figure(figsize=(8.0, 4.8), layout="constrained", facecolor="white")
    axes = figure.add_subplot()
    varied = document.record.varied
    handles = []
    for number, (name, part) in enumerate(zip(document.names, document.record.margins, strict=True)):
        colour = COLOURS[number % len(COLOURS)]
        if part.contested_states:
            kept, withstood = proved_curve(part, varied.most), withstood_curve(part, varied.most)
            axes.step(*kept, where="post", color=colour, lw=1.6)
            axes.step(*withstood, where="post", color=colour, lw=1.2, ls="--")
            axes.fill_between(*between(kept, withstood), step="post", color=colour, alpha=0.15, lw=0)
        close = f", {count(part.close.contested)} close places" if part.close.contested else ""
        label = f"{_plain(name)}: {count(part.contested)} of {count(part.states)} states{close}"
        handles.append(Line2D([], [], color=colour, lw=1.6, label=label))
    handles += [
        Line2D([], [], color=INK, lw=1.6, label="proved safe"),
        Line2D([], [], color=INK, lw=1.2, ls="--", label="not refuted"),
    ]
    unit = f" [{_plain(varied.unit)}]" if varied.unit else ", in the unit of each channel"
    axes.set_xlabel(f"error{unit}", fontsize=9, color=INK)
    axes.set_ylabel("share of the contested states [%]", fontsize=9, color=INK)
    axes.set(xlim=(0.0, varied.most), ylim=(0.0, 1.03))
    axes.set_yticks(np.linspace(0.0, 1.0, 6), [f"{share:.0f}" for share in np.linspace(0.0, 100.0, 6)])
    axes.tick_params(length=2, labelsize=8, colors=INK)
    axes.grid(color=FAINT, lw=0.4)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    axes.legend(handles=handles, fontsize=8, frameon=False, loc="lower left")
    title = (
        f"{document.record.map.path}, criterion {document.record.criterion}: {', '.join(varied.proportions)}"
    )
    axes.set_title(_plain(title, 110), fontsize=8, color=INK)
    return figure


def _plain(text: str, most: int = 60) -> str:
    """Return a foreign text for matplotlib: one line, no formulas, not too long."""
    line = one_line(text).replace("$", r"\$")
    return line if len(line) <= most else f"{line[: most - 1]}…"
