"""Runs as entries of a witness file: the intervals before the last one, and where a run that is late was to arrive.

A run that is still on its way at its time limit comes near to nothing. It is driven again interval by interval: as long
as the program gives the commands that were recorded, each interval ends where the next one begins, and no end is where
runs arrive, it is late again.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from viatool.arrays import Floats
from viatool.loop.destination import Destination, NearPlace, StatesInPolygon, StatesReached
from viatool.loop.horizon import Crashes
from viatool.setting.driven import DrivenPolicy
from viatool.setting.rules import Rules

_ELSEWHERE = 1e-5
"""Metres and radians by which an interval may end elsewhere: commands differ in their last places between runtimes."""


def run_before(crashes: Crashes, row: int) -> list[dict[str, Any]]:
    """Return the intervals of a run before the one that fails: poses, observations and commands, and any motion."""
    names = ("pose", "observation", "action", *(("motion",) if crashes.motions.shape[2] else ()))
    return [
        {name: getattr(crashes, f"{name}s")[row, k].tolist() for name in names}
        for k in range(int(crashes.step[row]))
    ]


def motion_begun(crashes: Crashes, row: int) -> dict[str, Any]:
    """Return the ends of the state of the motion in which the interval that fails begins; nothing without one."""
    motion = crashes.motions[row, crashes.step[row]].tolist()
    return {"motion": [motion, motion]} if motion else {}


def arrival_document(destination: Destination) -> dict[str, Any]:
    """Return where and when a run was to arrive, as an entry has it; null where nothing is asked."""
    when = {"arrive": "at" if destination.deadline_only else "within"}
    if isinstance(destination, NearPlace):
        return {**when, "place": destination.place.tolist(), "radius": destination.radius}
    assert isinstance(destination, StatesReached)
    ends = {"lower": _limits(destination.lower), "upper": _limits(destination.upper)}
    if isinstance(destination, StatesInPolygon):
        return {**when, **ends, "outline": destination.outline.tolist()}
    return {**when, **ends}


def read_arrival(document: Mapping[str, Any]) -> Destination:
    """Return what `arrival_document` was called on; ValueError, KeyError or TypeError if it is something else."""
    waits = {"at": True, "within": False}[document["arrive"]]
    if "place" in document:
        return NearPlace(waits, np.array(document["place"], dtype=np.float64), float(document["radius"]))
    lower, upper = (
        np.array([free if end is None else float(end) for end in document[name]])
        for name, free in (("lower", -np.inf), ("upper", np.inf))
    )
    if "outline" in document:
        return StatesInPolygon(waits, lower, upper, np.array(document["outline"], dtype=np.float64))
    return StatesReached(waits, lower, upper)


def _limits(ends: Floats) -> list[float | None]:
    return [float(end) if np.isfinite(end) else None for end in ends]


def is_late_again(entry: Mapping[str, Any], driven: DrivenPolicy, rules: Rules) -> bool:
    """Drive a recorded run again, and tell whether it still has not arrived by its time limit.

    Parameters
    ----------
    entry : mapping
        Of a witness file, with `late`.
    driven : DrivenPolicy
        The program.
    rules : Rules
        Interval, kinematics and limits.
    """
    before = entry["before"]
    poses = np.array([*(step["pose"] for step in before), entry["pose"]], dtype=np.float64)
    observations = [*(step["observation"] for step in before), entry["observation"]]
    motions = _motions(entry, before, rules)
    commands = np.array([driven.run(np.array(row, dtype=np.float64)[None])[0] for row in observations])
    held = np.concatenate([rules.clip(commands.astype(np.float64)), motions], axis=1)
    ends = replace(rules.manoeuvre, deceleration=None).path(poses, held, np.ones(len(poses)))
    move = rules.kinematics
    behind = move.after(held, rules.interval) if move.state else held
    destination = read_arrival(entry["late"])
    there = destination.holds(np.concatenate([ends, behind], axis=1))
    arrives = there[-1] if destination.deadline_only else there.any()
    follows = (np.abs(ends[:-1] - poses[1:]) <= _ELSEWHERE).all()
    if move.state:
        follows &= (np.abs(behind[:-1] - motions[1:]) <= _ELSEWHERE).all()
    return bool(follows and not arrives)


def _motions(entry: Mapping[str, Any], before: Sequence[Mapping[str, Any]], rules: Rules) -> Floats:
    """Return the state of the motion at the beginning of each interval, (K, S)."""
    size, count = len(rules.kinematics.state), len(before) + 1
    rows = [*(step["motion"] for step in before), entry["motion"][0]] if size else []
    return np.array(rows, dtype=np.float64).reshape(count, size)
