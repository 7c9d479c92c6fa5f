"""Whatever order and units a policy speaks in: what reaches the robot is its command, in proofs as in runs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.channels.square import lidar, square
from viatool import verify
from viatool.errors import PolicyError
from viatool.motion.kinematics import kinematics_of
from viatool.policy import (
    ActionChannel,
    Affine,
    Input,
    Network,
    Policy,
    PolicySpecification,
    load_policy,
    write_onnx,
)
from viatool.policy.command_map import command_map
from viatool.setting.setting import Setting
from viatool.taylor import reach
from viatool.world import Robot

V = ActionChannel(name="v", unit="m/s", lower=0.0, upper=0.5, kind="linear")
W = ActionChannel(name="w", unit="rad/s", lower=-1.0, upper=1.0, kind="angular")
LAMP = ActionChannel(name="lamp", lower=0.0, upper=1.0)


def policy_of(path: Path, actions: list[ActionChannel], weight: np.ndarray, version: int = 1) -> Policy:
    """A linear policy of 4 numbers of a LiDAR."""
    spec = PolicySpecification(schema_version=version, observation=[lidar("lidar", 3.0, 4)], action=actions)
    rows = np.float32(weight).astype(np.float64)
    write_onnx(Network((Input(4), Affine((0,), (rows,), np.zeros(len(rows))))), spec, path)
    return load_policy(path)


ROWS = np.array([[0.05, 0.05, 0.0, 0.02], [-0.1, 0.1, 0.1, 0.0], [0.3, 0.0, 0.0, 0.0]])


def test_an_order_of_its_own_and_other_outputs_change_no_verdict(tmp_path: Path) -> None:
    """The same policy, once as the robot takes it, and once turned first and with a lamp between."""
    usual = policy_of(tmp_path / "usual.onnx", [V, W], ROWS[:2])
    other = policy_of(tmp_path / "other.onnx", [W, LAMP, V], ROWS[[1, 2, 0]])
    world = square(tmp_path, collision=0.05)
    first, second = (verify(policy, world, eps=0.3) for policy in (usual, other))
    assert len(set(first.verdict)) > 1
    assert (first.verdict == second.verdict).all()
    np.testing.assert_allclose(first.commands, second.commands, atol=1e-6)
    assert [action.name for action in second.actions] == ["v", "w"]


def test_a_mere_pick_in_order_adds_nothing(tmp_path: Path) -> None:
    policy = policy_of(tmp_path / "usual.onnx", [V, W], ROWS[:2])
    setting = Setting.of(policy, square(tmp_path), 0.1)
    assert setting.commanding(policy) is policy


def test_commands_of_the_network_are_those_of_the_program(tmp_path: Path) -> None:
    policy = policy_of(tmp_path / "other.onnx", [W, LAMP, V], ROWS[[1, 2, 0]])
    commanding = Setting.of(policy, square(tmp_path), 0.1).commanding(policy)
    seen = np.random.default_rng(0).uniform(0.0, 4.0, (50, 4)).astype(np.float32).astype(np.float64)
    expected = seen @ np.float32(ROWS[:2]).astype(np.float64).T
    np.testing.assert_allclose(commanding.run(seen), expected, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(commanding(seen), expected, rtol=1e-12)
    assert policy(seen).shape == (50, 3), "the policy itself goes on to give its actions"


@pytest.mark.parametrize(
    ("kinds", "told"),
    [
        (["linear", "other"], "no action of p is of kind 'angular'"),
        (["linear", "lateral", "angular"], "p commands angular, lateral and linear, a robot of kinematics"),
        (
            ["steering", "linear"],
            "p commands linear and steering, a robot of kinematics 'differential' takes",
        ),
    ],
)
def test_what_a_robot_cannot_be_commanded_with_is_refused(kinds: list[str], told: str) -> None:
    actions = [ActionChannel(name=f"a{n}", lower=-1, upper=1, kind=kind) for n, kind in enumerate(kinds)]
    spec = PolicySpecification(observation=[lidar("lidar", 3.0, 4)], action=actions)
    with pytest.raises(PolicyError, match=told):
        command_map(spec, kinematics_of("differential"), Robot(), "p")


def test_each_action_of_version_2_is_scaled_and_clipped(tmp_path: Path) -> None:
    scaled = [
        V.model_copy(update={"scale": 0.25, "offset": 0.25}),
        W.model_copy(update={"scale": -2.0}),
    ]
    policy = policy_of(tmp_path / "scaled.onnx", scaled, ROWS[:2] * 4.0, version=2)
    seen = np.random.default_rng(1).uniform(0.0, 4.0, (200, 4)).astype(np.float32).astype(np.float64)
    raw = seen @ (np.float32(ROWS[:2] * 4.0).astype(np.float64)).T
    expected = np.clip(raw * [0.25, -2.0] + [0.25, 0.0], [0.0, -1.0], [0.5, 1.0])
    assert (expected == [0.5, -1.0]).any(axis=0).all()
    np.testing.assert_allclose(policy(seen), expected, rtol=1e-12)
    np.testing.assert_allclose(policy.run(seen), expected, atol=1e-5)
    sets = reach(policy, seen, 0.05)
    generator = np.random.default_rng(2)
    for _ in range(30):
        near = policy.run((seen + generator.uniform(-0.0499, 0.0499, seen.shape)).astype(np.float32))
        assert ((near >= sets.lower) & (near <= sets.upper)).all()
    assert policy.maps.after.endswith("clipped to [0, 0.5], [-1, 1]")
    assert "(0.25, -2) * output + (0.25, 0)" in policy.maps.after
