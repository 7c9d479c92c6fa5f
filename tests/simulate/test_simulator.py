from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from viatool.errors import ConfigurationError
from viatool.simulate import NavigationSimulator, NavigationTask
from viatool.world import Footprint, Obstacles, Scenario, Scenes, WorldMap, load_map


@pytest.fixture(scope="module")
def lab() -> WorldMap:
    return load_map("maps/lab.yaml")


def drive(simulator: NavigationSimulator, steps: int, seed: int) -> list[np.ndarray]:
    """Drive at random with resets and return everything that comes out."""
    rng = np.random.default_rng(seed)
    seen = [simulator.reset()]
    for _ in range(steps):
        step = simulator.step(
            np.column_stack([rng.uniform(0, 0.5, len(simulator)), rng.uniform(-1, 1, len(simulator))])
        )
        seen += [step.observation, step.reward, step.cost, step.clearance, step.done.astype(float)]
        if step.done.any():
            seen.append(simulator.reset(step.done))
    return seen


def test_the_same_seed_gives_the_same_bits_and_another_one_does_not(lab: WorldMap) -> None:
    first, second, other = (drive(NavigationSimulator(lab, 16, seed=seed), 200, 0) for seed in (5, 5, 6))
    assert len(first) == len(second)
    assert all((a == b).all() for a, b in zip(first, second, strict=True))
    assert (first[0] != other[0]).any()


def test_a_step_is_what_the_task_says(lab: WorldMap) -> None:
    simulator = NavigationSimulator(lab, 64, noise=0.0, seed=1)
    simulator.reset()
    rng = np.random.default_rng(1)
    outcomes = np.zeros(3, int)
    for _ in range(150):
        before = simulator.poses.copy()
        actions = np.column_stack([rng.uniform(-0.2, 0.7, 64), rng.uniform(-1.2, 1.2, 64)])
        step = simulator.step(actions)
        v, omega = np.clip(actions[:, 0], 0, 0.5), np.clip(actions[:, 1], -1, 1)
        assert np.linalg.norm(simulator.poses[:, :2] - before[:, :2], axis=1) == pytest.approx(
            0.1 * v * np.sinc(0.05 * omega / np.pi)
        )
        clearance = simulator.scenes.clearance(simulator.poses[:, :2], simulator.scene)
        distance = np.linalg.norm(simulator.goals - simulator.poses[:, :2], axis=1)
        assert step.clearance == pytest.approx(clearance)
        assert step.goal_distance == pytest.approx(distance)
        assert (step.collision == (clearance < 0.4)).all()
        assert (step.success == ((distance < 0.5) & ~step.collision)).all()
        assert (step.cost == (clearance < 0.5)).all()
        assert (step.terminated == (step.success | step.collision)).all()
        nearest = step.observation[:, :20].min(axis=1)
        otherwise = v - np.abs(omega) / 2 - np.maximum(0.0, 1.35 - nearest) / 2
        expected = np.where(step.collision, -100.0, np.where(step.success, 100.0, otherwise))
        assert step.reward == pytest.approx(expected, abs=1e-6)
        outcomes += [step.success.sum(), step.collision.sum(), step.truncated.sum()]
        if step.done.any():
            simulator.reset(step.done)
    assert outcomes[1] > 20
    assert outcomes[2] == 0


def test_an_episode_is_truncated_at_the_horizon_but_not_terminated(lab: WorldMap) -> None:
    simulator = NavigationSimulator(lab, 3, horizon=5)
    simulator.reset()
    for number in range(5):
        step = simulator.step(np.zeros((3, 2)))
        assert (step.truncated == (number == 4)).all()
    assert not step.terminated.any()
    simulator.reset(np.array([False, True, False]))
    assert simulator.step(np.zeros((3, 2))).truncated.tolist() == [True, False, True]


def test_a_reset_moves_only_the_robots_it_is_asked_to(lab: WorldMap) -> None:
    simulator = NavigationSimulator(lab, 8, seed=2)
    simulator.reset()
    step = simulator.step(np.full((8, 2), 0.3))
    poses, goals = simulator.poses.copy(), simulator.goals.copy()
    which = np.arange(8) % 3 == 0
    observations = simulator.reset(which)
    assert (observations[~which] == step.observation[~which]).all()
    assert (observations[which] != step.observation[which]).any(axis=1).all()
    assert (simulator.poses[~which] == poses[~which]).all()
    assert (simulator.goals[which] != goals[which]).any(axis=1).all()
    assert (observations[which, -2:] == 0.0).all()  # nothing was commanded before


def test_random_scenarios_are_built_into_the_scene_of_their_robot(lab: WorldMap) -> None:
    simulator = NavigationSimulator(lab, 6, seed=3, noise=0.0)
    simulator.reset()
    simulator.reset(np.array([True, False, False, True, False, True]))
    least = simulator.scenes.clearance(simulator.poses[:, :2], simulator.scene)
    assert (least > 0.5).all()
    ranges = simulator.scenes.cast(simulator.poses, simulator.scene, lab.robot.lidar)
    binned = ranges.reshape(6, 20, 9).min(axis=2)
    assert simulator.reset(np.zeros(6, bool))[:, :20] == pytest.approx(binned, abs=1e-3)


