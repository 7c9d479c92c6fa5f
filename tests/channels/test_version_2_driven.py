"""A policy of version 2 through the whole chain, against school formulas: rays clockwise, bearing, place, scales."""

from __future__ import annotations

import numpy as np
import pytest

from tests.channels.square import COLLISION, FAR, HALF, readings, square
from viatool import certify, load_policy, roll_out, verify
from viatool.errors import PolicyError
from viatool.loop.closed_loop import ClosedLoop
from viatool.loop.horizon import Horizon
from viatool.loop.tube import TubeFollower
from viatool.places import Resolution, SearchBudget
from viatool.policy import Affine, Input, Network, PolicySpecification, write_onnx
from viatool.sets.forms import PoseBoxes
from viatool.sets.states import StateBoxes
from viatool.setting.setting import Setting
from viatool.setting.wishes import Wishes
from viatool.simulate import Places

BINS, VIEW, GOAL = 9, 4.0, np.array([1.5, 1.5])
EPS = {"scan": 0.02, "bearing": 0.01, "ahead": 0.03, "x": 0.01, "heading": 0.01, "turn": 0.005}
SPEC = PolicySpecification.model_validate(
    {
        "schema_version": 2,
        "observation": [
            {
                "name": "scan", "kind": "lidar", "scale": 1 / FAR, "offset": -0.5, "clip": [-0.5, 0.0],
                "lidar": {"start": VIEW / 2, "step": VIEW / (BINS - 1), "rays": BINS, "order": "clockwise",
                          "maximum_range": FAR},
            },
            {"name": "bearing", "kind": "goal_bearing", "scale": 1 / np.pi},
            {"name": "ahead", "kind": "goal_x", "scale": 0.5, "clip": [-1.0, 1.0]},
            {"name": "x", "kind": "pose_x", "scale": 0.25, "offset": 0.5},
            {"name": "heading", "kind": "heading", "scale": -1 / np.pi},
            {"name": "turn", "kind": "previous_angular", "scale": 2.0},
        ],
        "action": [
            {"name": "v", "unit": "m/s", "lower": 0.0, "upper": 0.5, "kind": "linear"},
            {"name": "w", "unit": "rad/s", "lower": -1.0, "upper": 1.0, "kind": "angular"},
        ],
    }
)  # fmt: skip
GAINS = np.zeros((2, SPEC.observation_size))
GAINS[0, :BINS] = 0.1
GAINS[0, BINS + 1] = 0.05
GAINS[1, :BINS] = np.linspace(0.6, -0.6, BINS)
GAINS[1, BINS:] = [1.1, 0.1, 0.2, 0.05, 0.1]
GAINS = np.float32(GAINS).astype(np.float64)
BIAS = np.float32([0.55, 0.0]).astype(np.float64)


@pytest.fixture(scope="module")
def policy(tmp_path_factory):
    path = tmp_path_factory.mktemp("version_2") / "policy.onnx"
    write_onnx(Network((Input(SPEC.observation_size), Affine((0,), (GAINS,), BIAS))), SPEC, path)
    return load_policy(path)


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    return square(tmp_path_factory.mktemp("square"))


def wrapped(angle):
    return np.arctan2(np.sin(angle), np.cos(angle))


def read(poses, turn):
    """What sensors read at poses (B, 3) after a turning speed (B,), (B, n) in their units."""
    away = GOAL - poses[:, :2]
    bearing = wrapped(np.arctan2(away[:, 1], away[:, 0]) - poses[:, 2])
    ahead = np.hypot(*away.T) * np.cos(bearing)
    scan = readings(poses, VIEW, BINS)[:, ::-1]
    return np.column_stack([scan, bearing, ahead, poses[:, 0], wrapped(poses[:, 2]), turn])


