"""Missions as a ROS recording: the tube interval by interval, and the run that refutes one."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.hall import MAP, write_policy
from tests.missions.dodging import write_dodging_policy
from tests.played import DELETE_ALL, Played, cell, drawn, has_colour, holds, lines, play, pose, stamp
from viatool.missions import Missions, mission
from viatool.report.missions.playback import hulls
from viatool.report.missions.run import MissionsRun
from viatool.report.palette import COLOUR
from viatool.report.playback.markers import filled

SECOND = 10**9
STEP = SECOND // 10


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("missions")
    (folder / "hall.yaml").write_text(MAP, encoding="utf-8")
    write_dodging_policy(folder / "dodging.onnx")
    write_policy(folder / "straight.onnx")
    return folder


@pytest.fixture(scope="module")
def proved(folder: Path) -> Missions:
    return mission(
        folder / "dodging.onnx", folder / "hall.yaml", eps=0.01, start_error=(0.02, 0.02), time_limit=9.0
    )


@pytest.fixture(scope="module")
def played(proved: Missions, folder: Path) -> dict[str, list[Played]]:
    return play(MissionsRun(proved), folder / "proved.mcap")


@pytest.fixture(scope="module")
def refuted(folder: Path) -> Missions:
    found = mission(folder / "straight.onnx", folder / "hall.yaml", eps=0.01, time_limit=9.0)
    assert found.missions[0].verdict == "refuted"
    return found


@pytest.fixture(scope="module")
def crash(refuted: Missions, folder: Path) -> dict[str, list[Played]]:
    return play(MissionsRun(refuted), folder / "refuted.mcap")


def begins(played: dict[str, list[Played]]) -> list[int]:
    return [one.at for one in played["/map"]]


def test_missions_follow_one_another(proved: Missions, played: dict[str, list[Played]]) -> None:
    assert [one.verdict for one in proved] == ["proved", "proved"]
    first, second = begins(played)
    last = int(proved.missions[0].proof.tube.step.max()) * STEP
    assert (first, second) == (0, last + SECOND)
    kinds = {topic: played[topic][0].type.rpartition("/")[2] for topic in played if topic}
    assert kinds == {
        "/map": "OccupancyGrid",
        "/obstacles": "MarkerArray",
        "/goal": "Marker",
        "/start": "Marker",
        "/tube": "MarkerArray",
        "/verdict": "MarkerArray",
        "/witness": "MarkerArray",
        "/path": "Path",
    }
    at = [one.at for one in played[""]]
    assert at == sorted(at)


def test_every_interval_has_a_tube_that_holds_the_driven_runs(
    proved: Missions, played: dict[str, list[Played]]
) -> None:
    removals = [one.at for one in played["/tube"] if one.message.markers[0].action == DELETE_ALL]
    assert removals == begins(played)
    found = drawn(played["/tube"])
    for one, begin in zip(proved, begins(played), strict=True):
        steps = np.unique(one.proof.tube.step).tolist()
        own = {marker.id: (at, marker) for at, marker in found if begin < at <= begin + steps[-1] * STEP}
        assert sorted(own) == steps == list(range(1, steps[-1] + 1))
        held = 0
        for number, (at, marker) in own.items():
            assert at == stamp(marker.header) == begin + number * STEP
            assert has_colour(marker, COLOUR["safe"])
            driving = one.arrived > number
            for place in one.paths[driving, number]:
                assert holds(marker, place)
                held += 1
        assert held > 100


def test_runs_begin_in_the_box_and_arrive_in_the_ring(
    proved: Missions, played: dict[str, list[Played]]
) -> None:
    for one, start, goal in zip(proved, played["/start"], played["/goal"], strict=True):
        box, ring = lines(start.message)[:, 0], lines(goal.message)[:, 0]
        middle = np.array(one.scenario.start[:2])
        np.testing.assert_allclose(np.abs(box - middle), 0.02)
        away = np.hypot(*(ring - one.scenario.goal).T)
        np.testing.assert_allclose(away, proved.goal_radius)
    grid = played["/map"][0].message
    assert (cell(grid, 0.0, 0.55), cell(grid, 0.0, 0.0)) == (100, 0)
    assert [marker.text for _, marker in drawn(played["/verdict"])] == ["past is proved", "clear is proved"]


def test_a_run_that_refutes_a_mission_is_driven(refuted: Missions, crash: dict[str, list[Played]]) -> None:
    one, begin = refuted.missions[0], begins(crash)[0]
    found = one.crashes
    count = int(found.step[0]) + 1
    end = begin + (count - 1) * STEP + round(float(found.seconds[0]) * SECOND)
    poses = np.concatenate([found.poses[0, :count], found.place])
    at = [begin + number * STEP for number in range(count)]
    assert [each.at for each in crash["/pose"]][: count + 1] == [*at, end]
    told = [pose(each.message.pose) for each in crash["/pose"]][: count + 1]
    np.testing.assert_allclose(told, poses, atol=1e-12)
    path = crash["/path"][0].message
    np.testing.assert_allclose([pose(each.pose) for each in path.poses], poses, atol=1e-12)
    assert [stamp(each.header) for each in path.poses] == [*at, end]
    scans = crash["/witness/scan"][:count]
    assert [each.at for each in scans] == at
    for each, observation in zip(scans, found.observations[0], strict=False):
        bins = observation[:20]
        expected = np.where(bins >= 7.0, np.inf, bins).astype(np.float32)
        np.testing.assert_array_equal(each.message.ranges, expected)
    assert np.isnan(crash["/witness/scan"][count].message.ranges).all()
    (when, text), *_ = drawn(crash["/witness"])
    assert when == end
    assert text.text == one.reason
    assert has_colour(text, COLOUR["unsafe"])
    assert drawn(crash["/verdict"])[0][1].text == f"past is refuted: {one.reason}"


def test_ways_apart_stay_apart() -> None:
    lower = np.array([[0.0, 0.0], [0.9, 0.5], [5.0, 5.0]])
    parts = sorted(hulls(lower, lower + 1.0), key=lambda part: -part.area)
    assert [part.bounds for part in parts] == [(0.0, 0.0, 1.9, 1.5), (5.0, 5.0, 6.0, 6.0)]
    assert hulls(np.zeros((0, 2)), np.zeros((0, 2))) == []


def test_a_place_without_an_area_is_drawn() -> None:
    line, dot = hulls(np.array([[0.0, 0.0], [3.0, 3.0]]), np.array([[1.0, 0.0], [3.0, 3.0]]))
    shown = filled([line, dot], 0, "tube", 0, COLOUR["safe"], alpha=1.0)
    points = [SimpleNamespace(**point) for point in shown["points"]]
    marker = SimpleNamespace(points=points)
    assert all(holds(marker, place) for place in ((0.0, 0.0), (0.5, 0.0), (1.0, 0.0), (3.0, 3.0)))
    assert not holds(marker, (2.0, 1.5))


def test_a_mission_that_was_not_begun_has_a_place_and_no_tube(folder: Path, tmp_path: Path) -> None:
    from viatool.schedule import Deadline

    late: Any = mission(folder / "dodging.onnx", folder / "hall.yaml", eps=0.01, until=Deadline.after(0.0))
    found = play(MissionsRun(late), tmp_path / "late.mcap")
    assert drawn(found["/tube"]) == []
    assert begins(found) == [0, SECOND]
