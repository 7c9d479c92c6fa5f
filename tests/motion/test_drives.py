"""Each kind of robot through the whole chain, against small steps of its velocity."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.motion.drives import DRIVES, left_over, read
from viatool import load_map, verify
from viatool.places import Lookahead, Resolution, SearchBudget, certify
from viatool.places.findings import CERTIFIED, SETTLED
from viatool.places.tree import Lattice
from viatool.policy import Affine, Input, Network, load_policy, write_onnx
from viatool.report.states.run import StatesRun
from viatool.setting.setting import Setting
from viatool.simulate import NavigationSimulator, roll_out
from viatool.simulate.gym import NavigationEnvironment
from viatool.simulate.gym.options import task_specification
from viatool.simulate.places import Places
from viatool.taylor import reach
from viatool.world import ROBOTS, Footprint

EPS = 0.05
each = pytest.mark.parametrize("drive", DRIVES.values(), ids=DRIVES)


@each
def test_the_simulator_drives_it_where_its_velocity_leads(drive, tmp_path):
    world, policy = drive.world(tmp_path), drive.policy(tmp_path)
    setting = Setting.of(policy, world, EPS)
    simulator = NavigationSimulator(setting.world_map, 200, scenarios=world.scenarios * 200, noise=0.0)
    simulator.reset()
    generator = np.random.default_rng(0)
    for _ in range(3):
        raw = generator.uniform(-1.5, 1.5, (200, len(drive.actions)))
        before = simulator.poses.copy()
        simulator.step(setting.command_map(np.clip(raw, *_ends(drive))))
        expected = drive.path(before, raw)[:, -1]
        np.testing.assert_allclose(simulator.poses[:, :2], expected[:, :2], atol=2e-4)
        assert np.abs(np.angle(np.exp(1j * (simulator.poses[:, 2] - expected[:, 2])))).max() < 1e-9


@each
def test_what_reaches_the_robot_is_within_the_bounds_of_the_command(drive, tmp_path):
    """Bounds over boxes of observations hold what the program gives, put together as a run does it."""
    world, policy = drive.world(tmp_path), drive.policy(tmp_path)
    setting, generator = Setting.of(policy, world, EPS), np.random.default_rng(1)
    seen = np.float32(generator.uniform(0.1, 4.0, (60, policy.input_size))).astype(float)
    for eps in (0.01, 0.3):
        sets = reach(setting.commanding(policy), seen, eps)
        assert sets.lower.shape == (60, len(setting.rules.kinematics.axes))
        for _ in range(40):
            near = seen + 0.999 * eps * generator.choice([-1.0, -0.3, 0.5, 1.0], seen.shape)
            commands = setting.command_map(policy.run(near))
            assert ((commands >= sets.lower) & (commands <= sets.upper)).all()
        ahead, left, turn = drive.velocity(drive.clipped(policy.run(near)))
        parts = setting.rules.kinematics.parts(setting.rules.clip(commands))
        np.testing.assert_allclose(np.stack(parts), np.stack([ahead, left, turn]), atol=1e-9)


@each
def test_no_state_that_is_safe_comes_too_near(drive, tmp_path):
    world, policy = drive.world(tmp_path), drive.policy(tmp_path)
    result = verify(policy, world, eps=EPS, places=Places(count=600), criterion="swept")
    assert {"safe", "unsafe"} <= set(result.verdict)
    assert (result.contested.collision & (result.verdict == "safe")).any(), "nothing was at stake"
    generator = np.random.default_rng(2)
    safe = result.verdict == "safe"
    poses, seen = result.poses[safe], read(result.poses[safe])
    for _ in range(60):
        error = generator.choice([-1.0, 1.0], seen.shape) * generator.choice([1.0, generator.random()])
        raw = policy.run(np.float32(seen + 0.9999 * EPS * error))
        assert left_over(drive.path(poses, raw)).min() > world.clearance.collision
    for row in result.witnesses.state[:50]:
        raw = policy.run(result.witness[row][None])
        assert left_over(drive.path(result.poses[row][None], raw)).min() < world.clearance.collision + 1e-4


@each
def test_cells_that_are_certified_keep_their_clearance(drive, tmp_path):
    world, policy = drive.world(tmp_path), drive.policy(tmp_path)
    certificate = certify(
        policy, world, 0, eps=EPS, criterion="swept",
        resolution=Resolution(side=0.25, halvings=0), budget=SearchBudget(cells=20_000),
    )  # fmt: skip
    status = certificate.findings.status
    held = np.isin(status, (SETTLED, CERTIFIED))
    assert (status == CERTIFIED).sum() > 100
    lower, upper = certificate.lattice.bounds(certificate.findings.nodes.select(held))
    generator = np.random.default_rng(3)
    for _ in range(8):
        poses = (lower + generator.random(lower.shape) * (upper - lower))[:, :3]
        poses = poses[left_over(poses) > world.clearance.collision]
        seen = read(poses)
        raw = policy.run(np.float32(seen + 0.9999 * EPS * generator.choice([-1.0, 1.0], seen.shape)))
        assert left_over(drive.path(poses, raw)).min() > world.clearance.collision


@each
def test_it_is_driven_and_what_was_recorded_is_verified(drive, tmp_path):
    world, policy = drive.world(tmp_path, collision=0.05), drive.policy(tmp_path)
    driven = roll_out(policy, world, horizon=10)
    assert np.hypot(*np.diff(driven.poses[:2, :2], axis=0).T) > 0.01
    result = verify(policy, world, trajectory=driven, eps=EPS)
    assert len(result.verdict) == len(driven)


def _ends(drive):
    return [low for _, low, _ in drive.actions], [high for *_, high in drive.actions]


@each
def test_it_is_driven_as_an_environment(drive, tmp_path):
    """Of wheels and cars the actions are the policy's own; of the others they are the command."""
    world = drive.world(tmp_path)
    environment = NavigationEnvironment(
        map=world, scenarios="fixed", noise=0.0, observation=drive.policy(tmp_path).spec
    )
    environment.reset(seed=0)
    size = environment.action_space.shape[0]
    assert size == len(drive.actions)
    before = environment.simulator.poses.copy()
    action = np.clip(environment.action_space.sample(), -0.3, 0.3)
    environment.step(action)
    raw = action[None].astype(float)
    if [kind for kind, *_ in drive.actions] == ["lateral", "linear", "angular"]:
        raw = raw[:, [2, 0, 1]]
    np.testing.assert_allclose(
        environment.simulator.poses[0, :2], drive.path(before, raw)[0, -1, :2], atol=2e-4
    )


