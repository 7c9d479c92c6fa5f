"""Recordings that fit their map stay without a word; those that cannot have been made there are told, with a cause."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

import viatool
from viatool.channels import LidarSpecification
from viatool.policy import load_policy
from viatool.policy.specification import ObservationChannel
from viatool.simulate import Agreement, compare_with_map, navigation_channels, roll_out
from viatool.trajectory import Trajectory
from viatool.uncertainty import ErrorModel
from viatool.world import Obstacles, WorldMap, load_map

LAB = load_map("maps/lab.yaml")
CHANNELS = navigation_channels(LAB.robot.lidar)
RADII = np.full(25, 0.01)
BINS = slice(0, 20)


@pytest.fixture(scope="module")
def driven() -> Trajectory:
    """Ten episodes with the noise of the robot's LiDAR, which is as large as eps."""
    trajectory = roll_out(load_policy("policies/via.onnx"), LAB, noise=0.01, seed=3)
    return replace(trajectory, observations=trajectory.observations[:, :25])


def compare(trajectory: Trajectory, world: WorldMap = LAB) -> Agreement:
    (found,) = compare_with_map(CHANNELS, trajectory, world, RADII)
    return found


def seen_as(trajectory: Trajectory, change: Callable[[np.ndarray], np.ndarray]) -> Trajectory:
    observations = trajectory.observations.copy()
    observations[:, BINS] = change(observations[:, BINS])
    return replace(trajectory, observations=observations)


def turned(trajectory: Trajectory, turn: float) -> Trajectory:
    """Return the same readings at headings that differ: a sensor that is mounted so, and nobody said it."""
    return replace(trajectory, poses=trajectory.poses - [0.0, 0.0, turn])


def without_echo(readings: np.ndarray) -> np.ndarray:
    return np.where(np.random.default_rng(1).random(readings.shape) < 0.02, 7.0, readings)


def person(readings: np.ndarray) -> np.ndarray:
    changed = readings.copy()
    changed[::3, 7:9] = 1.0  # stands in view for a third of the time
    return changed


@pytest.mark.parametrize("change", [np.copy, without_echo, person])
def test_an_honest_recording_is_not_in_doubt(
    driven: Trajectory, change: Callable[[np.ndarray], np.ndarray]
) -> None:
    found = compare(seen_as(driven, change))
    assert not found.doubtful
    assert found.readings == 20 * min(len(driven), 2_000)
    assert found.off > 0  # noise of a standard deviation of eps goes beyond eps
    assert found.median_difference < 0.02


def test_what_the_error_model_allows_is_no_contradiction(driven: Trajectory) -> None:
    biased = seen_as(driven, lambda readings: np.minimum(1.1 * readings + 0.1, 7.0))
    assert compare(biased).doubtful
    model = ErrorModel.model_validate({"sensor": {"lidar": {"relative": 0.1, "bias": 0.1}}})
    (found,) = compare_with_map(CHANNELS, biased, LAB, RADII, errors=model)
    assert not found.doubtful
    astray = replace(driven, poses=driven.poses + np.array([0.1, 0.05, 0.0]))
    model = ErrorModel.model_validate({"pose": {"x": 0.1, "y": 0.05}})
    (found,) = compare_with_map(CHANNELS, astray, LAB, RADII, errors=model)
    assert found.contradicting < 0.5 * compare(astray).contradicting  # what is left is seen past edges


def test_what_the_map_shows_is_not_off_at_all(driven: Trajectory) -> None:
    exact = roll_out(load_policy("policies/via.onnx"), LAB, LAB.scenarios[:1], noise=0.0)
    found = compare(replace(exact, observations=exact.observations[:, :25]))
    assert (found.off, found.contradicting, found.share) == (0, 0, 0.0)
    assert found.median_difference < 1e-6


