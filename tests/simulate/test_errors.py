"""Errors within a model: what is drawn lies within it, and an adversary finds what chance does not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import viatool
from tests.sight.ray_oracle import outlines, scan
from viatool.channels import Quantities
from viatool.cli import main
from viatool.motion.kinematics import DIFFERENTIAL, KINEMATICS
from viatool.setting.setting import Setting
from viatool.setting.wishes import Wishes
from viatool.simulate import NavigationSimulator
from viatool.simulate.motor_flaws import MotorFlaws
from viatool.simulate.roll_out import drive
from viatool.simulate.sensor_flaws import SensorFlaws
from viatool.uncertainty import ErrorModel
from viatool.world import Obstacles

LIDAR = {"absolute": 0.05, "relative": 0.02, "bias": 0.03, "missing": 2}
MOTORS = {
    "actuation": {
        "linear": {"acceleration": 1.0, "deceleration": 0.8, "lag": [0.05, 0.15], "relative": 0.1},
        "angular": {"acceleration": 3.0, "absolute": 0.05},
        "slip": 0.05,
    },
    "timing": {"interval": [0.08, 0.12], "delay": [0.02, 0.15], "sensing": 0.05},
}


@pytest.fixture(scope="module")
def policy():
    return viatool.load_policy("via")


@pytest.fixture(scope="module")
def lab():
    return viatool.load_map("lab")


@pytest.mark.parametrize("corners", [False, True])
def test_readings_err_within_the_model_and_fill_it(lab, policy, corners):
    quantities = Quantities.of(policy.spec.observation, lab.robot)
    model = ErrorModel.model_validate({"sensor": {"lidar": LIDAR, "goal_distance": {"absolute": 0.2}}})
    flaws, rng = SensorFlaws(model, quantities, corners), np.random.default_rng(0)
    fan = quantities.lidars[0][0].fan
    true = np.random.default_rng(1).uniform(0.5, 6.5, (400, len(fan)))
    true[:, ::9] = 7.0
    read = flaws.rays(true, fan, rng)
    lost = (read == 7.0) & (true < 7.0)
    assert lost.sum(axis=1).max() == 2
    error, most = np.abs(read - true)[~lost], (0.05 + 0.02 * true + 0.03)[~lost]
    assert (error <= most + 1e-12).all()
    assert (error / most).max() > 0.95
    assert (read[true == 7.0] == 7.0).all()
    readings = np.zeros((400, quantities.columns[-1].stop))
    moved = np.abs(flaws.readings(readings, rng)).max(axis=0)
    place = [one.channel.name for one in quantities.each].index("goal_distance")
    assert 0.19 < moved[quantities.columns[place]] <= 0.2
    assert moved.sum() == moved[quantities.columns[place]]


def test_poses_err_within_the_model(lab, policy):
    quantities = Quantities.of(policy.spec.observation, lab.robot)
    model = ErrorModel.model_validate({"pose": {"x": 0.1, "theta": 0.02}, "start": {"y": 0.3}})
    flaws, rng = SensorFlaws(model, quantities, corners=False), np.random.default_rng(0)
    believed = np.abs(flaws.believed(np.zeros((500, 3)), rng)).max(axis=0)
    started = np.abs(flaws.started(np.zeros((500, 3)), rng)).max(axis=0)
    assert believed == pytest.approx([0.1, 0.0, 0.02], rel=0.02)
    assert started == pytest.approx([0.0, 0.3, 0.0], rel=0.02)


@pytest.mark.parametrize("kinematics", [name for name, law in KINEMATICS.items() if not law.state])
def test_motors_follow_the_equations_of_the_model(kinematics):
    """Against small steps of Euler's method, written out."""
    law, model, rng = KINEMATICS[kinematics], ErrorModel.model_validate(MOTORS), np.random.default_rng(3)
    motors = MotorFlaws(law, model, 0.1, 0.0)
    state = motors.at_rest(np.zeros((20, 3)))
    euler, velocity, queue, clock = np.zeros((20, 3)), np.zeros((20, 3)), [], np.zeros(20)
    for _ in range(12):
        command = rng.uniform(-1.0, 1.0, (20, len(law.axes)))
        choice = motors.choose(20, rng, corners=False)
        began = state.age.copy()
        given = motors.give(state, command, choice)
        queue.append((command, clock + given.acts[:, 0]))
        state = motors.follow(given, choice)
        until = choice.interval + began - state.age
        steps = 400
        for number in range(steps):
            at = (number + 0.5) / steps
            acting = np.zeros((20, len(law.axes)))
            for earlier, acts in queue:
                acting = np.where((acts <= clock + at * until)[:, None], earlier, acting)
            wanted = np.stack(law.parts(acting), axis=1)
            error = np.array([0.1, 0.0, 0.0]) * np.abs(wanted) + np.array([0.0, 0.0, 0.05])
            target = wanted + choice.errors[np.arange(20), min(int(5 * at), 4)] * error
            pace = np.where(velocity * (target - velocity) >= 0.0, choice.rate[:, 0], choice.rate[:, 1])
            dt = (until / steps)[:, None]
            rise = np.minimum(np.abs(target - velocity) / np.maximum(choice.lag, dt), pace)
            velocity = velocity + np.sign(target - velocity) * rise * dt
            slip = 0.05 * choice.slip[np.arange(20), min(int(5 * at), 4)] * np.hypot(*velocity[:, :2].T)
            moved = (velocity[:, 0] + 1j * (velocity[:, 1] + slip)) * np.exp(1j * euler[:, 2]) * dt[:, 0]
            euler = euler + np.stack([moved.real, moved.imag, velocity[:, 2] * dt[:, 0]], axis=1)
        clock = clock + until
        assert np.abs(state.poses[:, :2] - euler[:, :2]).max() < 2e-3
        assert np.abs(np.sin(state.poses[:, 2] - euler[:, 2])).max() < 2e-3


