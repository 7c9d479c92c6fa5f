"""The symbolic view: a polynomial in named sensor errors that really encloses the action."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
import sympy

from viatool.errors import ConfigurationError
from viatool.policy.activations import activation
from viatool.policy.network import Activation, Affine, Input, Network
from viatool.taylor import symbolic_actions


def small_policy(seed: int = 3) -> SimpleNamespace:
    random = np.random.default_rng(seed)
    nodes = [
        Input(3),
        Affine((0,), (random.normal(size=(6, 3)),), random.normal(size=6)),
        Activation(1, activation("Tanh"), 6),
        Affine((2,), (random.normal(size=(2, 6)),), random.normal(size=2)),
    ]
    return SimpleNamespace(network=Network(tuple(nodes)), spec=None)


@pytest.mark.parametrize("order", [1, 2, 3])
def test_the_action_stays_within_the_remainder_of_the_polynomial(order: int) -> None:
    policy, observation, eps = small_policy(), np.array([0.3, -0.2, 0.5]), np.array([0.1, 0.2, 0.05])
    actions = symbolic_actions(policy, observation, eps, order=order, arithmetic="real")
    errors = np.random.default_rng(0).uniform(-eps, eps, (2000, 3))
    outputs = policy.network(observation + errors)
    symbols = sympy.symbols("d_x0 d_x1 d_x2", real=True)
    for index, action in enumerate(actions):
        polynomial = sympy.lambdify(symbols, action.polynomial)(*errors.T)
        assert (np.abs(outputs[:, index] - polynomial) <= action.remainder).all()


def test_a_higher_order_leaves_a_smaller_remainder() -> None:
    remainders = [
        symbolic_actions(small_policy(), np.zeros(3), 0.1, order=order, arithmetic="real")[0].remainder
        for order in (1, 2, 3)
    ]
    assert remainders[0] > 2 * remainders[1] > 4 * remainders[2]


def test_the_entry_with_the_largest_slope_comes_first() -> None:
    weight = np.array([[0.5, -2.0, 1.0]])
    network = Network((Input(3), Affine((0,), (weight,), np.zeros(1))))
    action = symbolic_actions(SimpleNamespace(network=network, spec=None), np.zeros(3), 0.1)[0]
    assert list(action.effect) == ["x1", "x2", "x0"]
    assert action.effect["x1"] == pytest.approx(0.2, rel=1e-6)


def test_several_rows_are_refused() -> None:
    with pytest.raises(ConfigurationError, match="2 observations"):
        symbolic_actions(small_policy(), np.zeros((2, 3)), 0.1)
