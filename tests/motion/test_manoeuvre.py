from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.safety.brute_force import drive, drive_and_stop
from viatool.motion.kinematics import DIFFERENTIAL
from viatool.motion.manoeuvre import Manoeuvre

numbers = st.floats(-3.0, 3.0)


@settings(deadline=None)
@given(numbers, numbers, numbers, numbers, st.floats(-2.0, 2.0), st.floats(0.0, 2.0))
def test_arcs_agree_with_the_difference_of_sines(x, y, theta, omega, v, seconds):
    moved = DIFFERENTIAL.advance(np.array([x, y, theta]), np.array([v, omega]), seconds)
    expected = drive((x, y, theta), v, omega, np.array(seconds))
    np.testing.assert_allclose(moved[:2], expected[:2], atol=1e-8)
    np.testing.assert_allclose(np.exp(1j * moved[2]), np.exp(1j * expected[2]), atol=1e-8)


@pytest.mark.parametrize("omega", [0.0, 1e-300, 1e-17, 1e-9, 1e-5])
def test_small_turns_lose_no_digits(omega):
    moved = DIFFERENTIAL.advance(np.zeros(3), np.array([0.5, omega]), 0.1)
    np.testing.assert_allclose(moved, [0.05, 0.5 * 0.05 * 0.1 * omega, 0.1 * omega], rtol=1e-12, atol=0.0)


def test_shapes_broadcast():
    moved = DIFFERENTIAL.advance(np.zeros((4, 1, 1, 3)), np.ones((4, 9, 1, 2)), np.linspace(0, 1, 5))
    assert moved.shape == (4, 9, 5, 3)


@settings(deadline=None)
@given(st.floats(-1.0, 1.0), numbers, st.floats(0.0, 0.5))
def test_braking_covers_the_path_of_a_simulated_stop(v, omega, rim):
    pose, action = np.array([1.0, -2.0, 0.7]), np.array([v, omega])
    stopped = drive_and_stop(pose[None], *action[:, None], 0.1, 0.8, rim, steps=200)[0, -1]
    end = Manoeuvre(0.1, 0.8, rim).path(pose, action, np.ones(()))
    np.testing.assert_allclose(end[:2], stopped[:2], atol=2e-4)
    np.testing.assert_allclose(np.exp(1j * end[2]), np.exp(1j * stopped[2]), atol=2e-4)


def test_no_path_over_a_box_is_longer_than_the_bound():
    generator = np.random.default_rng(1)
    manoeuvre = Manoeuvre(0.1, 0.8, 0.3)
    lower, upper = np.array([-0.4, -1.0]), np.array([0.2, 2.0])
    actions = generator.uniform(lower, upper, (2000, 2))
    seconds = manoeuvre.seconds(np.abs(actions[:, 0]), np.abs(actions[:, 1]))
    assert (np.abs(actions[:, 0]) * seconds).max() <= manoeuvre.longest(lower, upper)
