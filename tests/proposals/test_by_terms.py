"""Proposals from what exporters state: metadata, policy_contract.json, parameter files of ROS packages."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import yaml
from onnx import helper

from tests.policy.models import save, two_layers
from viatool.errors import PolicyError
from viatool.policy import PolicySpecification, describe, load_policy
from viatool.proposals import specification_text

MJLAB = {
    "observation_names": "base_lin_vel,base_ang_vel,projected_gravity,pose_command,actions,height_scan",
    "observation_terms_scale": "2.0,0.25,1.0,1.0,1.0,0.5",
    "observation_terms_history_length": "0,0,0,0,0,3",
    "observation_terms_clip": "-inf;inf,-inf;inf,-inf;inf,-inf;inf,-inf;inf,-1.0;1.0",
    "joint_names": "v,omega",
    "action_scale": "0.5,2.0",
}
SIZE = 3 + 3 + 3 + 4 + 2 + 3 * 5


def policy(folder: Path, metadata: dict[str, str] | None = None, size: int = SIZE) -> Path:
    model = two_layers(size=size, actions=2)
    helper.set_model_props(model, metadata or {})
    return save(model, folder)


def proposed(path: Path, parameters: Path | None = None) -> tuple[PolicySpecification, str]:
    text = specification_text(describe(path), parameters)
    sidecar = path.with_suffix(".yaml")
    sidecar.write_text(text, encoding="utf-8")
    spec = load_policy(path, sidecar).spec  # its sizes are those of the graph
    assert spec is not None
    return spec, text


def test_terms_of_mjlab_and_isaac_lab_become_channels(tmp_path: Path) -> None:
    spec, text = proposed(policy(tmp_path, MJLAB))
    kinds = [channel.kind for channel in spec.observation]
    assert kinds[:3] == ["linear_velocity", "lateral_velocity", "constant"]
    assert kinds[3:6] == ["constant", "constant", "angular_velocity"]
    assert [channel.value for channel in spec.observation[6:9]] == [0.0, 0.0, -1.0]
    assert kinds[9:] == ["goal_x", "goal_y", "constant", "other", "previous_raw", "lidar"]
    assert [spec.observation[index].scale for index in (0, 5, 9)] == [2.0, 0.25, 1.0]
    scan = spec.observation[-1]
    assert (scan.size, scan.scale, scan.clip) == (5, 0.5, (-0.5, 0.5))
    assert scan.frames is not None
    assert (scan.frames.count, scan.frames.order) == (3, "oldest_first")
    assert [(action.name, action.scale) for action in spec.action] == [("v", 0.5), ("omega", 2.0)]
    assert "metadata" in text
    assert "base_lin_vel is linear_velocity, lateral_velocity, vertical_velocity" in text


def test_one_scale_is_that_of_every_action(tmp_path: Path) -> None:
    spec, _ = proposed(policy(tmp_path, {**MJLAB, "action_scale": "0.25"}))
    assert [action.scale for action in spec.action] == [0.25, 0.25]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"observation_terms_scale": "1,2"},
            "observation_names has 6 terms, but observation_terms_scale has 2",
        ),
        (
            {"observation_terms_clip": "0;1"},
            "observation_names has 6 terms, but observation_terms_clip has 1",
        ),
        ({"observation_terms_history_length": "0,0,0,0,0,4"}, r"height_scan \? x 4 frames = 15 and more"),
        (
            {"observation_names": "base_lin_vel,base_ang_vel,projected_gravity,pose_command,actions,actions"},
            r"actions 2, actions 2 x 3 frames = 21, but the model takes 30",
        ),
        (
            {"joint_names": "a,b,c", "action_scale": "1,1,1"},
            "3 actions are stated, but the model gives 2 numbers",
        ),
        ({"action_scale": "1,1,1"}, "joint_names has 2 names, but action_scale has 3 numbers"),
        ({"observation_terms_scale": "0,1,1,1,1,1"}, "observation.0.*has scale 0"),
        ({"action_scale": "nan"}, "action_scale is 'nan', where finite numbers"),
        ({"action_scale": "big"}, "action_scale is 'big', where finite numbers"),
        ({"observation_terms_clip": "a,b,c,d,e,f"}, "observation_terms_clip holds 'a', where low;high"),
        (
            {"observation_names": "base_lin_vel,base_ang_vel,projected_gravity,map,actions,sound"},
            "nothing says how long the terms map, sound are",
        ),
    ],
)
def test_metadata_that_contradict_the_graph_are_refused_with_both(
    change: dict[str, str], message: str, tmp_path: Path
) -> None:
    with pytest.raises(PolicyError, match=message) as refusal:
        specification_text(describe(policy(tmp_path, {**MJLAB, **change})))
    assert "policy.onnx" in refusal.value.message or "model.onnx" in refusal.value.message
    assert refusal.value.hint


def contract() -> dict[str, Any]:
    return {
        "observations": [
            {"name": "lidar", "shape": [3, 8], "scale": 0.1, "clip": [0.0, 10.0]},
            {"name": "goal_distance", "size": 1},
            {"name": "goal_angle", "size": 1},
        ],
        "actions": [
            {"name": "forward", "kind": "linear", "lower": 0.0, "upper": 0.3, "scale": 0.15, "offset": 0.15},
            {"name": "turn", "kind": "angular", "lower": -1.2, "upper": 1.2, "scale": 1.2},
        ],
        "control_dt": 0.2,
    }


def test_a_contract_beside_the_policy_is_found(tmp_path: Path) -> None:
    path = policy(tmp_path, size=26)
    (tmp_path / "policy_contract.json").write_text(json.dumps(contract()))
    spec, text = proposed(path)
    assert [channel.kind for channel in spec.observation] == ["lidar", "goal_distance", "goal_bearing"]
    assert spec.observation[0].clip == (0.0, 1.0)
    assert [(a.name, a.kind, a.scale, a.offset) for a in spec.action] == [
        ("forward", "linear", 0.15, 0.15),
        ("turn", "angular", 1.2, 0.0),
    ]
    assert spec.control_interval == 0.2
    assert "policy_contract.json" in text


def test_a_contract_may_hold_the_lists_of_the_metadata(tmp_path: Path) -> None:
    path = policy(tmp_path)
    lists = {key: value.split(",") for key, value in MJLAB.items()}
    (tmp_path / "elsewhere.json").write_text(json.dumps(lists))
    spec, _ = proposed(path, tmp_path / "elsewhere.json")
    assert spec.observation[0].scale == 2.0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "policy_contract.json is not JSON"),
        ("[]", "holds a list, where an object"),
        ("{}", "'observations' is missing"),
        ('{"observations": [{"size": 3}]}', "is no term"),
        ('{"observations": [{"name": "scan", "size": "many"}]}', "is no term"),
        ('{"observations": [{"name": "scan", "size": 26, "scale": NaN}]}', "is no term"),
        ('{"observations": [{"name": "scan", "size": 26, "clip": ["a", 1]}]}', "is no term"),
        ('{"observations": [{"name": "scan", "size": 26, "scale": 1' + "0" * 400 + "}]}", "is no term"),
        ('{"observations": [{"name": "x", "size": 26}], "actions": [{"kind": "jump"}, {}]}', "action.0.kind"),
        ('{"observations": [{"name": "scan", "size": 4}]}', "scan 4 = 4, but the model takes 26"),
        ('{"observations": [{"name": "scan", "size": 26}], "actions": 3}', "'actions' is no list"),
    ],
)
def test_a_contract_that_is_none_is_refused(text: str, message: str, tmp_path: Path) -> None:
    path = policy(tmp_path, size=26)
    (tmp_path / "policy_contract.json").write_text(text)
    with pytest.raises(PolicyError, match=message):
        specification_text(describe(path))


def test_parameters_of_a_ros_package_are_taken(tmp_path: Path) -> None:
    parameters = tmp_path / "params.yaml"
    parameters.write_text(
        yaml.safe_dump(
            {
                "rl_node": {
                    "ros__parameters": {
                        "max_linear_velocity": 0.4,
                        "max_angular_velocity": 1.8,
                        "lidar_max_range": 12.0,
                        "control_frequency": 5.0,
                        "robot_name": "jackal",
                        "use_sim_time": True,
                        "max_range": float("inf"),
                        "min_vel_x": 10**400,
                        "model_path": "policy.onnx",
                    }
                }
            }
        )
    )
    spec, text = proposed(policy(tmp_path, size=362), parameters)
    assert [(a.lower, a.upper) for a in spec.action] == [(0.0, 0.4), (-1.8, 1.8)]
    assert [(a.scale, a.offset) for a in spec.action] == [
        (0.2, 0.2),
        (1.8, 0.0),
    ]  # a tanh is stretched over them
    assert spec.observation[0].lidar is not None
    assert spec.observation[0].lidar.maximum_range == 12.0
    assert (spec.robot, spec.control_interval) == ("jackal", 0.2)
    assert "linear.upper is 0.4, from 'max_linear_velocity'" in text
    for broken in ("- 1", "a: [", ""):
        parameters.write_text(broken)
        with pytest.raises(PolicyError, match=r"params\.yaml"):
            specification_text(describe(policy(tmp_path, size=362)), parameters)
    with pytest.raises(PolicyError, match="cannot read the parameters"):
        specification_text(describe(policy(tmp_path, size=362)), tmp_path / "missing.yaml")
    with pytest.raises(PolicyError, match=r"cannot read .*missing.json"):
        specification_text(describe(policy(tmp_path, size=362)), tmp_path / "missing.json")
