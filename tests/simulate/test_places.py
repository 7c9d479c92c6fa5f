from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.safety.hand_made_policy import specification, write_policy
from viatool.errors import ConfigurationError, EmptyEvaluationError
from viatool.policy import load_policy
from viatool.setting.setting import Setting
from viatool.setting.wishes import Wishes
from viatool.simulate import Places, observe_places, roll_out
from viatool.world import Footprint, Obstacles, Scenario, Scenes, load_map

LAB = load_map("maps/lab.yaml")
SCENARIOS = LAB.scenarios[:3]


@pytest.fixture(scope="module")
def policy(tmp_path_factory):
    return load_policy(write_policy(tmp_path_factory.mktemp("policy") / "policy.onnx", specification()))


def observed(policy, world, scenarios, places, *, footprint=None, seed=0):
    setting = Setting.of(policy, world, 0.0, Wishes(footprint=footprint), scenarios)
    return observe_places(policy, setting, places, seed=seed)


@pytest.mark.parametrize("places", [Places(spacing=0.7), Places(count=500)])
@pytest.mark.parametrize("footprint", [None, Footprint("circle", radius=0.3), Footprint.rectangle(0.8, 0.4)])
def test_every_place_keeps_the_collision_distance(policy, places, footprint):
    found = observed(policy, LAB, SCENARIOS, places, footprint=footprint)
    outline = footprint or LAB.robot.footprint
    clearance = Scenes.of(LAB, SCENARIOS).footprint_clearance(found.poses, outline, found.episode)
    assert clearance.min() > LAB.clearance.collision
    assert set(found.episode) == {0, 1, 2}
    assert not found.connected


def test_a_grid_holds_every_free_cell_with_every_heading(policy):
    found = observed(policy, LAB, SCENARIOS[:1], Places(spacing=0.97, headings=4))
    axis = -4.85 + 0.97 * (np.arange(10) + 0.5)
    points = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    free = Scenes.of(LAB, SCENARIOS[:1]).clearance(points, np.zeros(100, dtype=int)) > 0.4
    assert len(found) == 4 * free.sum()
    np.testing.assert_allclose(found.poses[::4, :2], points[free], atol=1e-9)
    np.testing.assert_allclose(found.poses[:4, 2], [0.0, np.pi / 2, np.pi, 1.5 * np.pi])


def test_what_is_observed_is_what_the_simulator_observes_there(policy):
    driven = roll_out(policy, LAB, SCENARIOS[:1], noise=0.0)
    x, y, theta = SCENARIOS[0].start
    there = replace(SCENARIOS[0], start=(x, y, theta))
    found = observed(policy, LAB, [there], Places(count=50), seed=3)
    for pose, observation in zip(found.poses[:5], found.observations[:5], strict=True):
        start = roll_out(policy, LAB, [replace(there, start=tuple(pose))], noise=0.0, horizon=1)
        np.testing.assert_allclose(observation[:23], start.observations[0][:23], atol=1e-6)
        np.testing.assert_allclose(
            observation[23:25], np.clip(start.actions[0], (0, -1), (0.5, 1)), atol=1e-6
        )
    assert found.observations.shape[1] == driven.observations.shape[1]


def test_random_places_are_seeded_and_shared_evenly(policy):
    first, again, other = (
        observed(policy, LAB, SCENARIOS, Places(count=100), seed=seed) for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(first.poses, again.poses)
    np.testing.assert_array_equal(first.observations, again.observations)
    assert not np.array_equal(first.poses, other.poses)
    assert np.bincount(first.episode).tolist() == [34, 33, 33]
    assert np.abs(first.poses[:, :2]).max() > 4.0


def test_what_cannot_be_sampled_is_refused(policy):
    for wrong in ({}, {"spacing": 1.0, "count": 1}, {"spacing": 0.0}, {"count": 0}, {"count": 10**9}):
        with pytest.raises(ConfigurationError):
            Places(**wrong)
    with pytest.raises(ConfigurationError, match="more than"):
        observed(policy, LAB, SCENARIOS, Places(spacing=0.001))
    with pytest.raises(ConfigurationError, match=r"goal \(2\.83, 2\.93\)"):
        observed(policy, LAB, [Scenario("in", (0, 0, 0), (2.83, 2.93))], Places(count=1))
    with pytest.raises(ConfigurationError, match="no scenarios"):
        observed(policy, LAB, [], Places(count=1))
    full = replace(LAB, obstacles=Obstacles(np.array([[0.0, 0.0, 6.0]])))
    corner = [Scenario("corner", (0, 0, 0), (4.8, 4.8))]
    for places in (Places(count=1), Places(spacing=0.5)):
        with pytest.raises(EmptyEvaluationError, match="no free place"):
            observed(policy, full, corner, places)
