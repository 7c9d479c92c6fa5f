"""States as a ROS recording: what viewers show is what was found, at the time at which it was driven."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import viatool
from tests.bags import START, drive_messages, write_bag
from tests.hall import MAP, write_policy
from tests.played import (
    DELETE_ALL,
    Played,
    cell,
    drawn,
    has_colour,
    heading,
    holds,
    lines,
    play,
    pose,
    stamp,
)
from viatool import load_map, load_policy
from viatool.errors import ConfigurationError
from viatool.report.formats import mcap
from viatool.report.outputs import Output, content_of, parse_output, write_outputs
from viatool.report.palette import COLOUR
from viatool.report.states.document import StatesDocument
from viatool.report.states.run import StatesRun
from viatool.trajectory import BagSettings
from viatool.verification.close import close_places
from viatool.world import Obstacles

SECOND = 10**9
OWN = """\
schema_version: 1
name: hall
arena: {shape: box, center: [0, 0], size: [6, 6]}
obstacles:
  - {shape: circle, center: [0.0, 0.55], radius: 0.3}
scenarios:
  - {name: past, start: [-1.5, 0, 0], goal: [1.5, 0]}
  - name: boxed
    start: [-1.5, -2, 0]
    goal: [1.5, -2]
    obstacles:
      - {shape: box, center: [2.0, 2.0], size: [0.4, 0.2], yaw: 0.0}
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("played")
    write_policy(folder / "straight.onnx")
    (folder / "hall.yaml").write_text(OWN, encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def result(folder: Path) -> viatool.Result:
    return viatool.verify(folder / "straight.onnx", folder / "hall.yaml", eps=0.05, horizon=3)


@pytest.fixture(scope="module")
def played(result: viatool.Result, folder: Path) -> dict[str, list[Played]]:
    return play(StatesRun(result), folder / "states.mcap")


@pytest.fixture(scope="module")
def stamps(result: viatool.Result) -> np.ndarray:
    """When states are driven: the second episode begins a second after the last state of the first."""
    trajectory, begins = result.trajectory, [0.0]
    begins.append(trajectory.time[trajectory.episode == 0].max() + 1.0)
    return np.rint((np.array(begins)[trajectory.episode] + trajectory.time) * SECOND).astype(np.int64)


def test_topics_have_the_types_that_viewers_know(result: viatool.Result, played: dict[str, Any]) -> None:
    states, unsafe = len(result.verdict), len(result.witnesses)
    assert {"safe", "unsafe"} <= set(result.verdict)
    expected = {
        "/map": ("nav_msgs/msg/OccupancyGrid", 2),
        "/obstacles": ("visualization_msgs/msg/MarkerArray", 2),
        "/goal": ("visualization_msgs/msg/Marker", 2),
        "/path": ("nav_msgs/msg/Path", 2),
        "/tf": ("tf2_msgs/msg/TFMessage", states),
        "/pose": ("geometry_msgs/msg/PoseStamped", states),
        "/swept": ("visualization_msgs/msg/MarkerArray", None),
        "/nominal/scan": ("sensor_msgs/msg/LaserScan", states),
        "/witness/scan": ("sensor_msgs/msg/LaserScan", None),
        "/witness": ("visualization_msgs/msg/MarkerArray", None),
        "/tube": ("visualization_msgs/msg/MarkerArray", 2 + states),
        "/close": ("visualization_msgs/msg/MarkerArray", 2),
    }
    assert set(played) - {""} == set(expected)
    for topic, (kind, count) in expected.items():
        assert {one.type for one in played[topic]} == {kind}
        assert count is None or len(played[topic]) == count
    shown = [one for one in played["/witness/scan"] if not np.isnan(one.message.ranges).all()]
    assert len(shown) == unsafe > 0
    at = [one.at for one in played[""]]
    assert at == sorted(at)


def test_the_robot_is_where_it_was_driven(
    result: viatool.Result, played: dict[str, Any], stamps: np.ndarray
) -> None:
    for topic in ("/pose", "/tf", "/nominal/scan"):
        assert [one.at for one in played[topic]] == stamps.tolist()
    poses = [pose(one.message.pose) for one in played["/pose"]]
    np.testing.assert_allclose(poses, result.poses, atol=1e-12)
    for row, one in enumerate(played["/tf"]):
        (part,) = one.message.transforms
        assert (part.header.frame_id, part.child_frame_id) == ("map", "base_link")
        assert stamp(part.header) == stamps[row]
        moved = part.transform.translation
        told = [moved.x, moved.y, heading(part.transform.rotation)]
        np.testing.assert_allclose(told, result.poses[row], atol=1e-12)
    paths = [one.message for one in played["/path"]]
    assert [one.at for one in played["/path"]] == [0, stamps[result.episode == 1][0]]
    for episode, path in enumerate(paths):
        rows = result.episode == episode
        assert [stamp(one.header) for one in path.poses] == stamps[rows].tolist()
        np.testing.assert_allclose([pose(one.pose) for one in path.poses], result.poses[rows], atol=1e-12)


def test_swept_areas_have_the_colour_of_the_verdict_and_hold_the_path(
    result: viatool.Result, played: dict[str, Any], stamps: np.ndarray
) -> None:
    found, distance = drawn(played["/swept"]), result.rules.clearance.collision
    assert [at for at, _ in found] == stamps.tolist()
    for row, (_, marker) in enumerate(found):
        verdict = str(result.verdict[row])
        assert has_colour(marker, COLOUR[verdict])
        assert marker.ns == verdict
        place, theta = result.poses[row, :2], result.poses[row, 2]
        aside = 0.95 * distance * np.array([-np.sin(theta), np.cos(theta)])
        assert holds(marker, place)
        assert holds(marker, place + aside)
        assert not holds(marker, place + 1.6 * aside)
        follows = row + 1 < len(found) and result.episode[row + 1] == result.episode[row]
        assert not follows or holds(marker, result.poses[row + 1, :2])
    numbers = [(marker.ns, marker.id) for _, marker in found]
    assert len(set(numbers)) == len(numbers)


def test_close_places_are_shown_with_their_episode(result: viatool.Result, played: dict[str, Any]) -> None:
    close = result.close
    assert close is not None
    for episode, one in enumerate(played["/close"]):
        assert one.at == played["/map"][episode].at
        rows = np.flatnonzero((close.episode == episode) & np.isfinite(close.lower).all(axis=1))
        areas = [marker for _, marker in drawn([one])]
        assert [marker.id for marker in areas] == rows.tolist()
        for marker, row in zip(areas, rows, strict=True):
            assert marker.ns == f"close, {close.verdict[row]}"
            assert has_colour(marker, COLOUR[str(close.verdict[row])])
            assert holds(marker, close.poses[row, :2])


def test_an_episode_removes_what_was_shown_of_the_one_before(played: dict[str, Any]) -> None:
    begins = [one.at for one in played["/map"]]
    for topic in ("/swept", "/tube", "/witness"):
        for begin in begins:
            first = next(one for one in played[topic] if one.at == begin)
            assert first.message.markers[0].action == DELETE_ALL


def test_the_counterexamples_of_the_hall_are_read_by_hand(
    result: viatool.Result, played: dict[str, Any]
) -> None:
    shown = [one for one in played["/witness/scan"] if not np.isnan(one.message.ranges).all()]
    witness = result.witness[result.verdict == "unsafe"]
    for one, observation in zip(shown, witness, strict=True):
        is_scan_of(one.message, observation[:20])
    for one, observation in zip(played["/nominal/scan"], result.observations, strict=True):
        is_scan_of(one.message, observation[:20])
    unsafe = result.verdict == "unsafe"
    ends = int((~unsafe[1:] & unsafe[:-1]).sum())
    assert len(played["/witness/scan"]) == int(unsafe.sum()) + ends  # a scan that holds nothing takes it away


def is_scan_of(scan: Any, bins: np.ndarray) -> None:
    """Check twenty bins over a half turn of 180 rays, the first to the right: the middle of nine rays, in metres."""
    assert scan.header.frame_id == "base_link"
    step = np.pi / 179
    first = -0.5 * np.pi + 4 * step
    told = [scan.angle_min, scan.angle_increment, scan.angle_max]
    np.testing.assert_allclose(told, [first, 9 * step, first + 19 * 9 * step], atol=1e-6)
    np.testing.assert_array_equal(scan.ranges, np.where(bins >= 7.0, np.inf, bins).astype(np.float32))


def test_the_counterexamples_of_via_are_read_by_hand(tmp_path: Path) -> None:
    scenarios = load_map("lab").scenarios[:1]
    driven = viatool.verify("via", "lab", eps=0.01, scenarios=scenarios, only_contested=True)
    places = close_places(driven.setting, driven.trajectory, 60, seed=4)
    result = viatool.verify("via", "lab", eps=0.1, trajectory=places)
    played = play(StatesRun(result), tmp_path / "via.mcap")
    shown = [one for one in played["/witness/scan"] if not np.isnan(one.message.ranges).all()]
    assert len(shown) == len(result.witnesses) > 0
    for one, observation in zip(shown, result.witnesses.observation, strict=True):
        is_scan_of(one.message, observation[:20])
    at = [one.at for one in played["/pose"]]
    assert np.unique(np.diff(at)).tolist() == [
        SECOND // 10
    ]  # they do not follow one another: one after the other


def test_a_counterexample_says_where_it_leads(result: viatool.Result, played: dict[str, Any]) -> None:
    found = drawn(played["/witness"])
    arrows, texts = found[::2], found[1::2]
    assert len(arrows) == len(texts) == len(result.witnesses)
    np.testing.assert_allclose([pose(marker.pose) for _, marker in arrows], result.witnesses.pose, atol=1e-12)
    for (_, text), action, away in zip(
        texts, result.witnesses.action, result.witnesses.clearance, strict=True
    ):
        assert text.text.startswith(f"linear {action[0]:.3g} m/s, angular {action[1]:.3g} rad/s: after ")
        assert f" {away:.3f} m from circle of radius 0.3 m at (0.00, 0.55)" in text.text


def test_tubes_hold_the_ends_of_their_intervals(
    result: viatool.Result, played: dict[str, Any], stamps: np.ndarray
) -> None:
    assert result.horizon is not None
    tubes, each = result.horizon.tubes, [one for one in played["/tube"] if len(one.message.markers) > 1]
    there = np.isfinite(tubes.lower).all(axis=2)
    assert len(each) == int(there.any(axis=1).sum()) > 0
    for one, row in zip(each, np.flatnonzero(there.any(axis=1)), strict=True):
        removal, *markers = one.message.markers
        assert removal.action == DELETE_ALL
        assert len(markers) == int(there[row].sum())
        assert one.at == stamps[row]
        for number, marker in enumerate(markers):
            assert stamp(marker.header) == stamps[row] + (number + 1) * SECOND // 10
            assert has_colour(marker, COLOUR[str(result.horizon.verdict[row])])
            for x in (tubes.lower, tubes.upper):
                assert holds(marker, x[row, number, :2])


def test_the_map_shows_what_blocks_in_its_episode(played: dict[str, Any]) -> None:
    first, second = (one.message for one in played["/map"])
    assert (first.header.frame_id, first.info.resolution) == ("map", pytest.approx(0.05))
    for grid in (first, second):
        assert cell(grid, 0.0, 0.55) == cell(grid, 0.28, 0.55) == cell(grid, 3.1, 0.0) == 100
        assert cell(grid, 0.0, 0.0) == cell(grid, 0.35, 0.55) == cell(grid, 2.9, 0.0) == 0
    assert (cell(first, 2.0, 2.0), cell(second, 2.0, 2.0)) == (0, 100)
    assert int(((np.asarray(second.data) == 100) & (np.asarray(first.data) == 0)).sum()) == pytest.approx(
        32, abs=12
    )
    outlines = [drawn([one])[0][1] for one in played["/obstacles"]]
    assert [len(lines(outline)) for outline in outlines] == [4 + 48, 4 + 48 + 4]
    round_ = lines(outlines[0])[4:, 0] - (0.0, 0.55)
    np.testing.assert_allclose(np.hypot(*round_.T), 0.3)
    for one, goal in zip(played["/goal"], [(1.5, 0.0), (1.5, -2.0)], strict=True):
        np.testing.assert_allclose(lines(one.message)[:, 0].mean(axis=0), goal, atol=1e-9)


def test_cells_of_a_grid_stay_as_they_are(folder: Path, tmp_path: Path) -> None:
    world_map = load_map("maps/lab-grid.yaml")
    grid = world_map.obstacles.grid
    assert grid is not None
    bare = replace(world_map.scenarios[0], obstacles=Obstacles())
    result = viatool.verify(folder / "straight.onnx", world_map, eps=0.0, scenarios=[bare])
    told = play(StatesRun(result), tmp_path / "grid.mcap")["/map"][0].message
    assert told.info.resolution == pytest.approx(grid.resolution)
    place = told.info.origin.position
    assert [place.x, place.y] == pytest.approx(grid.origin[:2])
    cells = np.asarray(told.data).reshape(grid.cells.shape)
    np.testing.assert_array_equal(cells, np.array([0, 100, -1])[grid.cells])


def test_states_that_were_settled_without_bounds_have_no_area(folder: Path, tmp_path: Path) -> None:
    result = viatool.verify(folder / "straight.onnx", folder / "hall.yaml", eps=0.05, only_contested=True)
    bounded = np.isfinite(result.lower).all(axis=1)
    assert 0 < bounded.sum() < len(bounded)
    played = play(StatesRun(result), tmp_path / "contested.mcap")
    at = [one.at for one in played["/pose"]]
    assert [at for at, _ in drawn(played["/swept"])] == np.array(at)[bounded].tolist()
    assert "/tube" not in played


@pytest.fixture(scope="module")
def recorded(folder: Path) -> tuple[dict[str, list[Played]], viatool.Result]:
    policy, world_map = load_policy(folder / "straight.onnx"), load_map(folder / "hall.yaml")
    messages, _ = drive_messages(policy, world_map)
    bag = write_bag(folder / "run", messages, "mcap")
    result = viatool.verify(
        policy, world_map, eps=0.02, trajectory=bag, bag=BagSettings(goal=world_map.scenarios[0].goal)
    )
    return play(StatesRun(result), folder / "recorded.mcap"), result


def test_states_of_a_recording_are_played_beside_it(
    recorded: tuple[dict[str, list[Played]], viatool.Result],
) -> None:
    played, result = recorded
    stamps = START + np.rint(result.trajectory.time * SECOND).astype(np.int64)
    for topic in ("/pose", "/nominal/scan", "/tf"):
        assert [one.at for one in played[topic]] == stamps.tolist()
    (part,) = played["/tf"][0].message.transforms
    assert part.child_frame_id == "viatool/base_link"  # in its own tree base_link has a parent
    assert {one.message.header.frame_id for one in played["/nominal/scan"]} == {"viatool/base_link"}


def test_the_same_result_gives_the_same_bytes_and_old_areas_give_way(
    result: viatool.Result, monkeypatch: pytest.MonkeyPatch
) -> None:
    first, second = (b"".join(content_of(Output("mcap", Path("-")), StatesRun(result))) for _ in range(2))
    assert first == second
    assert first.startswith(b"\x89MCAP0\r\n")
    monkeypatch.setattr("viatool.report.states.playback._SHOWN", 5)
    numbers = [
        marker["id"]
        for message in StatesRun(result).play()
        if message.topic == "/swept"
        for marker in message.fields["markers"]
        if "id" in marker
    ]
    assert set(numbers) == set(range(5))


def test_a_recording_is_written_whole_or_not_at_all(
    result: viatool.Result, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    document = StatesRun(result)
    real = document.play

    def broken() -> Any:
        for number, message in enumerate(real()):
            if number == 100:
                raise OSError(28, "no space left")
            yield message

    monkeypatch.setattr(document, "play", broken)
    target = tmp_path / "broken.mcap"
    with pytest.raises(ConfigurationError, match="no space left"):
        write_outputs(document, [Output("mcap", target)])
    assert list(tmp_path.iterdir()) == []


def test_messages_are_made_one_at_a_time(result: viatool.Result) -> None:
    messages = StatesRun(result).play()
    assert [next(messages).topic for _ in range(3)] == ["/map", "/obstacles", "/goal"]


def test_names_in_a_map_stay_text(folder: Path, tmp_path: Path) -> None:
    hostile = "a\x1b[31m\nb"
    (tmp_path / "hall.yaml").write_text(
        MAP.replace("name: past", f"name: {json.dumps(hostile)}"), encoding="utf-8"
    )
    result = viatool.verify(folder / "straight.onnx", tmp_path / "hall.yaml", eps=0.01)
    played = play(StatesRun(result), tmp_path / "hostile.mcap")
    assert all(marker.text.isprintable() for _, marker in drawn(played["/witness"]))


def test_what_has_no_states_at_hand_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="needs more than the JSON") as caught:
        parse_output("mcap:run.mcap", StatesDocument)
    assert "run viatool verify again with --output mcap:PATH" in caught.value.hint
    assert mcap.LIBRARIES == ("rosbags",)


def test_states_without_a_distance_are_shown_as_what_is_reached(folder: Path, tmp_path: Path) -> None:
    result = viatool.verify(
        folder / "straight.onnx", folder / "hall.yaml", eps=0.0, clearance=0.0, danger=0.0
    )
    played = play(StatesRun(result), tmp_path / "near.mcap")
    found = drawn(played["/swept"])
    assert len(found) == len(result.verdict)
    assert all(holds(marker, place) for (_, marker), place in zip(found, result.poses[:, :2], strict=True))
