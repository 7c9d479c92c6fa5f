from __future__ import annotations

import numpy as np
import pytest

from viatool.channels import View
from viatool.errors import PolicyError
from viatool.policy import LidarSpecification, ObservationChannel
from viatool.simulate import Observer, navigation_channels
from viatool.simulate.noise import draw_normal
from viatool.world import ROBOTS, Scenes, WorldMap, load_map


@pytest.fixture(scope="module")
def lab() -> WorldMap:
    return load_map("maps/lab.yaml")


VIEW = View(
    scenes=Scenes.of(load_map("maps/lab.yaml"), [None]),
    poses=np.array([[0.0, 0.0, 0.0], [1.0, 1.0, np.pi / 2], [-1.0, 1.0, -3.0]]),
    scene=np.zeros(3, int),
    goals=np.array([[2.0, 0.0], [0.0, 1.0], [-1.0, 1.0]]),
    previous=np.array([[0.1, 0.2], [0.3, -0.4], [0.5, 0.6]]),
)


def test_the_goal_is_seen_in_the_robot_s_frame() -> None:
    goal = VIEW.goal
    assert goal.distance == pytest.approx([2.0, 1.0, 0.0])
    assert goal.cosine[:2] == pytest.approx([1.0, 0.0])
    assert goal.sine[:2] == pytest.approx([0.0, 1.0])  # ahead, and to the left
    assert np.isfinite(goal.cosine).all()  # also at the goal itself


def test_the_task_has_twenty_five_columns(lab: WorldMap) -> None:
    channels = navigation_channels(lab.robot.lidar)
    assert [(channel.kind, channel.size) for channel in channels] == [
        ("lidar", 20),
        ("goal_distance", 1),
        ("goal_cosine", 1),
        ("goal_sine", 1),
        ("previous_linear", 1),
        ("previous_angular", 1),
    ]
    observer = Observer(channels, lab.robot, noise=0.0)
    observations = observer.observe(VIEW, np.random.default_rng(0))
    assert observations.shape == (3, 25)
    assert observations[:, 23:] == pytest.approx(VIEW.previous)
    assert (observations == observations.astype(np.float32)).all()  # what a float32 program receives


def test_columns_follow_the_specification_in_any_order(lab: WorldMap) -> None:
    lidar = LidarSpecification(
        field_of_view=2.0 * np.pi, rays=36, bins=4, minimum_range=0.0, maximum_range=3.0
    )
    channels = [
        ObservationChannel(name="u", kind="budget", value=0.1),
        ObservationChannel(name="speed", kind="previous_linear"),
        ObservationChannel(name="scan", size=4, kind="lidar", lidar=lidar),
        ObservationChannel(name="battery", size=2, kind="other", value=0.5),
        ObservationChannel(name="far", kind="goal_distance"),
    ]
    observer = Observer(channels, lab.robot, noise=0.0)
    observations = observer.observe(VIEW, np.random.default_rng(0))
    assert observations.shape == (3, 9)
    assert (observations[:, 0] == np.float32(0.1)).all()
    assert observations[:, 1] == pytest.approx([0.1, 0.3, 0.5])
    expected = VIEW.scenes.cast(VIEW.poses, VIEW.scene, observer.fans[0].lidar)
    assert observations[:, 2:6] == pytest.approx(expected.reshape(3, 4, 9).min(axis=2), abs=1e-3)
    assert (observations[:, 6:8] == 0.5).all()
    assert observations[:, 8] == pytest.approx([2.0, 1.0, 0.0])


def test_a_policy_without_lidar_is_observed_too(lab: WorldMap) -> None:
    observer = Observer([ObservationChannel(name="far", kind="goal_distance")], lab.robot)
    assert observer.observe(VIEW, np.random.default_rng(0)).shape == (3, 1)


@pytest.mark.parametrize(
    ("channel", "reason"),
    [
        (ObservationChannel(name="imu", size=3, kind="other"), "'imu' of kind 'other' cannot be simulated"),
        (ObservationChannel(name="u", kind="budget"), "'u' of kind 'budget' cannot be simulated"),
        (
            ObservationChannel(name="scan", size=36, kind="lidar"),
            "has 36 numbers, but the LiDAR of turtlebot3",
        ),
    ],
)
def test_what_cannot_be_simulated_is_refused_by_name(channel: ObservationChannel, reason: str) -> None:
    with pytest.raises(PolicyError, match=reason) as raised:
        Observer([channel], ROBOTS["turtlebot3"])
    assert raised.value.hint


def test_normal_numbers_are_normal() -> None:
    from scipy.stats import kstest

    numbers = draw_normal(np.random.default_rng(0), 301, 333)
    assert numbers.shape == (301, 333)
    assert numbers.dtype == np.float32
    assert np.isfinite(numbers).all()
    assert kstest(numbers.ravel(), "norm").pvalue > 0.01
    assert np.abs(numbers).max() > 4.0
