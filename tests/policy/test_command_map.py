"""Whatever order and units a policy speaks in: what reaches the robot is its command, in proofs as in runs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mpmath
import numpy as np
import pytest

from tests.channels.square import lidar, square
from viatool import verify
from viatool.errors import ConfigurationError, PolicyError
from viatool.motion.kinematics import kinematics_of, motion_of
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
from viatool.policy.activations import activation
from viatool.policy.command_map import CommandMap, command_map
from viatool.setting.setting import Setting
from viatool.taylor import reach
from viatool.taylor.curve import curve_of
from viatool.taylor.interval import ENCLOSED_FUNCTIONS, Interval
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
        (["linear_acceleration", "angular"], "p commands angular and linear_acceleration, a robot of"),
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


CAR = Robot(kinematics="ackermann", min_linear=0.0, max_linear=0.4, max_steering=0.3, wheelbase=0.3)
STEERED = [
    ActionChannel(name="bend", lower=-0.5, upper=0.5, kind="steering"),
    ActionChannel(name="v", lower=0.0, upper=1.0, kind="linear"),
]


def car_map(actions: list[ActionChannel], robot: Robot) -> CommandMap:
    spec = PolicySpecification(observation=[lidar("lidar", 3.0, 4)], action=actions)
    return command_map(spec, kinematics_of(robot.kinematics), robot)


def test_a_car_turns_by_the_speed_and_the_angle_that_it_reaches() -> None:
    """A speed beyond the robot's is clipped before the turn is computed of it, and so is the angle."""
    commands = car_map(STEERED, CAR)(np.array([[0.5, 1.0], [-0.2, 0.1], [0.1, -3.0]]))
    expected = [[0.4, 0.4 * np.tan(0.3) / 0.3], [0.1, -0.1 * np.tan(0.2) / 0.3], [0.0, 0.0]]
    np.testing.assert_allclose(commands, expected, rtol=1e-12, atol=1e-15)


def test_rims_are_clipped_one_by_one() -> None:
    rims = [
        ActionChannel(name=side, lower=-0.2, upper=0.5, kind=f"{side}_wheel") for side in ("right", "left")
    ]
    commands = car_map(rims, Robot(track=0.25))(np.array([[0.9, 0.1], [-1.0, 0.5]]))
    np.testing.assert_allclose(commands, [[0.3, 1.6], [0.15, -2.8]], rtol=1e-12)


@pytest.mark.parametrize(
    ("robot", "told"),
    [
        (replace(CAR, wheelbase=0.0), "wheelbase of 0 m"),
        (replace(CAR, max_steering=1.6), "steers up to 1.6 rad"),
        (
            replace(CAR, max_steering_rate=3.2, kinematics="second_order_ackermann"),
            "turns its wheels by at most 3.2 rad/s, and is followed only where they turn at once",
        ),
    ],
)
def test_cars_that_are_not_known_or_not_followed_are_refused(robot: Robot, told: str) -> None:
    with pytest.raises(ConfigurationError, match=told) as raised:
        motion_of(robot).limits(robot)
    assert raised.value.hint


@pytest.mark.parametrize("name", ["second_order_linear", "second_order_angular", "second_order"])
def test_robots_of_which_nobody_said_how_they_accelerate_are_refused(name: str) -> None:
    robot = Robot(kinematics=name)
    with pytest.raises(ConfigurationError, match=r"accelerates .* is not known") as raised:
        motion_of(robot).limits(robot)
    assert "acceleration" in raised.value.hint


def test_wheels_of_a_robot_whose_width_nobody_said_are_refused() -> None:
    rims = [
        ActionChannel(name=side, lower=-0.2, upper=0.5, kind=f"{side}_wheel") for side in ("right", "left")
    ]
    with pytest.raises(ConfigurationError, match="track of robot 'turtlebot3' is not known"):
        car_map(rims, Robot())


