"""Gradient bounds contain true gradients; collapsed boxes keep the maximum; attained values are attained."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from tests.attacks import gradient as searched_gradient
from tests.attacks import sample
from tests.strategies import ACTIVATIONS, TOPOLOGIES, NetworkPlan, network_plans
from tests.taylor.containment import escape_of_gradients
from viatool.policy.activations import activation
from viatool.policy.network import Activation, Affine, Input, Maximum, Minimum, Network
from viatool.taylor.derivatives import gradient, gradient_bounds
from viatool.taylor.propagation import Box, propagate
from viatool.taylor.refinement import collapse_monotone

Floats = NDArray[np.float64]


def hulls_over(network: Network, lower: Floats, upper: Floats) -> list[tuple[Floats, Floats]]:
    return [enclosure.hull for enclosure in propagate(network, Box(lower, upper))]


def seeds(batch: int, actions: int, action: int) -> Floats:
    seed = np.zeros((batch, actions))
    seed[:, action] = 1.0
    return seed


JUMPING = {"ThresholdedRelu", "HardShrink", "Sign", "Threshold", "SoftplusThreshold"}
CONTINUOUS = tuple(function for function in ACTIVATIONS if function.name not in JUMPING)


@settings(max_examples=25, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
@given(
    plan=network_plans(
        activations=CONTINUOUS, scales=("plain", "wide", "sparse"), most_inputs=3, most_layers=3, most_width=6
    ),
    radius=st.sampled_from([0.0, 1e-9, 0.01, 0.3]),
)
def test_bounds_contain_true_gradients(plan: NetworkPlan, radius: float) -> None:
    network = plan.build()
    rng = np.random.default_rng(plan.seed)
    centre = rng.normal(size=(2, plan.inputs))
    assert escape_of_gradients(network, centre - radius, centre + radius) == 0


@pytest.mark.parametrize("topology", TOPOLOGIES)
def test_the_float_gradient_agrees_with_central_differences(topology: str) -> None:
    functions = tuple(activation(name) for name in ("Tanh", "Silu", "Relu"))
    network = NetworkPlan(5, 4, 7, 2, functions, topology).build()
    points = np.random.default_rng(3).normal(size=(50, 4))
    for action in range(2):
        seed = seeds(50, 2, action)
        np.testing.assert_allclose(
            gradient(network, points, seed), searched_gradient(network, points, seed), rtol=1e-4, atol=1e-6
        )


def test_at_a_kink_every_generalised_derivative_counts() -> None:
    network = Network((Input(1), Activation(0, activation("Relu"), 1)))
    zero = np.zeros((1, 1))
    low, high = gradient_bounds(network, hulls_over(network, zero, zero), np.ones((1, 1)))
    assert low[0, 0] <= 0.0
    assert high[0, 0] >= 1.0


@pytest.mark.parametrize("kind", [Maximum, Minimum])
def test_the_derivative_of_an_extremum_is_that_of_the_selected_side(kind: type) -> None:
    left, right = np.array([[1.0, 0.0]]), np.array([[-1.0, 1.0]])
    network = Network(
        (Input(2), Affine((0,), (left,), np.zeros(1)), Affine((0,), (right,), np.zeros(1)), kind(1, 2, 1))
    )
    lower, upper = np.array([[-0.1, 4.9]]), np.array([[0.1, 5.1]])
    low, high = gradient_bounds(network, hulls_over(network, lower, upper), np.ones((1, 1)))
    expected = right if kind is Maximum else left
    np.testing.assert_allclose(low, expected, atol=1e-12)
    np.testing.assert_allclose(high, expected, atol=1e-12)


@pytest.mark.parametrize("name", sorted(JUMPING))
def test_over_a_jump_nothing_is_monotone(name: str) -> None:
    function = next(f for f in ACTIVATIONS if f.name == name)
    jump = max(value for key, value in (*function.parameters, ("", 0.0)) if key != "value")
    network = Network((Input(1), Activation(0, function, 1)))
    lower, upper = np.array([[jump - 1e-9]]), np.array([[jump + 1e-9]])
    with np.errstate(all="ignore"):
        low, high = gradient_bounds(network, hulls_over(network, lower, upper), np.ones((1, 1)))
    assert not (low[0, 0] > -np.inf and high[0, 0] < np.inf)


@settings(max_examples=40, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
@given(
    plan=network_plans(scales=("plain", "wide", "sparse"), most_inputs=4, most_layers=3, most_width=10),
    radius=st.sampled_from([0.01, 0.1, 0.5]),
)
def test_a_collapsed_box_keeps_the_maximum(plan: NetworkPlan, radius: float) -> None:
    network = plan.build()
    rng = np.random.default_rng(plan.seed)
    centre = rng.normal(size=(4, plan.inputs))
    lower, upper = centre - radius, centre + radius
    seed = seeds(4, plan.actions, 0)
    with np.errstate(all="ignore"):
        face = collapse_monotone(network, Box(lower, upper), hulls_over(network, lower, upper), seed)
    assert ((face.lower >= lower) & (face.upper <= upper)).all()
    points = sample(lower, upper, 64, rng)
    projected = np.clip(
        points, face.lower, face.upper
    )  # onto the face: never lower, if the collapse is right
    for before, after in zip(points, projected, strict=True):
        value, moved = network(before)[:, 0], network(after)[:, 0]
        assert (moved >= value - 1e-9 * (1 + np.abs(value))).all()
