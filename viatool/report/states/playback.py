"""States as they were driven, played over time: swept areas by verdict, tubes, and what LiDARs read."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from viatool.arrays import Floats, Indices
from viatool.report.drawing import swept_regions
from viatool.report.palette import COLOUR
from viatool.report.playback.markers import ARROW, Marker, circle, filled, marker, markers, words
from viatool.report.playback.messages import BESIDE, ROBOT, SECOND, RosMessage, nanoseconds, path, standing
from viatool.report.playback.scans import scan_views
from viatool.report.playback.surroundings import MapMessages
from viatool.report.states.tubes import tube_regions

if TYPE_CHECKING:
    from viatool.verification.result import Result

_GOAL = 0.1  # metres, of the circle around a goal
_SHOWN = 1000  # swept areas of a verdict that are shown at the same time; older ones give way
_QUARTER = 4  # corners of the outline of a widened area in a quarter turn
_SWEPT, _TUBE = 0.35, 0.2  # opacity


def timeline(result: Result) -> Iterator[tuple[int, Indices, Indices]]:
    """Yield the episodes that have states, in their order: number, states (K,) and their stamps (K,) in nanoseconds.

    Stamps are those of a recording that has some. Else episodes follow one another, a second apart, from 0 s on; states
    that do not follow one another are a control interval apart.
    """
    trajectory, begin = result.trajectory, 0
    order = np.argsort(trajectory.episode, kind="stable")
    ends = np.searchsorted(trajectory.episode[order], np.arange(trajectory.episodes + 1))
    for episode in range(trajectory.episodes):
        rows = order[ends[episode] : ends[episode + 1]]
        if not len(rows):
            continue
        times = (
            trajectory.time[rows] if trajectory.connected else np.arange(len(rows)) * result.rules.interval
        )
        if trajectory.began is not None and trajectory.connected:
            yield episode, rows, trajectory.began + np.rint(times * SECOND).astype(np.int64)
            continue
        stamps = begin + np.rint((times - times[0]) * SECOND).astype(np.int64)
        begin = int(stamps[-1]) + SECOND
        yield episode, rows, stamps


class StatesPlayback:
    """The states of a result as messages."""

    def __init__(self, result: Result) -> None:
        self.result = result
        self.robot = ROBOT if result.trajectory.began is None else BESIDE
        self.surroundings = MapMessages(result.world_map)
        self.scans = scan_views(result.setting.quantities)
        self._moving = result.moving
        self._witness_of = {state: number for number, state in enumerate(result.witnesses.state.tolist())}

    def messages(self) -> Iterator[RosMessage]:
        """Yield all messages in the order of their stamps."""
        before = None
        for episode, rows, stamps in timeline(self.result):
            yield from self._opening(episode, rows, stamps)
            for row, stamp in zip(rows.tolist(), stamps.tolist(), strict=True):
                yield from self._state(row, stamp)
                yield from self._counterexample(row, stamp, before)
                before = row

    def _opening(self, episode: int, rows: Indices, stamps: Indices) -> Iterator[RosMessage]:
        """Yield what an episode begins with: its surroundings and its path, and nothing of the one before."""
        scenario, first = self.result.trajectory.scenarios[episode], int(stamps[0])
        goal = [] if scenario is None else [circle(scenario.goal, _GOAL)]
        yield from self.surroundings.messages(first, scenario, goal)
        yield path(first, stamps, self.result.poses[rows])
        for topic in ("/swept", "/witness", *(["/tube"] if self.result.horizon else [])):
            yield markers(first, topic, [], afresh=True)
        if self.result.close is not None:
            yield markers(first, "/close", self._beside(episode, first), afresh=True, lasting=True)

    def _state(self, row: int, stamp: int) -> Iterator[RosMessage]:
        """Yield what is known of one state."""
        result = self.result
        yield from standing(stamp, result.poses[row], self.robot)
        swept = self._swept(row, stamp)
        if swept is not None:
            yield markers(stamp, "/swept", [swept])
        for scan in self.scans:
            yield scan.message(stamp, "/nominal", result.observations[row], self.robot)
        if result.horizon is not None:
            yield markers(stamp, "/tube", self._tube(row, stamp), afresh=True)

    def _swept(self, row: int, stamp: int) -> Marker | None:
        """Return the swept area of a state; older ones of its verdict give way."""
        return swept_marker(self.result, self._moving, row, stamp, row % _SHOWN)

    def _beside(self, episode: int, stamp: int) -> list[Marker]:
        """Return the swept areas of the close places beside an episode."""
        close = self.result.close
        assert close is not None
        moving, rows = close.moving, np.flatnonzero(close.episode == episode).tolist()
        found = (swept_marker(close, moving, row, stamp, row, name="close, ") for row in rows)
        return [area for area in found if area is not None]

    def _tube(self, row: int, stamp: int) -> list[Marker]:
        """Return where runs from a state may be, one marker for each interval with the stamp of its end."""
        assert self.result.horizon is not None
        tubes, verdict = self.result.horizon.tubes, str(self.result.horizon.verdict[row])
        regions = tube_regions(self.result.poses[row, None], tubes.lower[row, None], tubes.upper[row, None])
        intervals = np.flatnonzero(np.isfinite(tubes.lower[row]).all(axis=1))  # (P,), as there are regions
        return [
            filled(
                [region],
                stamp + nanoseconds((number + 1) * self.result.rules.interval),
                f"tube, {verdict}",
                number,
                COLOUR[verdict],
                alpha=_TUBE,
            )
            for number, region in zip(intervals.tolist(), regions, strict=True)
        ]

    def _counterexample(self, row: int, stamp: int, before: int | None) -> Iterator[RosMessage]:
        """Yield what is read and where that leads; of a safe state, that there is no more of the one before."""
        number, found = self._witness_of.get(row), self.result.witnesses
        if number is None:
            if before in self._witness_of:
                yield markers(stamp, "/witness", [], afresh=True)
                for scan in self.scans:
                    yield scan.message(stamp, "/witness", None, self.robot)
            return
        for scan in self.scans:
            yield scan.message(stamp, "/witness", found.observation[number], self.robot)
        yield markers(stamp, "/witness", self._closest(number, row, stamp), afresh=True)

    def _closest(self, number: int, row: int, stamp: int) -> list[Marker]:
        """Return the closest pose of a counterexample, and in words which command leads there."""
        result, colour = self.result, COLOUR["unsafe"]
        scenario = result.trajectory.scenarios[result.episode[row]]
        told = result.witnesses.violation(number, result.world_map, scenario, result.rules.footprint)
        command = ", ".join(
            f"{axis.name} {value:.3g} {axis.unit}"
            for axis, value in zip(result.actions, told["action"], strict=True)
        )
        closest = told["closest"]
        text = f"{command}: after {closest['seconds']:.3g} s {closest['clearance']:.3f} m from {closest['obstacle']}"
        pose = result.witnesses.pose[number]
        return [
            marker(ARROW, stamp, "closest pose", 0, colour, pose=pose, size=(0.25, 0.05, 0.05)),
            words(text, stamp, "in words", 0, colour, pose[:2]),
        ]


def swept_marker(
    result: Result, moving: tuple[Floats, Floats], row: int, stamp: int, number: int, *, name: str = ""
) -> Marker | None:
    """Return the area that has to stay free in a state, as the figure shows it, by verdict; None without bounds.

    `moving` is that of the result, which is made for all states at once.
    """
    if not np.isfinite(result.commands[0][row]).all():
        return None
    rules, verdict = result.rules, str(result.verdict[row])
    lower, upper = (end[row, None] for end in moving)
    (reached,) = swept_regions(result.poses[row, None], lower, upper, rules.interval, rules.kinematics)
    distance = rules.clearance.collision
    region = reached.buffer(distance, quad_segs=_QUARTER) if distance > 0.0 else reached
    return filled([region], stamp, f"{name}{verdict}", number, COLOUR[verdict], alpha=_SWEPT)