def test_what_speed_and_angle_have_in_common_is_kept(tmp_path: Path) -> None:
    """Two outputs that cancel in the turn: a box around each of them by itself would not tell."""
    rows = np.array([[0.1, 0.0, 0.0, 0.0], [0.1, 0.0, 0.0, 0.0]])
    rims = [
        ActionChannel(name=side, lower=-1.0, upper=1.0, kind=f"{side}_wheel") for side in ("right", "left")
    ]
    policy = policy_of(tmp_path / "rims.onnx", rims, rows)
    sets = reach(policy.commanding(car_map(rims, Robot(track=0.1))), np.full((1, 4), 2.0), 0.5)
    assert sets.upper[0, 0] - sets.lower[0, 0] == pytest.approx(0.1, rel=1e-4)
    assert np.abs([sets.lower[0, 1], sets.upper[0, 1]]).max() < 1e-4, "both rims turn alike"


def test_a_tangent_is_enclosed_up_to_its_limits() -> None:
    curve = curve_of(activation("ClippedTan", min=-0.9, max=1.4))
    generator = np.random.default_rng(4)
    lower = generator.uniform(-1.5, 1.6, 400)
    upper = lower + generator.choice([0.0, 1e-3, 0.3, 2.0], 400)
    for derivative in range(3):
        found = curve.range(lower, upper, derivative)
        for share in np.linspace(0.0, 1.0, 9):
            x = np.clip(lower + share * (upper - lower), lower, upper)
            inside = (x > -0.9) & (x < 1.4)
            tangent = np.tan(np.clip(x, -0.9, 1.4))
            expected = [tangent, inside * (1 + tangent**2), inside * 2 * tangent * (1 + tangent**2)][
                derivative
            ]
            slack = 1e-12 * (1.0 + np.abs(expected))
            assert (found.lower <= expected + slack).all()
            assert (expected - slack <= found.upper).all()


RIMS = [ActionChannel(name=side, lower=-0.2, upper=0.5, kind=f"{side}_wheel") for side in ("right", "left")]


@pytest.mark.parametrize(
    ("actions", "robot"), [(STEERED, CAR), (RIMS, Robot(track=0.25))], ids=["car", "wheels"]
)
def test_outputs_beyond_what_the_robot_does_are_clipped_in_the_network_too(
    actions: list[ActionChannel], robot: Robot, tmp_path: Path
) -> None:
    """Version 1 clips nothing by itself: the map does, and bounds are of what is left."""
    rows = np.array([[0.3, 0.1, -0.3, 0.0], [0.2, -0.2, 0.3, 0.1]])
    policy, commands = policy_of(tmp_path / "wild.onnx", actions, rows), car_map(actions, robot)
    commanding, generator = policy.commanding(commands), np.random.default_rng(5)
    seen = generator.uniform(0.0, 4.0, (100, 4)).astype(np.float32).astype(np.float64)
    np.testing.assert_allclose(commanding(seen), commands(policy(seen)), rtol=1e-12, atol=1e-15)
    sets = reach(commanding, seen, 0.2)
    for _ in range(20):
        found = commands(policy.run(seen + 0.1999 * generator.choice([-1.0, 0.4, 1.0], seen.shape)))
        assert ((found >= sets.lower) & (found <= sets.upper)).all()


def test_the_interval_of_a_tangent_holds_it_and_ends_before_a_pole() -> None:
    tan, points = ENCLOSED_FUNCTIONS["tan"], np.random.default_rng(6).uniform(-1.55, 1.55, 500)
    found = tan(Interval(points, points))
    exact = [mpmath.tan(mpmath.mpf(float(point))) for point in points]
    ends = zip(found.lower.tolist(), exact, found.upper.tolist(), strict=True)
    assert all(mpmath.mpf(low) < value < mpmath.mpf(high) for low, value, high in ends)
    across = tan(Interval(np.array([1.5, -1.6]), np.array([1.7, 0.0])))
    assert np.isneginf(across.lower).all()
    assert np.isposinf(across.upper).all()