def test_choices_lie_within_the_model():
    motors = MotorFlaws(DIFFERENTIAL, ErrorModel.model_validate(MOTORS), 0.1, 0.0)
    rng = np.random.default_rng(0)
    for corners in (False, True):
        drawn = motors.choose(2000, rng, corners=corners)
        for name, (low, high) in {
            "interval": (0.08, 0.12), "delay": (0.02, 0.15), "age": (0.0, 0.05), "errors": (-1.0, 1.0)
        }.items():  # fmt: skip
            values = getattr(drawn, name)
            assert low <= values.min() < low + 0.02
            assert high - 0.02 < values.max() <= high
        assert drawn.rate[:, 0, 0].min() >= 1.0
        assert drawn.rate[:, 1, 0].min() >= 0.8
        assert drawn.rate[:, :, 1].min() == 1e9  # a speed that is not limited
        assert ((drawn.lag[:, 0] >= 0.05) & (drawn.lag[:, 0] <= 0.15)).all()


def test_commands_do_not_overtake_each_other():
    motors = MotorFlaws(DIFFERENTIAL, ErrorModel.model_validate(MOTORS), 0.1, 0.0)
    rng = np.random.default_rng(0)
    state = motors.at_rest(np.zeros((50, 3)))
    for _ in range(20):
        choice = motors.choose(50, rng, corners=True)
        state = motors.follow(motors.give(state, np.ones((50, 2)), choice), choice)
        assert (state.acts[:, :-1] >= state.acts[:, 1:]).all()
        assert (state.acts.min(axis=1) <= 1e-12).all()  # some command acts


def setting_of(policy, lab, model, **wished) -> Setting:
    return Setting.of(policy, lab, 0.0, Wishes(errors=model, **wished), job="simulate")


def test_a_model_whose_errors_are_nothing_changes_nothing(policy, lab):
    nothing = ErrorModel.model_validate(
        {
            "sensor": {"lidar": {"absolute": 0.0, "bias": 0.0, "missing": 0, "angle": 0.0, "thin": 0.0}},
            "pose": {"x": 0.0},
            "actuation": {"linear": {"lag": [0.0, 0.0], "relative": 0.0}},
            "timing": {"interval": [0.1, 0.1], "delay": [0.0, 0.0]},
        }
    )
    asked = setting_of(policy, lab, nothing)
    plain = drive(policy, asked, noise=0.0)
    flawed = drive(policy, asked, noise=0.0, errors=nothing)
    assert (plain.trajectory.outcomes == flawed.trajectory.outcomes).all()
    assert np.abs(plain.trajectory.poses - flawed.trajectory.poses).max() < 1e-6
    assert plain.trajectory.time == pytest.approx(flawed.trajectory.time)


@pytest.mark.parametrize("adversary", [False, True])
def test_rays_pass_thin_obstacles_or_see_them(lab, adversary):
    posts = Obstacles(np.array([[1.0, 0.0, 0.04], [-1.0, 0.3, 0.04], [0.2, -1.0, 0.04], [0.0, 1.2, 0.2]]))
    world = replace(lab, obstacles=lab.obstacles + posts)
    model = ErrorModel.model_validate({"sensor": {"lidar": {"thin": 0.1}}})
    scenario = replace(lab.scenarios[0], start=(0.0, 0.0, 0.0), goal=(3.5, 0.0), obstacles=Obstacles())
    simulator = NavigationSimulator(
        world, 1, noise=0.0, errors=model, adversary=adversary, scenarios=[scenario]
    )
    simulator.reset()
    seen = np.concatenate([simulator.offer(60)[:, 0, :20]])
    poses = simulator.poses
    lidar = simulator.robot.lidar
    near, far = (
        scan(poses, lidar, outlines(replace(world, obstacles=kept), None))[0]
        for kept in (world.obstacles, lab.obstacles + posts.select(np.array([False, False, False, True])))
    )
    assert (seen >= near - 1e-4).all()
    assert (seen <= far + 1e-4).all()
    met = near < far - 0.01
    assert met.sum() >= 2
    assert np.allclose(seen.min(axis=0)[met], near[met], atol=1e-4)
    if adversary:
        assert np.allclose(seen.max(axis=0)[met], far[met], atol=1e-4)


