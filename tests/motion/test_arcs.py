from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from viatool.motion.arcs import wrap_angle
from viatool.motion.kinematics import DIFFERENTIAL


@pytest.mark.parametrize("omega", [0.0, 1e-9, 1e-5, 1e-3, 0.3, 1.0, -1.0, -4.0])
def test_arcs_solve_the_unicycle_equations(omega: float) -> None:
    pose, speed, time = np.array([0.3, -0.7, 0.4]), 0.5, 1.3
    expected = solve_ivp(
        lambda _, state: [speed * np.cos(state[2]), speed * np.sin(state[2]), omega],
        (0.0, time),
        pose,
        rtol=1e-12,
        atol=1e-12,
    ).y[:, -1]
    moved = DIFFERENTIAL.advance(pose, np.array([speed, omega]), time)
    assert moved[:2] == pytest.approx(expected[:2], abs=1e-10)
    assert moved[2] == pytest.approx(wrap_angle(expected[2:])[0], abs=1e-10)


def test_two_half_steps_are_one_step_for_any_turning_speed() -> None:
    rng = np.random.default_rng(0)
    poses = rng.uniform(-3, 3, (500, 3))
    turning = rng.choice([-1.0, 1.0], 500) * 10.0 ** rng.uniform(-12, 0.5, 500)
    actions = np.column_stack([rng.uniform(-0.5, 0.5, 500), turning])
    halves = DIFFERENTIAL.advance(DIFFERENTIAL.advance(poses, actions, 0.05), actions, 0.05)
    whole = DIFFERENTIAL.advance(poses, actions, 0.1)
    assert halves[:, :2] == pytest.approx(whole[:, :2], abs=1e-14)


def test_times_and_commands_are_broadcast() -> None:
    pose = np.zeros((4, 1, 3))
    actions = np.array([[0.5, 0.0], [0.5, 1.0]])
    assert DIFFERENTIAL.advance(pose, actions, np.full((4, 2), 0.1)).shape == (4, 2, 3)


def test_angles_are_wrapped_into_one_turn() -> None:
    angles = np.array([0.0, np.pi, -np.pi, 3.5 * np.pi, -7.0, 100.0])
    wrapped = wrap_angle(angles)
    assert ((wrapped > -np.pi) & (wrapped <= np.pi)).all()
    assert np.exp(1j * wrapped) == pytest.approx(np.exp(1j * angles))
