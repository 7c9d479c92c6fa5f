"""Places beside the driven path at which it is up to the policy whether the robot comes too near."""

from __future__ import annotations

import numpy as np
import pytest

import viatool
from viatool.errors import ConfigurationError, EmptyEvaluationError
from viatool.safety import JudgedStates, ScenePoses, find_contested
from viatool.verification.close import MOST, close_places
from viatool.verification.states import states_of
from viatool.world import Scenes

COUNT = 60


@pytest.fixture(scope="module")
def driven() -> viatool.Result:
    return viatool.verify("via", "lab", eps=0.01, scenarios=viatool.load_map("lab").scenarios[:3])


@pytest.fixture(scope="module")
def places(driven) -> viatool.Trajectory:
    return close_places(driven.setting, driven.trajectory, COUNT, seed=4)


def test_every_place_is_free_and_contested(driven, places) -> None:
    setting = driven.setting
    assert len(places) == COUNT
    scenes = Scenes.of(setting.world_map, places.scenarios)
    clearance = scenes.footprint_clearance(places.poses, setting.rules.footprint, places.episode)
    assert (clearance > setting.rules.clearance.collision).all()
    states = states_of(setting, places)
    at = ScenePoses.of(setting.world_map, places.scenarios, places.poses, places.episode)
    judged = JudgedStates(setting.rules, at, states.under_way, states.measured, states.begun)
    assert find_contested(judged).collision.all()
    assert not find_contested(
        replaced(judged, driven)
    ).collision.any()  # as the driven states beside them are not


def replaced(judged, driven) -> JudgedStates:
    trajectory, setting = driven.trajectory, driven.setting
    states = states_of(setting, trajectory)
    at = ScenePoses.of(setting.world_map, trajectory.scenarios, trajectory.poses, trajectory.episode)
    return JudgedStates(setting.rules, at, states.under_way, states.measured, states.begun)


def test_a_seed_means_its_places(driven, places) -> None:
    again, other = (close_places(driven.setting, driven.trajectory, COUNT, seed=seed) for seed in (4, 5))
    np.testing.assert_array_equal(again.poses, places.poses)
    np.testing.assert_array_equal(again.observations, places.observations)
    assert not np.isin(other.poses[:, 0], places.poses[:, 0]).any()


def test_sensors_observe_the_place_and_the_command_before_is_that_of_the_driven_state(driven, places) -> None:
    spec, driven = driven.setting.spec, driven.trajectory
    beside = np.array([
        np.flatnonzero((driven.episode == episode) & (driven.time == time))[0]
        for episode, time in zip(places.episode, places.time, strict=True)
    ])  # fmt: skip
    for name in ("previous_linear", "previous_angular"):
        columns = spec.inputs.newest(name)
        np.testing.assert_array_equal(
            places.observations[:, columns], driven.observations[beside][:, columns]
        )
    goals = np.array([scenario.goal for scenario in places.scenarios])[places.episode]
    column = spec.inputs.newest("goal_distance")[0]
    lower, upper = spec.inputs.readings(places.observations)
    distance = np.hypot(*(goals - places.poses[:, :2]).T)
    np.testing.assert_allclose(0.5 * (lower + upper)[:, column], distance, atol=1e-3)
    assert (np.hypot(*(places.poses - driven.poses[beside])[:, :2].T) <= 4.0).all()


def test_no_wall_is_between_a_place_and_the_driven_state(driven, places) -> None:
    scenes = Scenes.of(driven.setting.world_map, places.scenarios)
    rows = [
        np.flatnonzero((driven.episode == episode) & (driven.trajectory.time == time))[0]
        for episode, time in zip(places.episode, places.time, strict=True)
    ]
    between = np.linspace(driven.poses[rows, :2], places.poses[:, :2], 50)
    for points in between:
        assert (scenes.clearance(points, places.episode) > 0.0).all()


def test_what_is_not_known_of_a_place_is_refused_by_name(driven) -> None:
    for count in (0, MOST + 1):
        with pytest.raises(ConfigurationError, match=f"{count} close places"):
            close_places(driven.setting, driven.trajectory, count)


def test_a_robot_that_nothing_endangers_has_no_close_places(driven) -> None:
    still = viatool.verify(
        "via", "lab", eps=0.01, trajectory=driven.trajectory, interval=1e-6, prefer={"interval": "map"}
    )
    with pytest.raises(EmptyEvaluationError, match="no place within 4 m"):
        close_places(still.setting, driven.trajectory, 10)
