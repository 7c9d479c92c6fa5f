"""Missions as compact arrays for the page: parts of tubes by interval, driven runs, and what distance both keep."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from viatool.arrays import Floats, Indices
from viatool.report.foreign import one_line
from viatool.report.html.states import pack
from viatool.report.missions.ends import goal_outlines, start_box

if TYPE_CHECKING:
    from viatool.missions import Mission, Missions
    from viatool.world import Scenes

MOST_PARTS = 120_000  # of all tubes together; the page stays below 10 MB with the plotting library
_FEWEST = 8
"""Parts of an interval that are drawn in any case."""


def page_data(missions: Missions) -> dict[str, Any]:
    """Return all that the page's script needs to draw any interval of any mission."""
    from viatool.world import Scenes

    scenarios = [mission.scenario for mission in missions]
    scenes = Scenes.of(missions.world_map, scenarios) if scenarios else None
    room = MOST_PARTS // max(len(missions), 1)
    return {
        "missions": [
            _mission(mission, missions, scenes, number, room) for number, mission in enumerate(missions)
        ],
        "limit": missions.rules.clearance.collision,
    }


def _mission(
    mission: Mission, missions: Missions, scenes: Scenes | None, number: int, room: int
) -> dict[str, Any]:
    assert scenes is not None
    tube, scenario = mission.proof.tube, mission.scenario
    steps, lower, upper = drawn_parts(tube.step, tube.lower, tube.upper, room)
    reach = missions.rules.footprint.reach
    found = mission.crashes if len(mission.crashes) else mission.late
    return {
        "name": one_line(scenario.name),
        "verdict": mission.verdict,
        "reason": one_line(mission.reason),
        "task": one_line(mission.task),
        "interval": mission.interval,
        "arrival": list(mission.arrival) if mission.verdict == "proved" else None,
        "clearance": None if np.isinf(mission.clearance) else mission.clearance,
        "goal": goal_outlines(mission, missions),
        "start": start_box(mission, missions),
        "circles": np.asarray(scenario.obstacles.circles).tolist(),
        "polygons": [polygon.tolist() for polygon in scenario.obstacles.polygons],
        "end": found.place[0, :2].tolist() if len(found) else None,
        "tube": {
            "step": pack(steps, "uint32"),
            "lower": pack(lower, "float32"),
            "upper": pack(upper, "float32"),
        },
        "runs": {"count": len(mission.paths), "paths": pack(mission.paths, "float32")},
        "parts": np.bincount(tube.step, minlength=1).tolist(),
        "kept": _listed(kept_by_tube(tube.step, tube.lower, tube.upper, scenes, number) - reach),
        "driven": _listed(kept_by_runs(mission.paths, scenes, number) - reach),
    }


def _listed(values: Floats) -> list[float | None]:
    """Return numbers as JSON has them: None where there is none."""
    return [float(value) if np.isfinite(value) else None for value in values]


def drawn_parts(steps: Indices, lower: Floats, upper: Floats, room: int) -> tuple[Indices, Floats, Floats]:
    """Return boxes of x, y and heading around the parts (P, 3 + K) of each interval, about `room` of them in all.

    Where there are more parts, those of a square of the map become one box, of squares as small as may be: the boxes
    still hold every run.
    """
    found: list[tuple[Indices, Floats, Floats]] = []
    every = np.unique(steps)
    most = max(_FEWEST, room // max(len(every), 1))
    for step in every.tolist():
        rows = steps == step
        low, high = _joined(lower[rows, :3], upper[rows, :3], most)
        found.append((np.full(len(low), step), low, high))
    if not found:
        return np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 3))
    number, low, high = (np.concatenate(part) for part in zip(*found, strict=True))
    return number, low, high


def _joined(lower: Floats, upper: Floats, most: int) -> tuple[Floats, Floats]:
    """Return at most so many boxes around boxes."""
    if len(lower) <= most:
        return lower, upper
    middle = 0.5 * (lower + upper)[:, :2]
    extent = float(np.ptp(middle, axis=0).max())
    for pieces in (2**power for power in range(10, -1, -1)):
        square = np.floor((middle - middle.min(axis=0)) / (extent / pieces + 1e-12)).astype(np.int64)
        _, group = np.unique(square, axis=0, return_inverse=True)
        group = group.reshape(-1)
        if group.max() < most:
            break
    low, high = np.full((group.max() + 1, 3), np.inf), np.full((group.max() + 1, 3), -np.inf)
    np.minimum.at(low, group, lower)
    np.maximum.at(high, group, upper)
    return low, high


def kept_by_tube(steps: Indices, lower: Floats, upper: Floats, scenes: Scenes, number: int) -> Floats:
    """Return what the robot's origin keeps from obstacles at the end of each interval, (K + 1,) metres; NaN if none."""
    kept = np.full(int(steps.max(initial=0)) + 1, np.inf)
    if len(steps):
        middle, half = 0.5 * (lower + upper)[:, :2], 0.5 * (upper - lower)[:, :2]
        away = scenes.clearance(middle, np.full(len(middle), number)) - np.hypot(*half.T)
        np.minimum.at(kept, steps, away)
    return np.where(np.isinf(kept), np.nan, kept)


def kept_by_runs(paths: Floats, scenes: Scenes, number: int) -> Floats:
    """Return what driven runs (R, K + 1, 2) keep at the end of each interval at least, (K + 1,) metres."""
    driving = np.isfinite(paths).all(axis=2)
    away = np.full(driving.shape, np.inf)
    places = paths[driving]
    away[driving] = scenes.clearance(places, np.full(len(places), number))
    kept = away.min(axis=0, initial=np.inf)
    return np.where(np.isinf(kept), np.nan, kept)