def test_an_adversary_comes_nearer_than_chance(policy, lab):
    model = ErrorModel.model_validate({"sensor": {"lidar": {"absolute": 0.3}}, **MOTORS})
    asked = setting_of(policy, lab, model)
    chance = drive(policy, asked, errors=model, seed=1)
    worst = drive(policy, asked, errors=model, adversary=True, seed=1)
    assert worst.least_clearance.mean() < chance.least_clearance.mean() - 0.01


def test_frames_of_the_past_are_kept_when_an_adversary_chooses(lab):
    spec = viatool.load_policy("via").spec
    stacked = [
        channel.model_copy(update={"frames": None})
        for channel in spec.observation
        if channel.kind != "budget"
    ]
    from viatool.channels import Frames

    model = ErrorModel.model_validate({"sensor": {"lidar": {"absolute": 0.1}}})
    simulator = NavigationSimulator(
        lab, 3, noise=0.0, channels=stacked, frames=Frames(count=3), errors=model, adversary=True,
        scenarios=lab.scenarios[:3],
    )  # fmt: skip
    size = sum(channel.size for channel in stacked)
    simulator.reset()
    before = simulator.take(np.zeros(3, int)) if simulator.offer(2).shape == (2, 3, 3 * size) else None
    assert before is not None
    for _ in range(4):
        simulator.step(np.full((3, 2), 0.1))
        offered = simulator.offer(4)
        now = simulator.take(np.array([0, 1, 2]))
        assert (now == offered[[0, 1, 2], [0, 1, 2]]).all()
        assert (now[:, : 2 * size] == before[:, size:]).all()  # oldest first
        before = now


def test_simulate_takes_a_model_and_verify_its_trajectory(tmp_path: Path) -> None:
    errors, target = tmp_path / "robot-errors.yaml", tmp_path / "drive.npz"
    errors.write_text("sensor: {lidar: {absolute: 0.05}}\nactuation: {linear: {lag: [0.05, 0.1]}}\n")
    asked = ["simulate", "via", "--map", "lab", "--errors", str(errors), "--adversary", "-o", str(target)]
    run = CliRunner().invoke(main, [*asked, "-o", f"json:{tmp_path / 'run.json'}"])
    assert run.exit_code == 0, run.output
    assert "chosen by an adversary" in " ".join(run.output.split())
    assert "by an adversary; no other but by the conditions" in " ".join(run.output.split())
    assert "actuation.linear.lag" in run.output
    assert '"chosen_by": "an adversary"' in (tmp_path / "run.json").read_text()
    checked = CliRunner().invoke(
        main,
        [
            "verify",
            "via",
            "--map",
            "lab",
            "--eps",
            "0.01",
            "--trajectory",
            str(target),
            "--only-contested",
            "-q",
        ],
    )
    assert checked.exit_code == 0, checked.output


@pytest.mark.parametrize(
    ("text", "options", "told"),
    [
        ("obstacles: {returns: 1.0}", [], "obstacles.returns"),
        ("obstacles: {speed: 1.0}", ["--engine", "bullet"], "obstacles.speed"),
        ("obstacles: {speed: 1.0}", ["--record", "film.gif"], "--record"),
        ("timing: {sensing: 0.1}", ["--engine", "bullet"], "simulate with bullet"),
        ("sensor: {lidar: {angle: 0.1}}", ["--engine", "bullet"], "simulate with bullet"),
        ("sensor: {sonar: {absolute: 0.1}}", [], "sonar"),
        ("timing: {sensing: 0.1}", ["--acceleration", "1"], "acceleration"),
    ],
)
def test_what_cannot_be_simulated_is_refused_by_name(tmp_path, text, options, told):
    errors = tmp_path / "robot-errors.yaml"
    errors.write_text(text)
    run = CliRunner().invoke(main, ["simulate", "via", "--map", "lab", "--errors", str(errors), *options])
    assert run.exit_code == 2
    assert told in run.output


def test_an_adversary_without_a_model_is_refused():
    run = CliRunner().invoke(main, ["simulate", "via", "--map", "lab", "--adversary"])
    assert run.exit_code == 2
    assert "--errors" in run.output


def test_a_seed_is_a_run(policy, lab):
    model = ErrorModel.model_validate(
        {"sensor": {"lidar": {"bias": 0.1}}, "timing": {"interval": [0.09, 0.11]}}
    )
    asked = replace(setting_of(policy, lab, model), scenarios=lab.scenarios[:2])
    first, again, other = (drive(policy, asked, errors=model, seed=seed) for seed in (4, 4, 5))
    assert (first.trajectory.observations == again.trajectory.observations).all()
    assert (
        len(first.trajectory) != len(other.trajectory)
        or (first.trajectory.observations != other.trajectory.observations).any()
    )