@each
def test_its_page_shows_every_part_of_the_command(drive, tmp_path):
    world, policy = drive.world(tmp_path), drive.policy(tmp_path)
    result = verify(policy, world, eps=EPS, places=Places(count=20), criterion="swept")
    text = StatesRun(result).page([])
    for action in result.actions:
        assert action.name in text


@pytest.mark.parametrize("name", ROBOTS)
def test_known_robots_are_driven_by_a_policy_of_their_kind(name):
    world = load_map("maps/lab.yaml").with_robot(replace(ROBOTS[name], footprint=Footprint()))
    spec = task_specification(world.robot)
    setting = Setting.of_specification(spec, world, 0.01)
    assert setting.rules.kinematics.name == ROBOTS[name].kinematics
    simulator = NavigationSimulator(setting.world_map, 1, scenarios=world.scenarios[:1], noise=0.0)
    simulator.reset()
    simulator.step(setting.command_map(np.array([[0.1] * len(spec.action)])))
    assert simulator.poses[0, 0] != world.scenarios[0].start[0]


def test_cells_are_certified_whatever_was_commanded_to_the_side_before(tmp_path):
    """With a dead time the command before goes on: along the axis that no cell is cut along it may be any."""
    drive = DRIVES["holonomic"]
    world, policy = drive.world(tmp_path), drive.policy(tmp_path)
    certificate = certify(
        policy, world, 0, eps=EPS, criterion="swept", delay=0.2,
        resolution=Resolution(side=0.4, halvings=0), budget=SearchBudget(cells=4_000),
    )  # fmt: skip
    held = np.isin(certificate.findings.status, (SETTLED, CERTIFIED))
    assert held.sum() > 100
    nodes = certificate.findings.nodes.select(held)
    cells = certificate.lattice.cells(nodes)
    assert (cells.previous_lower[:, 2] == -0.6).all()
    assert (cells.previous_upper[:, 2] == 0.6).all()
    lower, upper = certificate.lattice.bounds(nodes)
    generator = np.random.default_rng(7)
    for _ in range(8):
        states = lower + generator.random(lower.shape) * (upper - lower)
        aside = generator.choice([-0.6, 0.6], len(states))
        states, aside = (part[left_over(states) > world.clearance.collision] for part in (states, aside))
        before = np.column_stack([aside, states[:, 3], states[:, 4]])
        waiting = drive.path(states[:, :3], before, 0.2)
        raw = policy.run(np.float32(read(states[:, :3])))
        assert left_over(waiting).min() > world.clearance.collision
        assert left_over(drive.path(waiting[:, -1], raw)).min() > world.clearance.collision


