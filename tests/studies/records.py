"""Records of trainings and evaluations as the tasks leave them, without training anything."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from viatool.studies.study import Options
from viatool.studies.tasks import Record, Task
from viatool.studies.training import CURVES, EvaluateSeed, TrainVariant

OUTCOMES = ("overall", "success", "collision", "timeout")


def rate(safe: int, total: int) -> dict[str, Any]:
    return {"safe": safe, "total": total, "rate": safe / total if total else None}


def by_outcome(safe: int, total: int, collision: tuple[int, int]) -> dict[str, Any]:
    none = rate(0, 0)
    rest = rate(safe - collision[0], total - collision[1])
    return {"overall": rate(safe, total), "success": rest, "collision": rate(*collision), "timeout": none}


def report(success: float, collision: float, cost: float, safe: int) -> dict[str, Any]:
    """Return a report of 1000 states; 10 of them belong to collisions, if there are any."""
    states = by_outcome(safe, 1000, (5, 10) if collision else (0, 0))
    shares = {"success_rate": success, "collision_rate": collision, "timeout_rate": 1 - success - collision}
    return {
        "states": 1000,
        "safety_rate": states,
        "sampled_safety_rate": states,
        "danger_rate": by_outcome(safe - 20, 1000, (2, 10) if collision else (0, 0)),
        "contested_rate": by_outcome(3, 10, (0, 0)),
        "task": {"episodes": 10, **shares, "average_cost": cost},
        "reachable_width": {"v": {"mean": 0.004}, "omega": {"mean": 0.125}},
        "costs": [cost] * 10,
        "cvar": {"0.1": cost, "0.5": cost * 2, "0.9": cost * 10},
    }


def path(outcome: str = "success") -> dict[str, Any]:
    states = [[0.1 * step, 0.0, 0.0, 0.4, -0.1, 0.45, 0.1] for step in range(12)]
    return {"outcome": outcome, "states": states}


def evaluation(seed: int, success: float, collision: float, cost: float, safe: int) -> dict[str, Any]:
    found = report(success, collision, cost, safe)
    paths = [path(), path("timeout"), *(path() for _ in range(8))]
    return {"seed": seed, "epoch": 4, "fixed": report(1.0, 0.0, 0.0, 1000), "held_out": found, "paths": paths}


def training(seeds: int, multiplier: Sequence[float]) -> dict[str, Any]:
    """Return a training whose lambda takes these values, the same for all seeds."""
    curves: dict[str, Any] = {name: [[0.5] * seeds] * len(multiplier) for name in CURVES}
    curves["multiplier"] = [[value] * seeds for value in multiplier]
    return {"chosen": [4] * seeds, "curves": curves, "versions": {"python": "3.11.7", "viatool": "0.1.0"}}


def records_of(
    tasks: Sequence[Task], quality: Mapping[str, tuple[float, float, float, int]]
) -> dict[str, Record]:
    """Return records for the variants of `quality`: success, collisions, cost, safe states; seeds differ a little."""
    records: dict[str, Record] = {}
    for task in tasks:
        if isinstance(task, TrainVariant) and task.folder.partition("/")[2] in quality:
            result = training(task.configuration.seeds, [0.2, 0.1, 0.0, 0.0])
        elif isinstance(task, EvaluateSeed) and task.training.folder.partition("/")[2] in quality:
            success, collision, cost, safe = quality[task.training.folder.partition("/")[2]]
            shift = task.seed * 0.01
            result = evaluation(task.seed, success - shift, collision, cost + shift, safe - task.seed)
        else:
            continue
        records[task.name] = Record(task.name, {"cost_limit": 0.5}, result, 60.0, "2026-11-25")
    return records


THREE_SEEDS = Options(seeds=3)
