"""Each robot whose motion has a state through the whole chain, against small steps of its velocity."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.motion import changing_plant as plant
from tests.motion.changing_square import COLLISION, EPS, INTERVAL, ROBOTS, left_over
from viatool import load_trajectory, verify
from viatool.errors import ConfigurationError, TrajectoryError
from viatool.loop.closed_loop import ClosedLoop
from viatool.places import Resolution, SearchBudget, certify
from viatool.places.findings import CERTIFIED, SETTLED
from viatool.places.lasting import Lookahead
from viatool.setting import begun
from viatool.setting.rules import Rules
from viatool.setting.setting import Setting
from viatool.simulate import NavigationSimulator, roll_out
from viatool.simulate.gym import NavigationEnvironment
from viatool.simulate.places import Places
from viatool.trajectory import write_trajectory
from viatool.verification.witness_file import load_witnesses, replay, witness_document

SLACK = 1e-3
"""Metres by which the small steps of the plant may err."""
each = pytest.mark.parametrize("robot", ROBOTS.values(), ids=ROBOTS)
measuring = pytest.mark.parametrize(
    "robot", [robot for robot in ROBOTS.values() if robot.measured], ids=lambda robot: robot.name
)


def errors(generator, shape):
    return 0.9999 * EPS * generator.choice([-1.0, 1.0], shape) * generator.choice([1.0, generator.random()])


def motion_of(trajectory, robot):
    return np.stack([trajectory.motion[name] for name in robot.motion], axis=1)


@each
def test_the_simulator_drives_it_where_its_velocity_leads(robot, tmp_path):
    setting = Setting.of(robot.policy(tmp_path), robot.world(tmp_path), EPS)
    world = setting.world_map
    simulator = NavigationSimulator(
        world, 200, scenarios=world.scenarios * 200, noise=0.0, channels=setting.spec.observation
    )
    simulator.reset()
    generator = np.random.default_rng(0)
    for _ in range(3):
        raw = generator.uniform(-5.0, 5.0, (200, 2))
        before, motion = simulator.poses.copy(), simulator.motion.copy()
        step = simulator.step(setting.command_map(robot.clipped(raw)))
        expected = plant.path(
            robot.name, before, np.hstack([robot.clipped(raw), motion]), np.full(200, INTERVAL), pieces=2000
        )[:, -1]
        np.testing.assert_allclose(simulator.poses[:, :2], expected[:, :2], atol=1e-5)
        assert np.abs(np.angle(np.exp(1j * (simulator.poses[:, 2] - expected[:, 2])))).max() < 1e-5
        for column, kind in enumerate(robot.measured, start=6):
            number = robot.motion.index("v" if kind == "linear_velocity" else "omega")
            np.testing.assert_allclose(step.observation[:, column], simulator.motion[:, number], atol=1e-6)


def strays(result, robot, brakes, times, lower=None, upper=None, seed=2):
    """By how much runs from states that are safe come nearer than the collision distance at most, and how many ran.

    The motion that they begin with is the recorded one, or anything between two ends.
    """
    generator, safe = np.random.default_rng(seed), result.verdict == "safe"
    poses, seen = result.poses[safe], result.observations[safe]
    policy = result.policy
    worst, ran = -np.inf, 0
    for _ in range(times):
        motion = motion_of(result.trajectory, robot)[safe] if lower is None else None
        if motion is None:
            share = np.round(generator.random(lower[safe].shape) * 2.0) / 2.0
            motion = lower[safe] + share * (upper[safe] - lower[safe])
        raw = policy.run(np.float32(seen + errors(generator, seen.shape)))
        way = robot.path(poses, raw, motion, brakes)
        worst, ran = max(worst, COLLISION - float(left_over(way).min())), ran + len(way)
    return worst, ran


class Known:
    """A result with its policy."""

    def __init__(self, result, policy):
        self.result, self.policy = result, policy

    def __getattr__(self, name):
        return getattr(self.result, name)


@each
@pytest.mark.parametrize("criterion", ["swept", "braking"])
def test_no_state_that_is_safe_comes_too_near(robot, criterion, tmp_path):
    world, policy = robot.world(tmp_path), robot.policy(tmp_path)
    found = verify(policy, world, eps=EPS, places=Places(count=500), criterion=criterion)
    assert {"safe", "unsafe"} <= set(found.verdict)
    assert (found.contested.collision & (found.verdict == "safe")).sum() > 5, "little was at stake"
    worst, ran = strays(Known(found, policy), robot, criterion == "braking", 60)
    assert worst < SLACK
    assert ran > 10_000
    motion = motion_of(found.trajectory, robot)
    for row in range(min(len(found.witnesses), 50)):
        state = found.witnesses.state[row]
        raw = policy.run(found.witness[state][None])
        way = robot.path(found.poses[state][None], raw, motion[state][None], criterion == "braking")
        assert left_over(way).min() < COLLISION + SLACK


@measuring
def test_what_is_measured_of_the_motion_may_be_off_by_eps(robot, tmp_path):
    """States that do not tell how fast the robot is: it is as fast as it measured, within the error."""
    world, policy = robot.world(tmp_path), robot.policy(tmp_path)
    given = verify(policy, world, eps=EPS, places=Places(count=400)).trajectory
    found = verify(policy, world, eps=EPS, trajectory=replace(given, motion={}))
    measured = found.observations[:, 6:]
    np.testing.assert_allclose(found.begun[:, 0], measured - EPS, atol=1e-6)
    np.testing.assert_allclose(found.begun[:, 1], measured + EPS, atol=1e-6)
    assert (found.begun[:, 0] <= measured - EPS).all()
    assert (found.begun[:, 1] >= measured + EPS).all()
    ends = found.begun[:, 0], found.begun[:, 1]
    assert strays(Known(found, policy), robot, False, 40, *ends)[0] < SLACK
    recorded = verify(policy, world, eps=EPS, trajectory=given)
    assert (recorded.verdict == "safe").sum() >= (found.verdict == "safe").sum()


def test_runs_catch_a_measured_motion_that_is_taken_as_exact(monkeypatch, tmp_path):
    robot = ROBOTS["second_order_linear"]
    world, policy = robot.world(tmp_path), robot.policy(tmp_path)
    given = verify(policy, world, eps=EPS, places=Places(count=1500)).trajectory
    right = begun._measured
    monkeypatch.setattr(
        begun, "_measured", lambda *given: right(*given).mean(axis=1, keepdims=True) + np.zeros((1, 2))
    )
    found = verify(policy, world, eps=EPS, trajectory=replace(given, motion={}))
    measured = found.observations[:, 6:]
    ends = measured - EPS, measured + EPS
    assert strays(Known(found, policy), robot, False, 40, *ends)[0] > 5 * SLACK


@each
def test_cells_that_are_certified_keep_their_clearance(robot, tmp_path):
    world, policy = robot.world(tmp_path), robot.policy(tmp_path)
    worst, ran, certified = certified_strays(robot, world, policy)
    assert certified > 30
    assert worst < SLACK
    assert ran > 5_000


def certified_strays(robot, world, policy, halvings=1, rounds=60):
    certificate = certify(
        policy, world, 0, eps=EPS, criterion="braking",
        resolution=Resolution(side=0.25, halvings=halvings), budget=SearchBudget(share=0.03), seed=1,
    )  # fmt: skip
    status = certificate.findings.status
    held = np.isin(status, (SETTLED, CERTIFIED))
    cells = certificate.lattice.cells(certificate.findings.nodes.select(held))
    assert cells.previous_lower.shape[1] == len(robot.motion)
    generator, worst, ran = np.random.default_rng(3), -np.inf, 0
    for _ in range(rounds):
        share = np.round(generator.random((len(cells), 3)) * 4.0) / 2.0 - 1.0
        poses = cells.poses.centre + 0.999 * share * cells.poses.radius
        share = np.round(2.0 * generator.random(cells.previous_lower.shape)) / 2.0
        motion = cells.previous_lower + share * (cells.previous_upper - cells.previous_lower)
        free = left_over(poses) > COLLISION
        poses, motion = poses[free], motion[free]
        seen = robot.observed(poses, motion)
        raw = policy.run(np.float32(seen + errors(generator, seen.shape)))
        way = robot.path(poses, raw, motion, brakes=True)
        worst, ran = max(worst, COLLISION - float(left_over(way).min())), ran + len(way)
    return worst, ran, int((status == CERTIFIED).sum())


def test_runs_catch_cells_whose_motion_is_that_of_their_middle(monkeypatch, tmp_path):
    robot = ROBOTS["second_order_linear"]
    world, policy = robot.world(tmp_path), robot.policy(tmp_path)
    right = ClosedLoop.given_in

    def middle(self, cells, lower, upper):
        mean = 0.5 * (cells.previous_lower + cells.previous_upper)
        return right(self, replace(cells, previous_lower=mean, previous_upper=mean), lower, upper)

    monkeypatch.setattr(ClosedLoop, "given_in", middle)
    assert certified_strays(robot, world, policy, halvings=0)[0] > 10 * SLACK


def test_runs_catch_proofs_that_forget_the_motion(monkeypatch, tmp_path):
    """As if a robot stood before each command."""
    robot = ROBOTS["second_order_linear"]
    world, policy = robot.world(tmp_path), robot.policy(tmp_path)
    right = Rules.begun
    monkeypatch.setattr(
        Rules, "begun", lambda self, lower, upper, ends: right(self, lower, upper, 0.0 * ends)
    )
    found = verify(policy, world, eps=EPS, places=Places(count=300), criterion="braking")
    assert strays(Known(found, policy), robot, True, 5)[0] > 10 * SLACK


@each
def test_it_is_driven_recorded_and_verified_again(robot, tmp_path):
    world, policy = robot.world(tmp_path, collision=0.02), robot.policy(tmp_path)
    driven = roll_out(policy, world, horizon=8)
    assert set(driven.motion) == set(robot.motion)
    assert np.ptp(motion_of(driven, robot)) > 0.0
    once = verify(policy, world, trajectory=driven, eps=EPS, criterion="braking")
    for name in ("drive.npz", "drive.csv"):
        write_trajectory(tmp_path / name, driven, policy.spec)
        again = load_trajectory(tmp_path / name, policy.spec)
        for number in robot.motion:
            np.testing.assert_array_equal(again.motion[number], driven.motion[number])
        found = verify(policy, world, trajectory=tmp_path / name, eps=EPS, criterion="braking")
        assert (found.verdict == once.verdict).all()


def test_a_motion_that_nobody_recorded_is_refused(tmp_path):
    robot = ROBOTS["ackermann"]
    world, policy = robot.world(tmp_path), robot.policy(tmp_path)
    driven = roll_out(policy, world, horizon=3)
    with pytest.raises(ConfigurationError, match="goes on from the steering that it has") as refused:
        verify(policy, world, trajectory=replace(driven, motion={}), eps=EPS)
    assert "motion_steering" in refused.value.hint
    with pytest.raises(TrajectoryError, match="wheels were recorded at 20 rad"):
        verify(
            policy, world, trajectory=replace(driven, motion={"steering": 0.0 * driven.time + 20.0}), eps=EPS
        )
    with pytest.raises(TrajectoryError, match="motion_steering"):
        replace(driven, motion={"steering": np.zeros(2)})


@each
def test_what_is_not_followed_is_refused_by_name(robot, tmp_path):
    world, policy = robot.world(tmp_path), robot.policy(tmp_path)
    with pytest.raises(ConfigurationError, match=r"delay of 0\.1 s is not followed"):
        verify(policy, world, eps=EPS, delay=0.1)
    with pytest.raises(ConfigurationError, match="how long cells stay certified is not followed"):
        certify(policy, world, 0, eps=EPS, lookahead=Lookahead(steps=2), budget=SearchBudget(cells=10))


def test_speeds_without_a_limit_are_judged_state_by_state_and_not_over_cells(tmp_path):
    robot = ROBOTS["second_order_linear"]
    text = (robot.world(tmp_path) and (tmp_path / "square.yaml").read_text()).replace(
        "min_linear: -0.4, max_linear: 1.0", "min_linear: -.inf, max_linear: .inf"
    )
    (tmp_path / "free.yaml").write_text(text)
    policy, world = robot.policy(tmp_path), tmp_path / "free.yaml"
    driven = roll_out(policy, robot.world(tmp_path, 0.02), horizon=5)
    found = verify(policy, world, eps=EPS, trajectory=driven)
    assert "v unlimited" in found.assumptions()["motion"]
    with pytest.raises(ConfigurationError, match="its v unlimited"):
        certify(policy, world, 0, eps=EPS, budget=SearchBudget(cells=10))
    with pytest.raises(ConfigurationError, match="nothing limits the v"):
        verify(policy, world, eps=EPS, places=Places(count=10))


@each
def test_counterexamples_are_replayed_from_the_motion_that_they_begin_with(robot, tmp_path):
    import json

    world, policy = robot.world(tmp_path), robot.policy(tmp_path)
    found = verify(policy, world, eps=EPS, places=Places(count=200), criterion="braking")
    (tmp_path / "witnesses.json").write_text(json.dumps(witness_document(found)))
    again = replay(policy, world, load_witnesses(tmp_path / "witnesses.json"))
    assert again.violates.all()
    np.testing.assert_allclose(again.clearance, found.witnesses.clearance, atol=1e-9)


@each
def test_it_is_driven_as_an_environment(robot, tmp_path):
    world = robot.world(tmp_path)
    environment = NavigationEnvironment(
        map=world, scenarios="fixed", noise=0.0, observation=robot.policy(tmp_path).spec
    )
    environment.reset(seed=0)
    action = environment.action_space.sample()
    before, motion = environment.simulator.poses.copy(), environment.simulator.motion.copy()
    environment.step(action)
    way = robot.path(before, action[None].astype(float), motion)
    np.testing.assert_allclose(environment.simulator.poses[0, :2], way[0, -1, :2], atol=1e-3)
