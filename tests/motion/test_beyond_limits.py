"""States in which a robot was faster, or its wheels steered farther, than its limits say."""

from __future__ import annotations

import numpy as np
import pytest

from tests.motion import changing_plant as plant
from tests.motion.changing_square import INTERVAL, RANGES, ROBOTS
from viatool import load_policy, verify
from viatool.loop.closed_loop import ClosedLoop
from viatool.loop.horizon import Horizon
from viatool.loop.tube import TubeFollower
from viatool.policy import ActionChannel, Affine, Input, Network, PolicySpecification, write_onnx
from viatool.policy.specification import ObservationChannel
from viatool.setting.setting import Setting
from viatool.trajectory import Trajectory

EPS = 0.01
CARS = {"second_order_ackermann": 1.6, "ackermann": 0.8}
"""The motion in which a car is recorded: m/s, rad; beyond the limits of the plant."""


def policy_of(robot, folder, channel, weights, shift):
    """A policy that is linear in one measured velocity."""
    actions = [
        ActionChannel(name=f"my_{kind}", kind=kind, lower=RANGES[kind][0], upper=RANGES[kind][1])
        for kind in robot.actions
    ]
    spec = PolicySpecification(
        schema_version=2, observation=[channel], action=actions, control_interval=INTERVAL
    )
    gains = np.array(weights, np.float32).astype(float)[:, None]
    path = folder / "policy.onnx"
    write_onnx(Network((Input(1), Affine((0,), (gains,), np.array(shift)))), spec, path)
    return load_policy(path)


@pytest.mark.parametrize("name", CARS)
def test_a_car_turns_as_fast_as_its_motion_allows_and_not_as_its_limits_do(name, tmp_path):
    """Which command came before is not known; a car that drives beyond its limits may turn faster than these say."""
    robot, motion = ROBOTS[name], np.array([[CARS[name]]])
    turn = ObservationChannel(name="turn", kind="angular_velocity")
    policy = policy_of(robot, tmp_path, turn, (0.0, -0.3), (0.5, 1.25))
    setting = Setting.of(policy, robot.world(tmp_path), EPS)
    loop = ClosedLoop.of(setting.commanding(policy), setting, setting.scenarios[0])
    pose = np.array([[-1.0, -1.0, 0.3]])
    tube = TubeFollower(loop, 0.5, Horizon(1)).follow(pose, motion)
    before = [(0.0, steering) for steering in np.linspace(-0.6, 0.6, 41)]
    if name == "ackermann":
        before = [(speed, 0.0) for speed in np.linspace(plant.LOW, plant.HIGH, 41)]
    held = np.hstack([before, np.repeat(motion, 41, axis=0)])
    measured = plant.velocity(name, held, np.zeros((41, 1)))[1]
    assert np.ptp(measured) > 4.0
    raw = robot.clipped(policy.run(np.float32(measured)))
    after = plant.path(
        name, np.repeat(pose, 41, axis=0), np.hstack([raw, held[:, 2:]]), np.full(41, INTERVAL)
    )
    ends = after[:, -1]
    assert (ends >= tube.lower[:, 0] - 1e-5).all()
    assert (ends <= tube.upper[:, 0] + 1e-5).all()


def test_a_speed_that_was_measured_beyond_the_limits_where_a_clip_hides_it_is_not_known(tmp_path):
    """It may be any from there on, so nothing is proved; what the limits leave of it is nothing."""
    robot = ROBOTS["second_order_linear"]
    speed = ObservationChannel(name="speed", kind="linear_velocity", clip=[-2.0, 1.2])
    policy = policy_of(robot, tmp_path, speed, (0.0, 0.0), (-1.0, 0.0))
    places = np.array([1.1, 1.2, 1.3, 1.4])
    poses = np.column_stack([places, 0.0 * places, 0.0 * places])
    states = Trajectory(
        poses=poses,
        observations=np.array([[1.2], [1.2], [0.9], [1.2]]),
        actions=np.zeros((4, 2)),
        episode=np.zeros(4, np.int64),
        time=np.arange(4.0),
        outcomes=np.array(["unknown"]),
        costs=np.full(1, np.nan),
        scenarios=(None,),
    )
    found = verify(policy, robot.world(tmp_path), eps=0.05, trajectory=states)
    assert found.verdict.tolist() == ["unknown", "unknown", "safe", "unknown"]
    assert np.isnan(found.begun[[0, 1, 3]]).all()
    assert (found.begun[2, 0] <= found.begun[2, 1]).all()
