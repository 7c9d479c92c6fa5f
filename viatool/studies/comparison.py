"""The data of a comparison: for every variant its metrics by seed, their estimates, and what its constraint did."""

from __future__ import annotations

import os
import platform
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from viatool.studies.metrics import values_of
from viatool.studies.statistics import estimate
from viatool.studies.tasks import Record, Task
from viatool.studies.training import EvaluateSeed, TrainVariant

_SAME_IN_ALL = ("method", "alpha", "map_sha256")
_LAST_PART = 0.25  # of the epochs, whose lambda and u tell where a training ended


def collect(tasks: Sequence[Task], records: Mapping[str, Record]) -> dict[str, Any]:
    """Sum up trainings and evaluations by variant.

    Returns
    -------
    dict
        ``about`` (how, when and on what), ``configuration`` (what all trainings share) and ``variants``: by
        name the ``values`` of each seed, the ``estimates``, the ``constraint`` and the ``seconds``.
    """
    trainings = [task for task in tasks if isinstance(task, TrainVariant)]
    variants: dict[str, Any] = {}
    for training in trainings:
        own = [
            records[task.name]
            for task in tasks
            if isinstance(task, EvaluateSeed) and task.training is training and task.name in records
        ]
        if own:
            variants[training.folder.rpartition("/")[2]] = _variant(records[training.name], own)
    return {
        "about": about(trainings, list(records.values())) | {"episodes": _episodes(tasks)},
        "configuration": _shared_configuration(trainings),
        "variants": variants,
    }


def about(trainings: Sequence[TrainVariant], records: Sequence[Record]) -> dict[str, Any]:
    """Return how, when and on what the records were made."""
    versions = [record.result["versions"] for record in records if "versions" in record.result]
    dates = sorted(record.finished for record in records)
    return {
        "seeds": max((training.configuration.seeds for training in trainings), default=0),
        "dates": [dates[0], dates[-1]] if dates else [],
        "machine": f"{os.cpu_count()}-core {platform.machine()}",
        "versions": versions[-1] if versions else {},
        "minutes": round(sum(record.seconds for record in records) / 60, 1),
    }


def _episodes(tasks: Sequence[Task]) -> dict[str, int]:
    """Return in how many fixed and held-out scenarios each policy drives."""
    for task in tasks:
        if isinstance(task, EvaluateSeed):
            return {"fixed": len(task.training.world_map.scenarios), "held_out": task.scenarios}
    return {}


def _shared_configuration(trainings: Sequence[TrainVariant]) -> dict[str, Any]:
    every = [training.configuration.model_dump(mode="json") for training in trainings]
    first = every[0] if every else {}
    return {
        name: value
        for name, value in first.items()
        if name not in _SAME_IN_ALL and all(one[name] == value for one in every)
    }


def _variant(training: Record, evaluations: Sequence[Record]) -> dict[str, Any]:
    values = values_of([record.result for record in evaluations])
    known = {name: [one for one in found if one is not None] for name, found in values.items()}
    return {
        "seeds": [record.result["seed"] for record in evaluations],
        "epochs": [record.result["epoch"] for record in evaluations],
        "values": values,
        "estimates": {name: _finite(asdict(estimate(found))) for name, found in known.items() if found},
        "constraint": constraint_of(training.result["curves"]) | {"limit": training.parameters["cost_limit"]},
        "seconds": training.seconds,
    }


def _finite(estimated: dict[str, float]) -> dict[str, float | None]:
    return {name: value if np.isfinite(value) else None for name, value in estimated.items()}


def constraint_of(curves: Mapping[str, Sequence[Sequence[float | None]]]) -> dict[str, float]:
    """Return what lambda and u did in a training, over all its seeds.

    Returns
    -------
    dict
        ``zero``: share of all (epoch, seed) in which lambda was 0; ``zero_late``: the same in the last quarter
        of the epochs; ``multiplier``, ``var``: means of lambda and u in that quarter; ``multiplier_highest``.
    """
    multiplier, var = (np.array(curves[name], dtype=np.float64) for name in ("multiplier", "var"))
    late = slice(-max(1, round(len(multiplier) * _LAST_PART)), None)
    return {
        "zero": float((multiplier == 0.0).mean()),
        "zero_late": float((multiplier[late] == 0.0).mean()),
        "multiplier": float(multiplier[late].mean()),
        "multiplier_highest": float(multiplier.max()),
        "var": float(var[late].mean()),
    }