def command(sensed):
    """What the policy commands on readings (B, n), clipped by the robot, (B, 2)."""
    taken = np.column_stack(
        [
            np.clip(sensed[:, :BINS] / FAR - 0.5, -0.5, 0.0), sensed[:, BINS] / np.pi,
            np.clip(0.5 * sensed[:, BINS + 1], -1, 1), 0.25 * sensed[:, BINS + 2] + 0.5, -sensed[:, BINS + 3] / np.pi,
            2.0 * sensed[:, BINS + 4],
        ]
    )  # fmt: skip
    return np.clip(taken @ GAINS.T + BIAS, [0.0, -1.0], [0.5, 1.0])


def moved(poses, commands):
    v, w = commands.T
    heading = poses[:, 2] + 0.05 * w
    chord = 0.1 * v * np.sinc(0.05 * w / np.pi)
    return np.column_stack(
        [poses[:, 0] + chord * np.cos(heading), poses[:, 1] + chord * np.sin(heading), poses[:, 2] + 0.1 * w]
    )


def errors(generator, count):
    radii = SPEC.radii(EPS)
    return radii * np.where(
        generator.random((count, 1)) < 0.5,
        generator.choice([-1.0, 1.0], (count, len(radii))),
        generator.uniform(-1, 1, (count, len(radii))),
    )


def clearance(poses):
    return HALF - np.abs(poses[:, :2]).max(axis=1)


def test_a_drive_fills_the_observation_as_the_formulas_do(policy, world):
    driven = roll_out(policy, world, noise=0.0)
    assert len(driven) > 10
    before = np.concatenate([[0.0], np.clip(driven.actions[:-1, 1], -1, 1)])
    expected = read(driven.poses, before)
    least, most = SPEC.inputs.readings(driven.observations)
    near = expected[:, :BINS] < 0.5 * FAR - 1e-3
    np.testing.assert_allclose(least[:, :BINS][near], expected[:, :BINS][near], atol=1e-4)
    np.testing.assert_allclose(
        driven.observations[:, :BINS], np.clip(expected[:, :BINS] / FAR - 0.5, -0.5, 0), atol=1e-5
    )
    np.testing.assert_allclose(most[:, BINS], expected[:, BINS], atol=1e-5)
    np.testing.assert_allclose(most[:, BINS + 2 :], expected[:, BINS + 2 :], atol=1e-5)


@pytest.mark.parametrize("recorded", [False, True])
def test_bounds_and_verdicts_hold_for_every_error(policy, world, recorded):
    states = (
        {"trajectory": roll_out(policy, world, noise=0.0)} if recorded else {"places": Places(count=1500)}
    )
    result = verify(policy, world, eps=EPS, **states)
    table = result.state_table()
    poses, verdict = table["pose"], table["verdict"].astype(str)
    lower, upper = np.clip(table["lower"], [0, -1], [0.5, 1]), np.clip(table["upper"], [0, -1], [0.5, 1])
    turn = SPEC.inputs.readings(table["observation"])[0][:, -1]
    generator = np.random.default_rng(0)
    for _ in range(20):
        found = command(read(poses, turn) + errors(generator, len(poses)))
        assert (lower - 1e-6 <= found).all()
        assert (found <= upper + 1e-6).all()
        assert clearance(moved(poses, found))[verdict == "safe"].min() > COLLISION - 1e-5
    assert (upper - lower).max() < 0.2


def test_certified_cells_are_safe_also_with_the_goal_behind(policy, world):
    certificate = certify(
        policy, world, world.scenarios[0], eps=EPS, criterion="swept", resolution=Resolution(0.05, 0),
        budget=SearchBudget(share=0.1), seed=1,
    )  # fmt: skip
    table = certificate.cell_table()
    proved = table["status"] == "certified"
    assert proved.sum() > 100
    generator, least, behind = np.random.default_rng(0), np.inf, 0
    for _ in range(20):
        cells = generator.uniform(table["lower"][proved], table["upper"][proved])
        cells = cells[clearance(cells) > COLLISION]
        sensed = read(cells[:, :3], cells[:, 4])
        behind += int((np.abs(sensed[:, BINS]) > 3.1).sum())
        found = command(sensed + errors(generator, len(cells)))
        least = min(least, clearance(moved(cells[:, :3], found)).min())
    assert least > COLLISION - 1e-5
    assert behind > 20


