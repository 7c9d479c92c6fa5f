"""Sentences about a run that several reporters share."""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction
from typing import Any

import numpy as np

from viatool.report.document import HorizonDocument, RateByOutcome, ReportDocument, RunDocument
from viatool.report.numbers import MISSING, count, counted, percent_of, percentage, seconds, significant
from viatool.report.palette import VERDICTS

ARITHMETIC = {
    "float32": "float32: bounds cover the rounding of the deployed program, in any order of summation",
    "real": "real: bounds hold for the exact network, not for the rounding of the deployed program",
}
CRITERION = {
    "swept": "swept: every action of the reachable box and every instant of the control interval",
    "braking": "braking: swept, and a full stop at the robot's deceleration afterwards stays clear",
    "sampled": "sampled: nine actions and sampled instants, as in the paper; not a proof",
}


def describe_eps(eps: Any) -> str:
    """Write the sensor error in words: one radius, or one for each channel."""
    if isinstance(eps, Mapping):
        parts = [f"{name or 'default'}={significant(float(radius), 6)}" for name, radius in eps.items()]
        return ", ".join(parts)
    if isinstance(eps, int | float):
        return significant(float(eps), 6)
    return str(eps)


HORIZON_COLUMNS = (
    "interval",
    "proved safe up to it",
    "position [m], median",
    "90th percentile",
    "heading [rad], median",
    "90th percentile",
    "least clearance [m]",
)


def rate_rows(document: ReportDocument) -> dict[str, RateByOutcome]:
    """Return the rates of safe states by what they count, in the order in which they are shown."""
    return {
        f"{document.criterion}, collision distance": document.safety_rate,
        f"{document.criterion}, danger distance": document.danger_rate,
        "sampled (9 actions), not a proof": document.sampled_safety_rate,
        "contested states only": document.contested_rate,
    }


def describe_task(document: ReportDocument) -> str:
    """Write in words how the episodes ended."""
    task = document.task
    shares = [
        f"{_share(getattr(task, f'{outcome}_rate'))} {outcome}"
        for outcome in ("success", "collision", "timeout")
    ]
    cost = "" if task.average_cost is None else f"; average cost {significant(task.average_cost)}"
    return f"{counted(task.episodes, 'episode')}: {', '.join(shares)}{cost}"


def describe_horizon(horizon: HorizonDocument) -> str:
    """Write in words over which intervals, and from which poses, the closed loop was followed."""
    error = horizon.pose_error
    within = ""
    if error.position or error.heading:
        within = (
            f", from any pose within {significant(error.position)} m and {significant(error.heading)} rad"
        )
    return f"{counted(horizon.steps, 'interval')}, LiDAR in the loop{within}"


def describe_verdicts(horizon: HorizonDocument) -> str:
    """Write in words how many states have each verdict over a horizon."""
    return ", ".join(f"{count(int(getattr(horizon.verdicts, name)))} {name}" for name in VERDICTS)


def horizon_rows(horizon: HorizonDocument) -> list[tuple[str, ...]]:
    """Return the intervals of a horizon: number, share proved safe up to it, widths of the tubes, clearance."""
    position, heading = horizon.width["position"], horizon.width["heading"]
    rows = []
    for k in _shown_steps(horizon.steps):
        rate = horizon.safety_rate[k]
        figures = (
            position.median[k], position.p90[k], heading.median[k], heading.p90[k], horizon.least_clearance[k]
        )  # fmt: skip
        texts = (MISSING if figure is None else significant(figure) for figure in figures)
        rows.append((str(k + 1), percentage(rate.safe, rate.total), *texts))
    return rows


def _shown_steps(steps: int) -> list[int]:
    """Return the intervals of which a table tells: all, or a dozen of many."""
    return sorted({round(k) for k in np.linspace(0, steps - 1, min(steps, 12)).tolist()})


def _share(share: float | None) -> str:
    return MISSING if share is None else percent_of(Fraction(share).limit_denominator(10**9), 1)


def assumptions(document: ReportDocument) -> dict[str, str]:
    """List what a verdict of the report rests on, by name."""
    listed = {
        "criterion": CRITERION.get(document.criterion, document.criterion),
        "arithmetic": ARITHMETIC.get(document.arithmetic, document.arithmetic),
        "engine": _flat(document.engine),
    }
    for name, value in (document.model_extra or {}).get("assumptions", {}).items():
        listed[name.replace("_", " ")] = _flat(value)
    return listed


def settings(document: ReportDocument) -> dict[str, str]:
    """List what a run was asked for, by name: reports with other settings answer other questions."""
    listed = assumptions(document)
    return {
        "map": document.map.sha256[:12],
        "eps": describe_eps(document.eps),
        **listed,
        "criterion": document.criterion,
        "arithmetic": document.arithmetic,
    }


def _flat(value: Any) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{name.replace('_', ' ')} {_flat(part)}" for name, part in value.items())
    if isinstance(value, float):
        return significant(value, 6)
    return "none" if value is None else str(value)


def total_seconds(document: RunDocument) -> float:
    """Return the seconds of a run: as the report says, or the sum over its stages."""
    return document.seconds.get("total", sum(document.seconds.values()))


def identities(document: RunDocument) -> dict[str, str]:
    """List which files were examined, with which versions, and in which time."""
    stages = [f"{stage} {seconds(value)}" for stage, value in document.seconds.items() if stage != "total"]
    return {
        "policy": document.policy.path,
        "policy sha256": document.policy.sha256,
        "map": document.map.path,
        "map sha256": document.map.sha256,
        "versions": ", ".join(f"{name} {version}" for name, version in document.versions.items()),
        "time": ", ".join([*stages, f"total {seconds(total_seconds(document))}"]),
    }


def unit_of(document: ReportDocument, action: str) -> str:
    """Return the unit of an action, as the report names it (nothing if it does not)."""
    width = document.reachable_width[action]
    return str((width.model_extra or {}).get("unit", ""))
