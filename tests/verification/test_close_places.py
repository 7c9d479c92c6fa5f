"""Places beside the driven path at which it is up to the policy whether the robot comes too near."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnx
import pytest
from click.testing import CliRunner
from onnx import numpy_helper

import viatool
from tests.remembering import written
from viatool.cli import main
from viatool.cli.states import DEFAULT_CLOSE
from viatool.errors import ConfigurationError, EmptyEvaluationError
from viatool.safety import JudgedStates, ScenePoses, find_contested
from viatool.simulate import Places
from viatool.verification.close import CLOSE, MOST, close_places
from viatool.verification.states import states_of
from viatool.world import Scenes

COUNT = 60
SAMPLES = Path(__file__).parents[2] / "policies"
ROOM = Path(__file__).parents[2] / "examples" / "zoo" / "room.yaml"


@pytest.fixture(scope="module")
def driven() -> viatool.Result:
    return viatool.verify("via", "lab", eps=0.01, scenarios=viatool.load_map("lab").scenarios[:3])


@pytest.fixture(scope="module")
def places(driven) -> viatool.Trajectory:
    return close_places(driven.setting, driven.trajectory, COUNT, seed=4)


def test_every_place_is_free_and_contested(driven, places) -> None:
    setting = driven.setting
    assert len(places) == COUNT
    scenes = Scenes.of(setting.world_map, places.scenarios)
    clearance = scenes.footprint_clearance(places.poses, setting.rules.footprint, places.episode)
    assert (clearance > setting.rules.clearance.collision).all()
    states = states_of(setting, places)
    at = ScenePoses.of(setting.world_map, places.scenarios, places.poses, places.episode)
    judged = JudgedStates(setting.rules, at, states.under_way, states.measured, states.begun)
    assert find_contested(judged).collision.all()
    assert not find_contested(
        replaced(judged, driven)
    ).collision.any()  # as the driven states beside them are not


def replaced(judged, driven) -> JudgedStates:
    trajectory, setting = driven.trajectory, driven.setting
    states = states_of(setting, trajectory)
    at = ScenePoses.of(setting.world_map, trajectory.scenarios, trajectory.poses, trajectory.episode)
    return JudgedStates(setting.rules, at, states.under_way, states.measured, states.begun)


def test_a_seed_means_its_places(driven, places) -> None:
    again, other = (close_places(driven.setting, driven.trajectory, COUNT, seed=seed) for seed in (4, 5))
    np.testing.assert_array_equal(again.poses, places.poses)
    np.testing.assert_array_equal(again.observations, places.observations)
    assert not np.isin(other.poses[:, 0], places.poses[:, 0]).any()


def test_sensors_observe_the_place_and_the_command_before_is_that_of_the_driven_state(driven, places) -> None:
    spec, driven = driven.setting.spec, driven.trajectory
    beside = np.array([
        np.flatnonzero((driven.episode == episode) & (driven.time == time))[0]
        for episode, time in zip(places.episode, places.time, strict=True)
    ])  # fmt: skip
    for name in ("previous_linear", "previous_angular"):
        columns = spec.inputs.newest(name)
        np.testing.assert_array_equal(
            places.observations[:, columns], driven.observations[beside][:, columns]
        )
    goals = np.array([scenario.goal for scenario in places.scenarios])[places.episode]
    column = spec.inputs.newest("goal_distance")[0]
    lower, upper = spec.inputs.readings(places.observations)
    distance = np.hypot(*(goals - places.poses[:, :2]).T)
    np.testing.assert_allclose(0.5 * (lower + upper)[:, column], distance, atol=1e-3)
    assert (np.hypot(*(places.poses - driven.poses[beside])[:, :2].T) <= 4.0).all()


def test_no_wall_is_between_a_place_and_the_driven_state(driven, places) -> None:
    scenes = Scenes.of(driven.setting.world_map, places.scenarios)
    rows = [
        np.flatnonzero((driven.episode == episode) & (driven.trajectory.time == time))[0]
        for episode, time in zip(places.episode, places.time, strict=True)
    ]
    between = np.linspace(driven.poses[rows, :2], places.poses[:, :2], 50)
    for points in between:
        assert (scenes.clearance(points, places.episode) > 0.0).all()


def test_what_is_not_known_of_a_place_is_refused_by_name(driven) -> None:
    for count in (0, MOST + 1):
        with pytest.raises(ConfigurationError, match=f"{count} close places"):
            close_places(driven.setting, driven.trajectory, count)


def test_a_robot_that_nothing_endangers_has_no_close_places(driven) -> None:
    still = viatool.verify(
        "via", "lab", eps=0.01, trajectory=driven.trajectory, interval=1e-6, prefer={"interval": "map"}
    )
    with pytest.raises(EmptyEvaluationError, match="no place within 4 m"):
        close_places(still.setting, driven.trajectory, 10)


def test_a_place_is_examined_as_a_driven_state_is() -> None:
    """The verdicts are those of the same places given as states."""
    found = viatool.verify("td3", "lab", eps=0.05, close=80, seed=3)
    assert found.close is not None
    again = viatool.verify("td3", "lab", eps=0.05, trajectory=found.close.trajectory, seed=3)
    assert set(found.close.verdict) >= {"safe", "unsafe"}
    for name, array in again.state_table().items():
        np.testing.assert_array_equal(found.close.state_table()[name], array, err_msg=name)
    assert found.close_rate.overall == found.close.safety_rate.overall == again.contested_rate.overall
    alone = viatool.verify("td3", "lab", eps=0.05, places=Places(near=80), seed=3)
    np.testing.assert_array_equal(alone.verdict, found.close.verdict)
    np.testing.assert_array_equal(alone.poses, found.close.poses)


def test_close_places_count_into_nothing_of_the_drive() -> None:
    few = viatool.load_map("lab").scenarios[:2]
    found, none = (viatool.verify("td3", "lab", eps=0.1, scenarios=few, close=count) for count in (40, 0))
    for name, array in none.state_table().items():
        np.testing.assert_array_equal(found.state_table()[name], array, err_msg=name)
    own = {"close_rate", "close", "seconds", "assumptions"}
    reports = [
        {key: value for key, value in one.to_json().items() if key not in own} for one in (found, none)
    ]
    assert reports[0] == reports[1]
    assert "close" not in none.to_json()
    assert none.to_json()["close_rate"]["overall"] == {"safe": 0, "total": 0, "rate": None}
    assert found.to_json()["close"]["states"] == found.to_json()["close_rate"]["overall"]["total"] == 40


def test_workers_and_checkpoints_change_nothing(tmp_path) -> None:
    asked = {"eps": 0.1, "scenarios": viatool.load_map("lab").scenarios[:1], "close": 40}
    here = viatool.verify("td3", "lab", **asked)
    kept = {"checkpoint": tmp_path / "run", "workers": 2}
    for more in (kept, {**kept, "resume": True}):
        other = viatool.verify("td3", "lab", **asked, **more)
        for name, array in here.close.state_table().items():
            np.testing.assert_array_equal(other.close.state_table()[name], array, err_msg=name)


def untrained(path, seed: int = 0):
    """Write an actor like via.onnx with the weights with which training begins."""
    model, rng = onnx.load(SAMPLES / "via.onnx"), np.random.default_rng(seed)
    for one in model.graph.initializer:
        if one.name.startswith("weight"):
            bound = 1.0 / np.sqrt(one.dims[1])
            drawn = rng.uniform(-bound, bound, tuple(one.dims)).astype(np.float32)
            one.CopyFrom(numpy_helper.from_array(drawn, one.name))
    onnx.save(model, path)
    return path


def test_an_untrained_actor_looks_bad(tmp_path) -> None:
    rates = {}
    for name in ("via", "td3", untrained(tmp_path / "untrained.onnx")):
        found = viatool.verify(name, "lab", eps=0.01)
        assert found.close_rate.overall.total == 300
        rates[str(name)] = float(found.close_rate)
    via, td3, bad = rates.values()
    assert bad < 0.6 < 0.8 < min(via, td3)
    assert len({via, td3, bad}) == 3


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        ((), "places that were picked"),
        (("--errors", "moving.yaml"), "things move"),
    ],
)
def test_where_there_are_none_the_report_says_why_and_a_gate_has_nothing_to_decide(
    tmp_path, monkeypatch, arguments, reason
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "moving.yaml").write_text("version: 1\nobstacles: {speed: 0.2}\n")
    places = () if arguments else ("--poses", "random:20")
    command = ["verify", "via", "--map", "lab", "--eps", "0.01", "--scenarios", "1", *places, *arguments]
    run = CliRunner().invoke(main, [*command, "-o", "json:report.json"])
    assert (run.exit_code, reason in " ".join(run.stdout.split())) == (0, True), run.output
    for gated in (command, ["gate", "report.json"]):
        gate = CliRunner().invoke(main, [*gated, "--fail-under", "close=0.5"])
        assert (gate.exit_code, reason in gate.stderr) == (5, True)


def test_a_memory_is_known_of_no_place(tmp_path) -> None:
    policy, spec = written(tmp_path)
    found = viatool.verify(policy, ROOM, spec=spec, eps=0.01, scenarios=viatool.load_map(ROOM).scenarios[:1])
    assert (found.close, "remembers" in found.no_close) == (None, True)
    assert found.to_json()["close"]["reason"] == found.no_close


def test_the_command_line_asks_for_as_many_as_python() -> None:
    assert DEFAULT_CLOSE == CLOSE