def test_given_scenarios_are_driven_in_turn(lab: WorldMap) -> None:
    simulator = NavigationSimulator(lab, 4, scenarios=lab.scenarios[:3])
    simulator.reset()
    starts = np.array([scenario.start for scenario in lab.scenarios])
    goals = np.array([scenario.goal for scenario in lab.scenarios])
    assert (simulator.poses == starts[[0, 1, 2, 0]]).all()
    simulator.reset(np.array([False, True, True, False]))
    assert (simulator.poses == starts[[0, 1, 2, 0]]).all()
    assert (simulator.goals == goals[[0, 1, 2, 0]]).all()
    simulator.reset(np.array([True, False, False, False]))
    assert (simulator.poses[0] == starts[0]).all()


def test_robots_can_leave(lab: WorldMap) -> None:
    simulator = NavigationSimulator(lab, 5, noise=0.0, scenarios=lab.scenarios)
    twin = NavigationSimulator(lab, 5, noise=0.0, scenarios=lab.scenarios)
    simulator.reset()
    twin.reset()
    stay = np.array([True, False, True, False, True])
    simulator.keep(stay)
    assert len(simulator) == 3
    few, all_of_them = simulator.step(np.full((3, 2), 0.4)), twin.step(np.full((5, 2), 0.4))
    assert few.observation == pytest.approx(all_of_them.observation[stay], abs=1e-5)


def test_a_generator_can_be_exchanged_for_a_curriculum(lab: WorldMap) -> None:
    simulator = NavigationSimulator(lab, 40, seed=4)
    simulator.reset()
    assert simulator.generator is not None
    simulator.generator = simulator.generator.with_goal_distance(1.2, 1.8)
    observations = simulator.reset()
    assert observations[:, 20].max() <= 1.8
    fixed = NavigationSimulator(lab, 1, scenarios=lab.scenarios)
    assert fixed.generator is None
    with pytest.raises(ConfigurationError, match="draws none"):
        fixed.generator = simulator.generator


def test_a_round_robot_collides_earlier_than_a_point(lab: WorldMap) -> None:
    world = lab.with_robot(replace(lab.robot, footprint=Footprint("circle", radius=0.3)))
    scenario = Scenario("", (4.2, 0.0, 0.0), (0.0, 0.0))  # 0.65 m from the wall
    for tested, expected in ((lab, False), (world, True)):
        simulator = NavigationSimulator(tested, 1, scenarios=[scenario])
        simulator.reset()
        assert simulator.step(np.zeros((1, 2))).collision.tolist() == [expected]


def test_readings_are_noisy_only_where_something_is_hit_and_stay_within_the_range(lab: WorldMap) -> None:
    wide = replace(lab, arena=3.0 * lab.arena, obstacles=Obstacles())
    scenario = Scenario("", (-14.0, 0.0, 0.0), (0.0, 0.0))  # a wall behind, nothing ahead
    near = Scenario("", (0.0, 0.0, 0.0), (9.0, 9.0), Obstacles(np.array([[1.0, 0.0, 0.85]])))
    simulator = NavigationSimulator(wide, 200, scenarios=[scenario] * 100 + [near] * 100, seed=5)
    ranges = simulator.reset()[:, :20]
    assert (ranges[:100] == 7.0).all()
    assert ranges[100:, 9:11] == pytest.approx(0.2)  # 0.15 m away, below the minimum range


def test_the_noise_has_the_asked_spread(lab: WorldMap) -> None:
    one_ray = replace(lab.robot.lidar, bins=180)
    world = lab.with_robot(replace(lab.robot, lidar=one_ray))
    simulator = NavigationSimulator(world, 400, scenarios=lab.scenarios[:1], noise=0.05, seed=6)
    readings = simulator.reset()[:, :180]
    true = Scenes.of(lab, lab.scenarios[:1]).cast(simulator.poses[:1], np.zeros(1, int), one_ray)[0]
    error = (readings - true)[:, true < 6.5]
    assert error.mean() == pytest.approx(0.0, abs=1e-3)
    assert error.std() == pytest.approx(0.05, rel=0.02)
    assert np.abs(np.corrcoef(error[:, :2].T)[0, 1]) < 0.2


def test_misuse_is_refused_with_a_hint(lab: WorldMap) -> None:
    with pytest.raises(ConfigurationError, match="gives no scenario"):
        NavigationSimulator(lab, 1, scenarios=[])
    with pytest.raises(ConfigurationError, match="no scenario generator"):
        NavigationSimulator(replace(lab, generator=None), 1)
    with pytest.raises(ConfigurationError, match="horizon is 0 steps"):
        NavigationSimulator(lab, 1, horizon=0)
    for noise in (-0.1, float("nan")):
        with pytest.raises(ConfigurationError, match="noise"):
            NavigationSimulator(lab, 1, noise=noise)


def test_rewards_can_be_weighted_otherwise(lab: WorldMap) -> None:
    task = NavigationTask(turn_penalty=0.0, proximity_penalty=0.0)
    simulator = NavigationSimulator(lab, 2, task=task)
    simulator.reset()
    assert simulator.step(np.array([[0.25, 1.0], [0.5, -1.0]])).reward.tolist() == [0.25, 0.5]
