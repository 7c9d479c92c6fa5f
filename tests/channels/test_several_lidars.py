"""Two LiDARs, each with its own rays, bins and view, against ranges that are computed here."""

from __future__ import annotations

import numpy as np
import pytest

from tests.channels.square import COLLISION, HALF, lidar, linear_policy, readings, square
from viatool import roll_out, verify
from viatool.errors import PolicyError
from viatool.places import Resolution, SearchBudget, certify
from viatool.policy import ObservationChannel
from viatool.simulate import Conditions, Places, make_simulator
from viatool.trajectory import BagSettings
from viatool.trajectory.recording import load_bag

FRONT, ROUND = (1.2, 4, 8), (6.0, 6, 6)  # view, bins, rays
CHANNELS = [
    lidar("front", *FRONT),
    ObservationChannel(name="before", kind="previous_linear"),
    lidar("all_round", *ROUND),
]
EPS = 0.001


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    return square(tmp_path_factory.mktemp("square"))


@pytest.fixture(scope="module")
def policy(tmp_path_factory):
    """Fast where it sees farther to its sides than ahead: it stands still if both channels read the same."""
    rows = {
        ("front", 1): (-0.5, 0.0),
        ("all_round", 3): (0.2, 0.1),
        ("all_round", 2): (0.5, 0.0),
        ("before", 0): (0.1, 0.0),
    }
    return linear_policy(tmp_path_factory.mktemp("policy") / "two.onnx", CHANNELS, rows, bias=(0.25, 0.0))


def command(poses, before):
    front, around = readings(poses, *FRONT), readings(poses, *ROUND)
    v = -0.5 * front[:, 1] + 0.2 * around[:, 3] + 0.5 * around[:, 2] + 0.1 * before + 0.25
    return np.stack([np.clip(v, 0.0, 0.5), np.clip(0.1 * around[:, 3], -1.0, 1.0)], axis=1)


def moved(poses, commands):
    """Where arcs of 0.1 s lead, by many short pieces."""
    poses = poses.copy()
    for _ in range(50):
        heading = poses[:, 2] + 0.001 * commands[:, 1]
        poses[:, :2] += 0.002 * commands[:, :1] * np.stack([np.cos(heading), np.sin(heading)], axis=1)
        poses[:, 2] += 0.002 * commands[:, 1]
    return poses


def clearance(poses):
    return HALF - np.abs(poses[:, :2]).max(axis=1)


def test_each_lidar_reads_its_own_rays_in_a_simulation(policy, world):
    driven = roll_out(policy, world, noise=0.0)
    assert len(driven) > 5
    np.testing.assert_allclose(driven.observations[:, :4], readings(driven.poses, *FRONT), atol=1e-4)
    np.testing.assert_allclose(driven.observations[:, 5:], readings(driven.poses, *ROUND), atol=1e-4)


def test_each_lidar_has_noise_of_its_own(policy, world):
    driven = roll_out(policy, world, noise=0.05, seed=3)
    errors = driven.observations[:, 5:] - readings(driven.poses, *ROUND)
    assert 0.02 < errors.std() < 0.08
    ahead = driven.observations[:, :4] - readings(driven.poses, *FRONT)
    assert abs(np.corrcoef(errors[:, 2], ahead[:, 1])[0, 1]) < 0.5


def test_each_lidar_reads_its_own_rays_in_the_physics_engine(world):
    pytest.importorskip("pybullet")
    simulator = make_simulator("bullet", world, 1, scenarios=world.scenarios, channels=CHANNELS, noise=0.0)
    try:
        seen = simulator.reset()
        poses = simulator.poses
    finally:
        simulator.close()
    np.testing.assert_allclose(seen[:, :4], readings(poses, *FRONT), atol=0.02)
    np.testing.assert_allclose(seen[:, 5:], readings(poses, *ROUND), atol=0.02)


@pytest.mark.parametrize("seconds", [0.1, 0.35])
def test_a_slow_scan_is_held_for_each_lidar(world, seconds):
    conditions = Conditions(lidar_rate=1.0 / seconds)
    simulator = make_simulator(
        "kinematic", world, 2, scenarios=world.scenarios, channels=CHANNELS, noise=0.0, conditions=conditions
    )
    seen, poses = [simulator.reset()], [simulator.poses]
    for _ in range(7):
        seen.append(simulator.step(np.tile([0.5, 0.3], (2, 1))).observation)
        poses.append(simulator.poses)
    for k, row in enumerate(seen):
        scanned = int(
            np.ceil(np.floor(0.1 * k / seconds + 1e-9) * seconds / 0.1 - 1e-9)
        )  # the step of the last scan
        np.testing.assert_allclose(row[:, :4], readings(poses[scanned], *FRONT), atol=1e-4)
        np.testing.assert_allclose(row[:, 5:], readings(poses[scanned], *ROUND), atol=1e-4)


@pytest.mark.parametrize("recorded", [False, True])
def test_verdicts_rest_on_both(policy, world, recorded):
    states = (
        {"trajectory": roll_out(policy, world, noise=0.0)} if recorded else {"places": Places(count=1500)}
    )
    result = verify(policy, world, eps=EPS, **states)
    table = result.state_table()
    poses, verdict = table["pose"], table["verdict"].astype(str)
    np.testing.assert_allclose(table["observation"][:, 5:], readings(poses, *ROUND), atol=1e-3)
    after = moved(poses, command(poses, table["observation"][:, 4]))
    assert clearance(after)[verdict == "safe"].min() > COLLISION - 1e-4
    if not recorded:
        assert (verdict == "unsafe").sum() > 5
        assert (verdict == "safe").sum() > 1000


def test_certified_cells_are_safe_by_both(policy, world):
    certificate = certify(
        policy, world, world.scenarios[0], eps=EPS, criterion="swept", resolution=Resolution(0.05, 0),
        budget=SearchBudget(share=0.1), seed=1,
    )  # fmt: skip
    table = certificate.cell_table()
    proved = table["status"] == "certified"
    assert proved.sum() > 100
    generator = np.random.default_rng(0)
    least = np.inf
    for _ in range(20):
        states = generator.uniform(table["lower"][proved], table["upper"][proved])
        poses = states[:, :3][clearance(states[:, :3]) > COLLISION]
        before = states[:, 3][clearance(states[:, :3]) > COLLISION]
        least = min(least, clearance(moved(poses, command(poses, before))).min())
    assert least > COLLISION - 1e-4


def test_runs_stay_in_their_tubes(policy, world):
    driven = roll_out(policy, world, noise=0.0)
    result = verify(policy, world, eps=EPS, trajectory=driven, horizon=4)
    table = result.state_table()
    lower, upper = table["tube_lower"], table["tube_upper"]
    poses, before = driven.poses, driven.observations[:, 4]
    for k in range(4):
        commands = command(poses, before)
        poses, before = moved(poses, commands), commands[:, 0]
        going = np.isfinite(lower[:, k, 0])
        assert going.any()
        assert (lower[going, k] <= poses[going] + 1e-4).all()
        assert (poses[going] <= upper[going, k] + 1e-4).all()


def test_a_bag_is_refused_by_the_names_of_both(policy, tmp_path):
    with pytest.raises(PolicyError, match="'front', 'all_round'"):
        load_bag(tmp_path / "run.bag", policy.spec, BagSettings())
