"""Missions played over time: the tube interval by interval, and a run that refutes the mission beside it."""

from __future__ import annotations

from collections.abc import Iterator
from heapq import merge
from typing import TYPE_CHECKING

import numpy as np

from viatool.arrays import Floats
from viatool.report.missions.document import TONES
from viatool.report.missions.ends import goal_outlines, start_box
from viatool.report.palette import COLOUR
from viatool.report.playback.markers import filled, markers, outlined, single, words
from viatool.report.playback.messages import SECOND, RosMessage, nanoseconds, path, standing
from viatool.report.playback.scans import scan_views
from viatool.report.playback.surroundings import MapMessages

if TYPE_CHECKING:
    from shapely.geometry.base import BaseGeometry

    from viatool.missions import Mission, Missions

_START = "#56B4E9"
_TUBE = 0.5  # opacity


def play_missions(missions: Missions) -> Iterator[RosMessage]:
    """Yield missions one after the other, a second apart, from 0 s on; all messages in the order of their stamps."""
    surroundings, begin = MapMessages(missions.world_map), 0
    for mission in missions:
        parts = (
            _opening(mission, missions, surroundings, begin),
            _tube(mission, begin),
            _run(mission, missions, begin),
        )
        last = begin
        for message in merge(*parts, key=lambda message: message.stamp):
            yield message
            last = message.stamp
        begin = last + SECOND


def _opening(
    mission: Mission, missions: Missions, surroundings: MapMessages, stamp: int
) -> Iterator[RosMessage]:
    """Yield what a mission begins with: surroundings, goal, starts and verdict, and no tube of the one before."""
    colour, scenario = COLOUR[TONES[mission.verdict]], mission.scenario
    yield from surroundings.messages(stamp, scenario, map(np.array, goal_outlines(mission, missions)))
    left, low, right, high = start_box(mission, missions)
    box = np.array([[left, low], [right, low], [right, high], [left, high]])
    yield single(stamp, "/start", outlined([box], stamp, "start", 0, _START))
    for topic in ("/tube", "/witness"):
        yield markers(stamp, topic, [], afresh=True)
    told = f"{scenario.name} is {mission.verdict}" + (f": {mission.reason}" if mission.reason else "")
    at = np.array(scenario.start[:2])
    verdict = words(told, stamp, "verdict", 0, colour, at)
    yield markers(stamp, "/verdict", [verdict], afresh=True, lasting=True)


def _tube(mission: Mission, begin: int) -> Iterator[RosMessage]:
    """Yield where runs that have not arrived may be at the end of each interval, one marker for each."""
    tube, colour = mission.proof.tube, COLOUR[TONES[mission.verdict]]
    for number in np.unique(tube.step).tolist():
        rows, stamp = tube.step == number, begin + nanoseconds(number * mission.interval)
        regions = hulls(tube.lower[rows, :2], tube.upper[rows, :2])
        found = filled(regions, stamp, f"tube, {mission.verdict}", number, colour, alpha=_TUBE)
        yield markers(stamp, "/tube", [found])


def hulls(lower: Floats, upper: Floats) -> list[BaseGeometry]:
    """Return the convex hulls of those boxes (P, 2) that touch one another, so that ways apart stay apart."""
    import shapely

    corners = [np.column_stack([x[:, 0], y[:, 1]]) for x in (lower, upper) for y in (lower, upper)]
    boxes = shapely.convex_hull(shapely.multipoints(np.stack(corners, axis=1)))  # lines and points too
    joined = shapely.union_all(boxes)
    return [part.convex_hull for part in shapely.get_parts(joined)]


def _run(mission: Mission, missions: Missions, begin: int) -> Iterator[RosMessage]:
    """Yield the run that refutes a mission: where it is, what it reads, and where it fails; none of another."""
    found = mission.crashes if len(mission.crashes) else mission.late
    if not len(found):
        yield path(begin, [], np.zeros((0, 3)))
        return
    count = int(found.step[0]) + 1
    stamps = [begin + nanoseconds(number * mission.interval) for number in range(count)]
    end = stamps[-1] + nanoseconds(float(found.seconds[0]))
    poses = np.concatenate([found.poses[0, :count], found.place])
    yield path(begin, [*stamps, end], poses)
    scans = scan_views(missions.setting.quantities)
    for number, stamp in enumerate(stamps):
        yield from standing(stamp, poses[number])
        for scan in scans:
            yield scan.message(stamp, "/witness", found.observations[0, number])
    yield from standing(end, poses[-1])
    for scan in scans:
        yield scan.message(end, "/witness", None)
    reason = words(mission.reason, end, "in words", 0, COLOUR["unsafe"], poses[-1, :2])
    yield markers(end, "/witness", [reason], afresh=True)
