"""Localisation that errs: the robot is judged from every pose of a box, and sees its goal from another one."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

import viatool
from tests.safety.brute_force import clearance, drive
from tests.safety.hand_made_policy import specification, write_policy
from viatool.channels.drift import Drift
from viatool.errors import ConfigurationError
from viatool.safety.judged_states import JudgedStates
from viatool.safety.scene_poses import ScenePoses
from viatool.setting.explanation import explain
from viatool.setting.rules import Rules
from viatool.setting.setting import Setting
from viatool.setting.wishes import Wishes
from viatool.simulate import roll_out
from viatool.uncertainty import ErrorModel
from viatool.verification import verify
from viatool.verification.observing import BlockSensors
from viatool.verification.states import States
from viatool.verification.witness_file import load_witnesses, replay, witness_document
from viatool.world import Obstacles

LAB = viatool.load_map("maps/lab.yaml")
RADII = {"x": 0.05, "y": 0.03, "theta": 0.05}
SIZES = np.array([0.05, 0.03, 0.05])


def model_of(pose=RADII, **sensor):
    return ErrorModel.model_validate({"pose": pose, "sensor": {"lidar": sensor} if sensor else {}})


@pytest.fixture(scope="module")
def driven(tmp_path_factory):
    path = write_policy(tmp_path_factory.mktemp("policy") / "policy.onnx", specification(), caution=0.05)
    policy = viatool.load_policy(path)
    scenarios = LAB.generator.draw(12, 1)
    return policy, roll_out(policy, LAB, scenarios), scenarios


def verified(driven, model=None, **options):
    policy, trajectory, _ = driven
    return verify(
        policy, LAB, eps=0.01, errors=model, trajectory=trajectory, clearance=0.6, danger=0.8,
        only_contested=True, **{"refine": "none", **options},
    )  # fmt: skip


@pytest.fixture(scope="module")
def result(driven):
    return verified(driven, model_of())


def goal_seen(goals, poses):
    """Distance, cosine and sine of the bearing of goals (B, 2) from poses (B, 3)."""
    away = (goals - poses[:, :2]) @ [1.0, 1j]
    turned = away / np.abs(away) * np.exp(-1j * poses[:, 2])
    return np.stack([np.abs(away), turned.real, turned.imag], axis=1)


def escapes(result, driven, sizes=SIZES):
    """By how much commands of onnxruntime leave the bounds at most, the robot believing random poses."""
    policy, trajectory, scenarios = driven
    rows = np.flatnonzero(np.isfinite(result.lower[:, 0]))
    goals = np.array([scenario.goal for scenario in scenarios])[trajectory.episode[rows]]
    poses, generator, worst = result.poses[rows], np.random.default_rng(0), -np.inf
    seen_here = goal_seen(goals, poses)
    for _ in range(60):
        share = generator.uniform(-1, 1, (len(rows), 3))
        share = np.where(generator.random(share.shape) < 0.6, np.sign(share), share)
        seen = result.observations[rows] + 0.99999 * result.radii * generator.choice([-1, 1], (len(rows), 26))
        seen[:, 20:23] += goal_seen(goals, poses + share * sizes) - seen_here
        actions = policy.run(seen.astype(np.float32).astype(float))
        worst = max(
            worst, float(np.maximum(actions - result.upper[rows], result.lower[rows] - actions).max())
        )
    return worst


def test_no_believed_pose_leads_out_of_the_bounds(result, driven):
    assert escapes(result, driven) <= 0.0
    assert result.setting.drift(result.poses[:3], result.trajectory.scenarios, result.episode[:3]) is not None


def test_onnxruntime_catches_a_goal_that_does_not_err(monkeypatch, driven):
    monkeypatch.setattr(Setting, "drift", lambda *_: None)
    assert escapes(verified(driven, model_of()), driven) > 1e-3


def test_the_goal_errs_as_one_pose(driven):
    """Distance, cosine and sine of one believed pose are tighter than any of each in its range."""
    policy, trajectory = viatool.load_policy("via"), driven[1]
    setting = Setting.of(policy, LAB, 0.0, Wishes(errors=model_of()), job="verify")
    states = States.of(trajectory, np.zeros((len(trajectory), 0, 2)))
    states = states.select(np.arange(0, len(trajectory), 40))
    placed = ScenePoses.of(LAB, states.scenarios, states.poses, states.episode)
    sensors, every = BlockSensors(setting, states, placed), np.ones(len(states), dtype=bool)
    found = sensors.reach(setting.commanding(policy), {"refine": "none"}, every, every)
    lower, upper = sensors.bounds
    apart = viatool.reach(policy, 0.5 * (lower + upper), 0.5 * (upper - lower), refine="none")
    assert (found.width <= apart.width + 1e-6).all()
    assert found.width[:, 1].mean() < 0.999 * apart.width[:, 1].mean()


def nearest(result, driven, rows, sizes=SIZES):
    """The least clearance of states, driven by corners of their commands from corners of their boxes."""
    _, trajectory, scenarios = driven
    generator, least = np.random.default_rng(1), []
    for row in rows:
        own = scenarios[trajectory.episode[row]].obstacles
        world = replace(LAB, obstacles=Obstacles(np.concatenate([LAB.obstacles.circles, own.circles])))
        left = []
        for _ in range(12):
            pose = result.poses[row] + generator.choice([-1, 1], 3) * sizes
            v, omega = np.where(generator.random(2) < 0.5, result.commands[0][row], result.commands[1][row])
            path = drive(pose, v, omega, np.linspace(0, 0.1, 20))
            left.append(clearance(world, path, world.robot.footprint).min())
        least.append(min(left))
    return np.array(least)


def test_no_pose_of_a_box_comes_too_near_in_a_safe_state(result, driven):
    safe = np.flatnonzero(result.contested.either & result.judgement.safe)
    assert len(safe) > 3
    assert nearest(result, driven, safe[:60]).min() > 0.6


def test_driving_catches_states_that_are_judged_from_their_poses_alone(monkeypatch, driven):
    monkeypatch.setattr(BlockSensors, "placed", property(lambda self: self.exact))
    found = verified(driven, model_of())
    rows = np.flatnonzero(found.contested.collision & found.judgement.safe)
    assert nearest(found, driven, rows).min() < 0.6


def test_every_state_that_a_box_may_endanger_is_contested(driven):
    """No pose of the box of a settled state comes too near by any command of the robot."""
    found = verified(driven, model_of({"x": 0.3, "y": 0.3, "theta": 0.1}))
    plain = verified(driven)
    assert (found.contested.collision | ~plain.contested.collision).all()
    settled = np.flatnonzero(~found.contested.collision & ~plain.contested.collision)
    rows = settled[:: max(1, len(settled) // 80)]
    _, trajectory, scenarios = driven
    for row in rows:
        own = scenarios[trajectory.episode[row]].obstacles
        world = replace(LAB, obstacles=Obstacles(np.concatenate([LAB.obstacles.circles, own.circles])))
        for corner in np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T:
            path = drive(found.poses[row] + corner * [0.3, 0.3, 0.1], 0.5, 0.0, np.linspace(0, 0.1, 5))
            assert clearance(world, path, world.robot.footprint).min() > 0.6


def test_exact_poses_change_no_bit_and_errors_only_cost(driven, result):
    plain, zero = verified(driven), verified(driven, model_of({"x": 0.0, "y": 0.0, "theta": 0.0}))
    for name in ("lower", "upper", "verdict", "witness"):
        np.testing.assert_array_equal(getattr(plain, name), getattr(zero, name))
    assert not (result.judgement.safe & ~plain.judgement.safe).any()
    assert result.judgement.safe.sum() < plain.judgement.safe.sum()
    wider = verified(driven, model_of({name: 2 * size for name, size in RADII.items()}))
    assert not (wider.judgement.safe & ~result.judgement.safe).any()


def test_a_witness_says_where_the_robot_was_and_believed_to_be(driven, tmp_path):
    found = verified(driven, model_of(bias=0.02))
    lost = found.witnesses
    assert len(lost) > len(verified(driven).witnesses)
    assert (np.abs(lost.start - found.poses[lost.state]) <= SIZES).all()
    assert (np.abs(lost.believed - found.poses[lost.state]) <= SIZES).all()
    document = witness_document(found)
    assert any(entry["pose"] != entry["recorded_pose"] for entry in document["witnesses"])
    path = tmp_path / "witnesses.json"
    path.write_text(json.dumps(document), encoding="utf-8")
    again = replay(driven[0], LAB, load_witnesses(path))
    assert again.violates.all()
    errors, _, scenarios = found.setting.reading_errors, *driven[1:]
    for row, state in enumerate(lost.state):
        goal = np.array([scenarios[found.episode[state]].goal])
        drifted = np.zeros(26)
        drifted[20:23] = (
            goal_seen(goal, lost.believed[row, None]) - goal_seen(goal, found.poses[state, None])
        )[0]
        assert explain(errors, found.observations[state], lost.observation[row], drifted) is not None


def test_the_report_says_from_which_poses_states_are_judged(result):
    told = {premise.name: premise.value for premise in result.premises}
    assert told["pose.x"] == "0.05 m"
    assert "every pose within 0.05 m, 0.03 m and 0.05 rad" in result.assumptions()["motion"]
    table = result.state_table()
    assert ((table["observation_upper"] - table["observation_lower"])[:, 20] > 0.07).all()


def test_a_box_of_poses_is_followed_through_the_dead_time():
    generator, count = np.random.default_rng(0), 40
    rules = Rules.of(LAB, delay=0.25)
    poses = np.column_stack([generator.uniform(-1, 1, (count, 2)), generator.uniform(-3, 3, count)])
    placed = ScenePoses.of(LAB, [None], poses, np.zeros(count, dtype=np.int64))
    radii = np.broadcast_to([0.02, 0.05, 0.3], (count, 3))
    under_way = generator.uniform([0.0, -1.0], [0.5, 1.0], (count, 3, 2))
    acting = JudgedStates(rules, replace(placed, radii=radii), under_way).acting
    for row in range(count):
        for _ in range(30):
            pose = poses[row] + generator.choice([-1, 1], 3) * radii[row]
            for held, seconds in zip(under_way[row], rules.dead_time.durations, strict=True):
                pose = drive(pose, *held, np.array([0.0, seconds]))[-1].astype(float)
            assert (np.abs(pose - acting.poses[row]) <= acting.radii[row] + 1e-9).all()


def test_what_cannot_be_followed_is_refused_by_name(driven):
    policy, trajectory, _ = driven
    nowhere = replace(trajectory, scenarios=tuple(None for _ in trajectory.scenarios))
    with pytest.raises(ConfigurationError, match="an episode has no goal"):
        verified((policy, nowhere, None), model_of())
    with pytest.raises(ConfigurationError, match="states a pose error, and so does"):
        model_of().with_pose_error(0.1, 0.1)


def test_a_bearing_over_the_half_turn_may_be_on_both_sides(driven):
    told = specification().model_dump(mode="json", exclude_none=True)
    told["observation"][2] = {"name": "goal_bearing", "kind": "goal_bearing", "unit": "rad"}
    spec = specification().model_validate(told)
    setting = Setting.of_specification(spec, LAB, 0.01, Wishes(errors=model_of()), job="verify")
    poses, goal = np.array([[0.0, 0.0, np.pi - 0.01]]), np.array([2.0, 0.0])
    scenario = replace(driven[2][0], goal=goal)
    drift = setting.drift(poses, [scenario], np.zeros(1, np.int64))
    assert isinstance(drift, Drift)
    observation = np.zeros((1, 26))
    observation[0, 20:22] = 2.0, -np.pi + 0.01
    lower, upper = setting.observed(observation, drift)
    assert lower[0, 21] <= -np.pi
    assert upper[0, 21] >= np.pi
