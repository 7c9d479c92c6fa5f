"""What makes a robot less than ideal, each against a calculation of its own."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from viatool.errors import ConfigurationError
from viatool.motion.kinematics import DIFFERENTIAL
from viatool.simulate import Conditions, NavigationSimulator
from viatool.world import ROBOTS, Obstacles, Scenario, WorldMap, load_map

START = Scenario("start", (-2.0, 0.0, 0.0), (4.0, 4.0))


@pytest.fixture(scope="module")
def hall() -> WorldMap:
    return replace(load_map("maps/lab.yaml"), obstacles=Obstacles())


def simulator(world_map: WorldMap, robots: int = 1, **conditions: float) -> NavigationSimulator:
    made = NavigationSimulator(
        world_map, robots, scenarios=[START], conditions=Conditions(noise=0.0, **conditions), horizon=10_000
    )
    made.reset()
    return made


@pytest.mark.parametrize("delay", [0.0, 0.04, 0.1, 0.25])
def test_a_command_acts_after_the_delay_and_not_before(hall: WorldMap, delay: float) -> None:
    tested = simulator(hall, delay=delay)
    commands = [(0.5, 0.0), (0.1, 1.0), (0.3, -1.0), (0.5, 0.5), (0.2, 0.0)]
    pose = np.array(START.start)
    for number, command in enumerate(commands):
        tested.step(np.array([command]))
        for instant in range(100):  # a millisecond each
            sent = (number * 0.1 + instant * 0.001 + 0.0005) - delay
            acting = (0.0, 0.0) if sent < 0.0 else commands[int(sent / 0.1)]
            pose = DIFFERENTIAL.advance(pose, np.array(acting), 0.001)
        assert tested.poses[0] == pytest.approx(pose, abs=1e-9)
        assert tested.previous[0] == pytest.approx(command)  # observed is what was sent


def test_wheels_gain_speed_at_the_rate_that_is_given(hall: WorldMap) -> None:
    tested = simulator(hall, acceleration=0.5)
    travelled = []
    for _ in range(15):
        tested.step(np.array([[0.5, 0.0]]))
        travelled.append(tested.poses[0, 0] + 2.0)
    times = 0.1 * np.arange(1, 16)
    expected = np.where(times < 1.0, 0.25 * times**2, 0.25 + 0.5 * (times - 1.0))
    assert travelled == pytest.approx(expected, abs=1e-9)


def test_the_outer_wheel_limits_a_turn(hall: WorldMap) -> None:
    tested = simulator(hall, acceleration=1.0)
    tested.step(np.array([[0.0, 1.0]]))
    # rims reach 0.1435 m/s after 0.1435 s, so after 0.1 s the robot has turned 0.5 * (1 / 0.1435) * 0.1^2
    assert tested.poses[0, 2] == pytest.approx(0.5 / 0.1435 * 0.01, rel=1e-6)


def test_a_limit_that_never_binds_changes_nothing(hall: WorldMap) -> None:
    free, limited = simulator(hall), simulator(hall, acceleration=1e6)
    for _ in range(5):
        for tested in (free, limited):
            tested.step(np.array([[0.4, 0.7]]))
    assert limited.poses == pytest.approx(free.poses, abs=1e-6)


def test_odometry_errs_as_wheels_of_the_wrong_size_do(hall: WorldMap) -> None:
    count, drift = 4000, 0.02
    tested = simulator(hall, count, drift=drift)
    for _ in range(10):
        tested.step(np.full((count, 2), (0.5, 0.0)))
    assert np.ptp(tested.poses, axis=0) == pytest.approx(0.0)  # they all drive the same
    believed = tested._odometry.poses  # what is observed comes from here
    along, turned = believed[:, 0] + 2.0, believed[:, 2]
    assert along.std() == pytest.approx(0.5 * drift / np.sqrt(2.0), rel=0.1)
    assert turned.std() == pytest.approx(0.5 * drift * np.sqrt(2.0) / 0.287, rel=0.1)
    observed = tested.step(np.zeros((count, 2))).observation
    expected = np.hypot(4.0 - believed[:, 0], 4.0 - believed[:, 1])
    assert observed[:, 20] == pytest.approx(expected, abs=1e-5)
    assert observed[:, 20].std() > 0.003


def test_odometry_without_drift_is_the_truth(hall: WorldMap) -> None:
    tested = simulator(hall, 5, drift=1e-12)
    rng = np.random.default_rng(0)
    for _ in range(30):
        tested.step(rng.uniform((0.0, -1.0), (0.5, 1.0), (5, 2)))
    assert tested._odometry.poses[:, :2] == pytest.approx(tested.poses[:, :2], abs=1e-9)


def test_lost_rays_read_the_maximum(hall: WorldMap) -> None:
    robot = replace(hall.robot, lidar=replace(hall.robot.lidar, bins=180))
    tested = simulator(hall.with_robot(robot), 300, dropout=0.1)
    near = NavigationSimulator(hall.with_robot(robot), 1, scenarios=[START], noise=0.0).reset()[0, :180] < 6.9
    lost = tested.step(np.zeros((300, 2))).observation[:, :180][:, near] == 7.0
    assert lost.mean() == pytest.approx(0.1, abs=0.005)


def test_a_slow_lidar_repeats_its_last_scan(hall: WorldMap) -> None:
    tested = NavigationSimulator(
        hall, 1, scenarios=[START], conditions=Conditions(noise=0.05, lidar_rate=4.0)
    )
    scans = [tested.reset()[0, :20]]
    scans += [tested.step(np.array([[0.5, 0.0]])).observation[0, :20] for _ in range(10)]
    fresh = [bool((a != b).any()) for a, b in pairwise(scans)]
    # a scan is complete after 0.25, 0.5, 0.75 and 1 s
    assert fresh == [False, False, True, False, True, False, False, True, False, True]


def test_robots_keep_their_conditions_when_others_leave(hall: WorldMap) -> None:
    conditions = Conditions(noise=0.0, delay=0.15, drift=0.05, acceleration=1.0)
    pair = [NavigationSimulator(hall, 4, scenarios=[START], conditions=conditions) for _ in range(2)]
    stay = np.array([False, True, False, True])
    for tested in pair:
        tested.reset()
        tested.step(np.array([[0.1 * row, 0.2] for row in range(4)]))
    pair[0].keep(stay)
    commands = np.full((4, 2), (0.5, 0.3))
    few, every = pair[0].step(commands[stay]), pair[1].step(commands)
    assert (pair[0].poses == pair[1].poses[stay]).all()
    assert (few.observation == every.observation[stay]).all()


@pytest.mark.parametrize(
    ("wrong", "reason"),
    [
        ({"noise": -0.1}, "noise"),
        ({"dropout": 1.0}, "dropout"),
        ({"delay": float("nan")}, "delay"),
        ({"drift": -1.0}, "drift"),
        ({"lidar_rate": 0.0}, "LiDAR rate"),
        ({"acceleration": 0.0}, "acceleration"),
    ],
)
def test_impossible_conditions_are_refused(wrong: dict[str, float], reason: str) -> None:
    with pytest.raises(ConfigurationError, match=reason) as raised:
        Conditions(**wrong)
    assert raised.value.hint


def test_wheels_that_are_not_known_cannot_be_limited(hall: WorldMap) -> None:
    mine = hall.with_robot(replace(ROBOTS["jackal"], name="homemade", track=0.0))
    for conditions in (Conditions(acceleration=1.0), Conditions(drift=0.01)):
        with pytest.raises(ConfigurationError, match="track of robot 'homemade' is not known"):
            NavigationSimulator(mine, 1, conditions=conditions)
