"""Runs that do not arrive refute a mission, and can be driven again; with another policy they are late no longer."""

from __future__ import annotations

import json
from itertools import pairwise

import numpy as np
import pytest

from tests import hall
from tests.missions import parking
from tests.missions.test_goals import parked
from viatool import load_map, load_policy
from viatool.cli import main
from viatool.errors import ConfigurationError
from viatool.loop.destination import NearPlace, StatesInPolygon, StatesReached
from viatool.missions import mission
from viatool.policy import ActionChannel, Affine, Input, Network, PolicySpecification, write_onnx
from viatool.policy.specification import ObservationChannel
from viatool.report.missions.run import MissionsRun
from viatool.verification import run_entries
from viatool.verification.run_entries import arrival_document, read_arrival
from viatool.verification.witness_file import load_witnesses, replay

GOALS = {
    "a polygon": "[[-0.5, -0.5], [0.0, -0.5], [-0.5, 0.0]]",
    "states": "{lower: [-0.5, -0.5, null, 0.4], upper: [0.5, 0.5, null, 9]}",
    "a place": "[-0.9, -0.9]",
}
GOALS_AROUND = {
    "a place": "[0, 0]",
    "states": "{lower: [-0.5, -0.5, null], upper: [0.5, 0.5, null]}",
    "a polygon": "[[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]]",
}


def run(*arguments):
    with pytest.raises(SystemExit) as left:
        main([str(one) for one in arguments])
    return left.value.code


@pytest.fixture(scope="module")
def policy(tmp_path_factory):
    return load_policy(parking.write_parking_policy(tmp_path_factory.mktemp("policies") / "parking.onnx"))


@pytest.mark.parametrize("goal", GOALS.values(), ids=GOALS)
def test_a_late_run_is_driven_again_and_no_longer_by_another_policy(goal, policy, tmp_path, capsys):
    world = parked(tmp_path, goal)
    witnesses = tmp_path / "late.json"
    asked = ["mission", policy.path, "--map", world.path, "--eps", "0.003", "--quiet"]
    assert run(*asked, "--output", f"witnesses:{witnesses}") == 0
    (entry,) = json.loads(witnesses.read_text())["witnesses"]
    assert len(entry["before"]) == 29
    assert entry["late"]["arrive"] == "at"
    capsys.readouterr()
    assert run("replay", witnesses) == 0
    told = " ".join(capsys.readouterr().out.split())
    assert "1 of 1 witnesses are still on their way" in told
    assert "does not arrive" in told
    other = parking.write_parking_policy(tmp_path / "other.onnx", seed=3)
    assert run("replay", witnesses, "--policy", other, "--quiet") == 1


def test_the_run_follows_from_its_commands_by_an_oracle(policy, tmp_path):
    found = mission(policy, parked(tmp_path, GOALS["a polygon"]), eps=0.003)
    (entry,) = MissionsRun(found).witness_file()["witnesses"]
    steps = [*entry["before"], {**entry, "motion": entry["motion"][0]}]
    for step, after in pairwise(steps):
        begin = np.array([[*step["pose"], *step["motion"]]])
        end = parking.drive(begin, np.array([step["action"]]), 1.5)[0, -1]
        np.testing.assert_allclose(end[:3], after["pose"], atol=1e-6)
        read = begin[0, [0, 1, 3, 2]]
        assert (np.abs(np.array(step["observation"]) - read) <= 0.003 + 1e-6).all()


def test_a_run_that_arrives_or_jumps_is_not_late(policy, tmp_path):
    world = parked(tmp_path, GOALS["a polygon"])
    document = MissionsRun(mission(policy, world, eps=0.003)).witness_file()
    path = tmp_path / "changed.json"

    def late():
        path.write_text(json.dumps(document))
        return bool(replay(policy, world, load_witnesses(path)).violates[0])

    assert late()
    (entry,) = document["witnesses"]
    right = entry["late"]
    entry["late"] = {"arrive": "at", "lower": [-0.6, -0.6, None, None], "upper": [0.6, 0.6, None, None]}
    assert not late()
    entry["late"] = {**right, "arrive": "within", "outline": [[2.5, 2.5], [3.5, 2.5], [3.5, 3.5], [2.5, 3.5]]}
    assert not late()  # the first interval ends there
    entry["late"] = right
    entry["before"][7]["pose"][0] += 1e-3
    assert not late()