def test_runs_stay_in_their_tubes_also_over_the_half_turn(policy, world):
    scenario = world.scenarios[0]
    loop = ClosedLoop.of(policy, Setting.of(policy, world, EPS), scenario)
    follower = TubeFollower(loop, 0.3, Horizon(steps=6, position_error=0.01, heading_error=0.02))
    generator = np.random.default_rng(4)
    poses = generator.uniform((-1.2, -1.2, -3.2), (1.0, 1.0, 3.2), (30, 3))
    away = np.arctan2(*(GOAL - poses[:, :2]).T[::-1])
    poses[:15, 2] = away[:15] + np.pi + generator.normal(0, 0.02, 15)
    previous = np.column_stack([np.full(30, 0.2), generator.uniform(-1, 1, 30)])
    tubes = follower.follow(poses, previous)
    over = 0
    for _ in range(200):
        now = poses + generator.choice([-1.0, 1.0], poses.shape) * [0.01, 0.01, 0.02]
        turn, driving = previous[:, 1], np.hypot(*(now[:, :2] - GOAL).T) >= 0.3
        for k in range(6):
            sensed = read(now, turn)
            over += int((np.abs(sensed[:, BINS]) > 3.13).sum())
            found = command(sensed + errors(generator, len(now)))
            turn, now = found[:, 1], moved(now, found)
            inside = (tubes.lower[:, k] - 1e-6 <= now) & (now <= tubes.upper[:, k] + 1e-6)
            assert inside[driving].all()
            driving &= np.hypot(*(now[:, :2] - GOAL).T) >= 0.3
    assert over > 100


def test_commands_of_cells_hold_on_both_sides_of_the_half_turn(policy, world):
    loop = ClosedLoop.of(policy, Setting.of(policy, world, EPS), world.scenarios[0])
    generator = np.random.default_rng(5)
    centre = generator.uniform((-1.2, -1.2, -3.2), (1.0, 1.0, 3.2), (60, 3))
    centre[:, 2] = np.arctan2(*(GOAL - centre[:, :2]).T[::-1]) + np.pi + generator.normal(0, 0.005, 60)
    radius, before = np.full((60, 3), 0.01), np.zeros((60, 2))
    bounds = loop.commands(StateBoxes(PoseBoxes(centre, radius), before, before))
    sides = set()
    for _ in range(100):
        sensed = read(centre + generator.uniform(-1, 1, centre.shape) * radius, before[:, 1])
        sides |= set(np.sign(sensed[:, BINS]))
        found = command(sensed + errors(generator, 60))
        assert (bounds.lower - 1e-6 <= found).all()
        assert (found <= bounds.upper + 1e-6).all()
    assert sides == {-1.0, 1.0}


def test_a_measured_velocity_is_refused_over_poses_where_commands_act_late(tmp_path, world):
    """With a dead time the robot does not have the velocity of the command before."""
    spec = PolicySpecification.model_validate(
        {
            "schema_version": 2,
            "observation": [{"name": "speed", "kind": "linear_velocity"}],
            "action": SPEC.action,
        }
    )
    write_onnx(
        Network((Input(1), Affine((0,), (np.ones((2, 1)),), np.zeros(2)))), spec, tmp_path / "policy.onnx"
    )
    policy = load_policy(tmp_path / "policy.onnx")
    ClosedLoop.of(policy, Setting.of(policy, world, 0.01), world.scenarios[0])
    late = Setting.of(policy, world, 0.01, Wishes(delay=0.05))
    with pytest.raises(
        PolicyError, match=r"'speed' of kind 'linear_velocity' is not known .* act 0.05 s late"
    ):
        ClosedLoop.of(policy, late, world.scenarios[0])