def fails_too_early(drive, policy, folder, aside=None, cells=3000):
    """How many runs from cells fail within the intervals that are claimed of them, and what is claimed.

    Parameters
    ----------
    aside : int, optional
        Which entry of what the program gives it observes in the next interval, behind the scan.
    """
    world = drive.world(folder)
    found = certify(
        policy, world, 0, eps=EPS, criterion="swept", resolution=Resolution(side=0.25, halvings=0),
        lookahead=Lookahead(steps=4, for_ever=True, intervals=2),
    ).lasting  # fmt: skip
    claimed = np.minimum(found.intervals, 4)
    rows = np.flatnonzero(found.free & (claimed > 0))
    generator, failed = np.random.default_rng(9), 0
    rows = generator.choice(rows, min(cells, len(rows)), replace=False)
    lower, upper = found.mesh.bounds(rows)
    for _ in range(5):
        poses = (lower + generator.choice([0.0, 0.5, 1.0], lower.shape) * (upper - lower))[:, :3]
        before = generator.uniform(*_ends(drive), (len(poses), len(drive.actions)))
        driving = left_over(poses) > world.clearance.collision
        for k in range(4):
            seen = read(poses) if aside is None else np.column_stack([read(poses), before[:, aside]])
            error = generator.choice([-1.0, 1.0], seen.shape)
            raw = policy.run(np.float32(seen + 0.9999 * EPS * error))
            before, way = drive.clipped(raw), drive.path(poses, raw)
            clear = (left_over(way) > world.clearance.collision - 1e-9).all(axis=1)
            failed += int((~clear & driving & (claimed[rows] > k)).sum())
            poses = way[:, -1]
            driving &= np.hypot(*(poses[:, :2] - 1.5).T) >= found.lookahead.goal_radius
    return failed, claimed[rows]


def test_cells_last_as_long_as_runs_of_a_robot_that_slides_keep_their_clearance(tmp_path):
    drive = DRIVES["holonomic"]
    failed, claimed = fails_too_early(drive, drive.policy(tmp_path), tmp_path)
    assert failed == 0
    assert (claimed == 4).sum() > 100
    assert (claimed < 4).sum() > 100


def keeps_sliding(drive, folder):
    """A policy that goes on to the side as before, whatever it sees."""
    spec = drive.policy(folder).spec
    before = {"name": "before", "kind": "previous_lateral"}
    told = spec.model_dump(mode="json", exclude_none=True)
    told["observation"].append(before)
    weight = np.zeros((3, 7))
    weight[0, 6] = 0.9375
    path = folder / "sliding.onnx"
    write_onnx(
        Network((Input(7), Affine((0,), (weight,), np.zeros(3)))), type(spec).model_validate(told), path
    )
    return load_policy(path)


def test_cells_take_every_command_to_the_side_that_may_have_been_before(tmp_path, monkeypatch):
    """And the mutant in which the robot did not slide before does not."""
    drive = DRIVES["holonomic"]
    policy = keeps_sliding(drive, tmp_path)
    failed, claimed = fails_too_early(drive, policy, tmp_path, aside=0, cells=1000)
    assert failed == 0
    assert (claimed == 4).sum() > 100
    over = Lattice.over.__func__

    def not_sliding(cls, *given):
        lattice = over(cls, *given)
        return replace(lattice, beyond=0.0 * lattice.beyond)

    monkeypatch.setattr(Lattice, "over", classmethod(not_sliding))
    assert fails_too_early(drive, policy, tmp_path, aside=0, cells=1000)[0] > 0