LEAVING = """\
schema_version: 1
arena: {shape: box, center: [0, 0], size: [10, 10]}
robot:
  {kinematics: KINEMATICS, min_linear: 0, max_linear: 0.5, max_angular: 1.0, min_acceleration: -1,
   max_acceleration: 1, control_interval: 0.2, footprint: {shape: point}}
clearance: {collision: 0.1, danger: 0.2}
scenarios:
  - name: stay
    start: {lower: [-0.1, -0.1, 0], upper: [0.1, 0.1, 0]}
    goal: GOAL
    deadline: 4
    arrive: at
"""


@pytest.mark.parametrize("goal", GOALS_AROUND.values(), ids=GOALS_AROUND)
@pytest.mark.parametrize(
    ("kinematics", "kind"),
    [("differential", "linear"), ("holonomic", "linear"), ("second_order_linear", "linear_acceleration")],
)
def test_a_run_that_leaves_the_goal_before_the_deadline_refutes(kinematics, kind, goal, tmp_path):
    """All runs are there after the first interval, to be there after the last one alone would count."""
    lateral = [("lateral", 0.0)] if kinematics == "holonomic" else []
    commands = [(kind, 0.25), *lateral, ("angular", 0.0)]
    spec = PolicySpecification(
        schema_version=2,
        observation=[ObservationChannel(name="x", kind="pose_x")],
        action=[ActionChannel(name=name, kind=name, lower=-1.0, upper=1.0) for name, _ in commands],
        control_interval=0.2,
    )
    always = Affine((0,), (np.zeros((len(commands), 1)),), np.array([command for _, command in commands]))
    write_onnx(Network((Input(1), always)), spec, tmp_path / "ahead.onnx")
    world = tmp_path / "map.yaml"
    world.write_text(LEAVING.replace("KINEMATICS", kinematics).replace("GOAL", goal))
    (found,) = mission(tmp_path / "ahead.onnx", world, eps=0.01, prefer={"limits": "map"})
    assert found.verdict == "refuted"
    assert found.reason.startswith("a run is still on its way after 4 s")
    assert found.to_json()["arrival"] is None
    assert not found.proof.proved


def test_a_robot_with_a_lidar_that_does_not_arrive_is_driven_again(tmp_path):
    path = tmp_path / "hall.yaml"
    path.write_text(hall.MAP, encoding="utf-8")
    world, policy = load_map(path), load_policy(hall.write_policy(tmp_path / "straight.onnx"))
    found = mission(policy, world, eps=0.01, time_limit=2.0, scenarios=[world.scenarios[1]])
    assert found.missions[0].reason.startswith("a run is still on its way after 2 s")
    document = MissionsRun(found).witness_file()
    (tmp_path / "late.json").write_text(json.dumps(document))
    assert replay(policy, world, load_witnesses(tmp_path / "late.json")).violates.tolist() == [True]


@pytest.mark.parametrize(
    "destination",
    [
        NearPlace(False, np.array([1.0, 2.0]), 0.5),
        StatesReached(True, np.array([0.0, -np.inf, -1.0]), np.array([1.0, np.inf, 1.0])),
        StatesInPolygon(False, np.full(4, -np.inf), np.full(4, np.inf), np.array([[0.0, 0], [1, 0], [1, 1]])),
    ],
)
def test_where_a_run_was_to_arrive_is_written_and_read(destination):
    text = json.dumps(arrival_document(destination), allow_nan=False)
    again = read_arrival(json.loads(text))
    assert type(again) is type(destination)
    assert arrival_document(again) == arrival_document(destination)


def test_a_file_that_does_not_say_where_is_refused(policy, tmp_path):
    document = MissionsRun(mission(policy, parked(tmp_path, GOALS["a polygon"]), eps=0.003)).witness_file()
    document["witnesses"][0]["late"] = {"arrive": "soon"}
    (tmp_path / "late.json").write_text(json.dumps(document))
    with pytest.raises(ConfigurationError, match="not a witness file"):
        load_witnesses(tmp_path / "late.json")


def test_commands_of_the_program_count_and_not_those_of_the_file(policy, tmp_path, monkeypatch):
    """A replay that took the recorded commands for those of the program would find every policy late."""
    world = parked(tmp_path, GOALS["a polygon"])
    (tmp_path / "late.json").write_text(
        json.dumps(MissionsRun(mission(policy, world, eps=0.003)).witness_file())
    )
    file = load_witnesses(tmp_path / "late.json")
    other = load_policy(parking.write_parking_policy(tmp_path / "other.onnx", seed=3))
    assert not replay(other, world, file).violates[0]
    monkeypatch.setattr(run_entries, "_ELSEWHERE", np.inf)
    assert replay(other, world, file).violates[0]
