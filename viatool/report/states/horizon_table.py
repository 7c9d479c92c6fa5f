"""The table of what was found of the intervals after each state."""

from __future__ import annotations

import numpy as np

from viatool.report.numbers import MISSING, count, counted, significant
from viatool.report.palette import VERDICTS
from viatool.report.sections import Table
from viatool.report.states.record import HorizonRecord

HORIZON_COLUMNS = (
    "interval",
    "proved safe up to it",
    "position [m], median",
    "90th percentile",
    "heading [rad], median",
    "90th percentile",
    "least clearance [m]",
)


def horizon_table(horizon: HorizonRecord) -> Table:
    """Return the closed loop over several intervals: share proved safe up to each, widths, clearance."""
    position, heading = horizon.width["position"], horizon.width["heading"]
    rows = []
    for k in _shown_steps(horizon.steps):
        figures = (
            position.median[k], position.p90[k], heading.median[k], heading.p90[k], horizon.least_clearance[k]
        )  # fmt: skip
        texts = (MISSING if figure is None else significant(figure) for figure in figures)
        rows.append((str(k + 1), horizon.safety_rate[k].share.percentage(), *texts))
    verdicts = ", ".join(f"{count(int(getattr(horizon.verdicts, name)))} {name}" for name in VERDICTS)
    return Table(HORIZON_COLUMNS, tuple(rows), "Horizon", f"{verdicts} over {_describe_horizon(horizon)}")


def _describe_horizon(horizon: HorizonRecord) -> str:
    """Write in words over which intervals, and from which poses, the closed loop was followed."""
    error = horizon.pose_error
    within = ""
    if error.position or error.heading:
        within = (
            f", from any pose within {significant(error.position)} m and {significant(error.heading)} rad"
        )
    return f"{counted(horizon.steps, 'interval')}, LiDAR in the loop{within}"


def _shown_steps(steps: int) -> list[int]:
    """Return the intervals of which a table tells: all, or a dozen of many."""
    return sorted({round(k) for k in np.linspace(0, steps - 1, min(steps, 12)).tolist()})