@pytest.mark.parametrize(
    ("change", "cause"),
    [
        (lambda t: seen_as(t, lambda readings: readings[:, ::-1]), r"it looks mirrored \(its rays"),
        (lambda t: turned(t, np.pi), r"it looks turned by 180 degrees:"),
        (lambda t: turned(t, np.radians(37.0)), r"it looks turned by 37 degrees to the left"),
        (lambda t: turned(t, np.radians(-8.0)), r"it looks turned by 8 degrees to the right"),
        (
            lambda t: seen_as(turned(t, np.radians(-90.0)), lambda readings: readings[:, ::-1]),
            r"mirrored .* and turned by 90 degrees",
        ),
        (lambda t: seen_as(t, lambda readings: np.full_like(readings, 7.0)), "check that the map"),
        (lambda t: replace(t, poses=t.poses + np.array([0.4, 0.2, 0.0])), "check that the map"),
        (lambda t: seen_as(t, lambda readings: 1.1 * readings), "check that the map"),
        (lambda t: seen_as(t, lambda readings: np.roll(readings, 3, axis=1)), ""),
    ],
)
def test_a_recording_that_was_not_made_so_is_told_with_its_likely_cause(
    driven: Trajectory, change: Callable[[Trajectory], Trajectory], cause: str
) -> None:
    found = compare(change(driven))
    assert found.doubtful
    assert found.share > 0.3
    assert re.search(cause, found.warning)
    assert f"{found.off:,} of {found.readings:,} readings of 'lidar'" in found.warning


def test_a_map_that_is_out_of_date_is_told(driven: Trajectory) -> None:
    assert compare(driven, replace(LAB, obstacles=Obstacles())).doubtful


def test_few_states_stand_for_many_and_that_is_said(driven: Trajectory) -> None:
    many = driven.select(np.sort(np.arange(20_000) % len(driven)))
    found, again = compare(many), compare(many)
    assert (found.compared, found.states) == (2_000, 20_000)
    assert "in 2,000 of 20,000 states at random" in found.words
    assert found == again


def test_every_lidar_of_a_policy_is_compared_by_itself(driven: Trajectory) -> None:
    """A narrow LiDAR behind the others, whose readings are wrong."""
    narrow = LidarSpecification(field_of_view=1.0, rays=4, bins=2, minimum_range=0.2, maximum_range=3.0)
    second = ObservationChannel(name="front", size=2, unit="m", kind="lidar", lidar=narrow)
    wider = replace(driven, observations=np.c_[driven.observations, np.full((len(driven), 2), 0.2)])
    first, found = compare_with_map([*CHANNELS, second], wider, LAB, np.full(27, 0.01))
    assert not first.doubtful
    assert found.doubtful
    assert (found.channel, found.readings) == ("front", 2 * found.compared)


def test_channels_of_which_nothing_tells_the_rays_and_recordings_without_states_are_left_alone(
    driven: Trajectory,
) -> None:
    unclear = ObservationChannel(name="lidar", size=7, kind="lidar")
    assert compare_with_map([unclear], driven, LAB, RADII) == ()
    assert compare_with_map(CHANNELS, driven.select(np.zeros(0, int)), LAB, RADII) == ()


def test_a_report_says_how_a_recording_agrees_and_nothing_of_simulated_states(driven: Trajectory) -> None:
    policy = load_policy("policies/via.onnx")
    states = roll_out(policy, LAB, LAB.scenarios[:1])
    contradicting = states.observations.copy()
    contradicting[:, BINS] = 7.0
    result = viatool.verify(policy, LAB, eps=0.01, trajectory=replace(states, observations=contradicting))
    (found,) = result.to_json()["recording"]
    assert found["doubtful"]
    assert found["share"] > 0.5
    assert "contradicts the map" in result.assumptions()["recording"]
    plain = viatool.verify(policy, LAB, eps=0.01, scenarios=LAB.scenarios[:1])
    assert "recording" not in plain.to_json()
    assert "recording" not in plain.assumptions()
