"""Results of any size, made of copies of a small one."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from viatool.safety import Witnesses
from viatool.verification.result import Result

Arrays = TypeVar("Arrays")


def enlarged(result: Result, states: int, entries: int | None = None) -> Result:
    """Repeat the episodes of a result until there are so many states, with longer observations if asked."""
    trajectory = result.trajectory
    copies = -(-states // len(trajectory))
    rows = np.arange(copies * len(trajectory))[:states] % len(trajectory)
    copy = np.arange(copies * len(trajectory))[:states] // len(trajectory)
    observations = trajectory.observations[rows]
    if entries is not None:
        observations = np.resize(observations, (states, entries))
    found = np.flatnonzero(np.isin(rows, result.witnesses.state))
    which = np.searchsorted(result.witnesses.state, rows[found])
    return replace(
        result,
        trajectory=replace(
            trajectory,
            poses=trajectory.poses[rows],
            observations=observations,
            actions=trajectory.actions[rows],
            time=trajectory.time[rows],
            episode=trajectory.episode[rows] + copy * trajectory.episodes,
            outcomes=np.tile(trajectory.outcomes, copies),
            costs=np.tile(trajectory.costs, copies),
            scenarios=trajectory.scenarios * copies,
            steps=None,
        ),
        reachable=_picked(result.reachable, rows),
        contested=_picked(result.contested, rows),
        judgement=_picked(result.judgement, rows),
        witnesses=Witnesses(found, *(a[which] for a in _arrays(result.witnesses)[1:])),
    )


def _arrays(record: Any) -> list[NDArray[Any]]:
    return [getattr(record, field.name) for field in fields(record)]


def _picked(record: Arrays, rows: NDArray[np.int64]) -> Arrays:
    return type(record)(*(None if array is None else array[rows] for array in _arrays(record)))
