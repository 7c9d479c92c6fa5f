"""The figures of the report against the state table, counted again as integers."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from viatool.recheck.evidence import StoredEvidence, TablePart
from viatool.recheck.outcome import Outcome

_VERDICTS = ("safe", "unsafe", "unknown")
_OUTCOMES = ("success", "collision", "timeout")
_NONE = np.zeros(0, dtype=bool)

Booleans = NDArray[np.bool_]
Figures = dict[str, tuple[Any, Any]]
"""What is stated, and what is counted, by name."""


def check_sums(evidence: StoredEvidence, found: Outcome) -> None:
    """Count the state table again, and compare it with the report."""
    report, driven, before = evidence.report, evidence.driven, len(found.contradicted)
    figures = {
        **_verdicts(driven),
        **_rates(report, driven),
        **_task(report, driven.table["outcome"]),
        **_close_places(report, evidence.close),
        **_horizon(report, driven.table),
    }
    for name, (stated, counted) in figures.items():
        found.expect(stated == counted, f"report.json: {name} is {stated}, states.npz gives {counted}")
    for part in evidence.parts:
        settled = (part.table["verdict"] == "safe") | part.table["contested"]
        found.expect(
            bool(settled.all()), f"states.npz: a {part.name} is not safe though no command could fail"
        )
    if "horizon" in report:
        found.not_rechecked.append("verdicts over the horizon, beyond their sums")
    if len(found.contradicted) == before:
        found.confirmed.append(f"{len(figures)} figures of the report are those of the state table")


def _counts(verdict: NDArray[Any]) -> dict[str, int]:
    return {name: int((verdict == name).sum()) for name in _VERDICTS}


def _rate(holds: Booleans, counted: Booleans) -> dict[str, Any]:
    """Return a rate as the report has it, from integers."""
    part, total = int((holds & counted).sum()), int(counted.sum())
    return {"safe": part, "total": total, "rate": part / total if total else None}


def _by_outcome(part: TablePart, holds: Booleans, counted: Booleans) -> dict[str, Any]:
    """Return a rate over all that count, and by the outcome of their episodes."""
    outcome = part.table["outcome"][part.table["episode"]]
    groups = {"overall": counted, **{one: counted & (outcome == one) for one in _OUTCOMES}}
    return {one: _rate(holds, group) for one, group in groups.items()}


def _verdicts(part: TablePart, before: str = "") -> Figures:
    report, verdict = part.report, part.table["verdict"]
    unsafe = np.flatnonzero(verdict == "unsafe").tolist()
    return {
        f"{before}states": (report["states"], len(verdict)),
        f"{before}verdicts": (report["verdicts"], _counts(verdict)),
        f"{before}unsafe_states": ([one["state"] for one in report["unsafe_states"]], unsafe),
    }


def _rates(report: dict[str, Any], part: TablePart) -> Figures:
    """Return every rate, and what was at stake."""
    table = part.table
    safe, contested = table["verdict"] == "safe", table["contested"]
    everything = np.ones(len(safe), dtype=bool)
    each = {
        "safety_rate": (safe, everything),
        "danger_rate": (table["danger"], everything),
        "sampled_safety_rate": (table["sampled"], everything),
        "contested_rate": (safe, contested),
    }
    figures: Figures = {name: (report[name], _by_outcome(part, *counted)) for name, counted in each.items()}
    if "stake" in report:
        stake = {"contested": int(contested.sum()), "states": len(safe)}
        figures["stake"] = {name: report["stake"][name] for name in stake}, stake
    return figures


def _task(report: dict[str, Any], outcome: NDArray[Any]) -> Figures:
    known = outcome[outcome != "unknown"]
    shares = {f"{one}_rate": float((known == one).mean()) if len(known) else None for one in _OUTCOMES}
    counted = {"episodes": len(outcome), **shares}
    return {"task": ({name: report["task"][name] for name in counted}, counted)}


def _close_places(report: dict[str, Any], part: TablePart | None) -> Figures:
    """Return the figures of close places, where there are any: a rate without places is none."""
    stated = report.get("close_rate")
    if part is None:
        none = {one: _rate(_NONE, _NONE) for one in ("overall", *_OUTCOMES)}
        return {} if stated is None else {"close_rate": (stated, none)}
    safe = part.table["verdict"] == "safe"
    return {
        "close_rate": (stated, _by_outcome(part, safe, part.table["contested"])),
        **_verdicts(part, "close."),
    }


def _horizon(report: dict[str, Any], table: dict[str, NDArray[Any]]) -> Figures:
    if "horizon" not in report:
        return {}
    stated, steps = report["horizon"], table["horizon_steps"]
    everything = np.ones(len(steps), dtype=bool)
    proved = [_rate(steps >= step, everything) for step in range(1, stated["steps"] + 1)]
    return {
        "horizon.safety_rate": (stated["safety_rate"], proved),
        "horizon.verdicts": (stated["verdicts"], _counts(table["horizon_verdict"])),
    }
