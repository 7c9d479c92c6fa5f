"""The core of a piecewise linear network over a box: sound, as tight as branch and bound, left where there is none."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from tests.taylor.compiled import BENT, STRAIGHT, branched, escape, kernel_over, layered
from viatool.policy.activations import ActivationFunction
from viatool.policy.network import Activation, Affine, Input, Network
from viatool.taylor import reach

SPLITTING = {
    "rounds": 4,
    "sweeps": 4,
    "neurons": 24,
    "climbs": 4,
    "parts": 40,
    "exactly": 1,
    "tolerance": 1e-3,
}
RELU, LEAKY = STRAIGHT[:2]


@pytest.mark.parametrize("hidden", STRAIGHT, ids=lambda function: function.name)
def test_bounds_hold_the_exact_values(hidden: ActivationFunction) -> None:
    settled = []
    for seed in range(2):
        rng = np.random.default_rng(seed)
        for network in (layered(rng, 4, 8, 7, 2, hidden=hidden), branched(rng, hidden)):
            for eps in (0.0, 1e-9, 0.02, 0.2):
                centre, kernel = rng.normal(size=(1, 4)), kernel_over(network)
                settled.append(kernel.bound(centre - eps, centre + eps, **SPLITTING).settled)
                assert escape(kernel, centre - eps, centre + eps, seed, **SPLITTING) == 0.0
    assert np.mean(settled) > 0.8


@pytest.mark.parametrize("scale", [1e-300, 1e-160, 1e-30, 1e30, 1e100])
def test_bounds_hold_where_numbers_are_tiny_or_huge(scale: float) -> None:
    for seed in range(2):
        rng = np.random.default_rng(seed)
        network = layered(rng, 3, 5, 5, 2, hidden=LEAKY, scale=scale if scale < 1e60 else 1e60)
        for eps in (0.0, scale, 5e-324):
            centre = rng.normal(size=(2, 3)) * scale
            assert escape(kernel_over(network), centre - eps, centre + eps, seed, **SPLITTING) == 0.0


def cancelling() -> Network:
    """Return a network of decided neurons whose weights add up to -1 together, to 2 as float64 adds them."""
    ones = np.ones((5, 1))
    weights = np.array([[1e16, -1.0, -1.0, -1.0, 2.0 - 1e16]])
    return Network(
        (
            Input(1),
            Affine((0,), (ones,), np.zeros(5)),
            Activation(1, RELU, 5),
            Affine((2,), (weights,), np.zeros(1)),
            Affine((3,), (np.ones((1, 1)),), np.zeros(1)),
        )
    )


@pytest.mark.parametrize("allowance", ["core"])
def test_every_allowance_is_needed(allowance: str) -> None:
    lower, upper = np.array([[1.0]]), np.array([[2.0]])
    assert escape(kernel_over(cancelling()), lower, upper, **SPLITTING) == 0.0
    assert escape(kernel_over(cancelling(), **{allowance: 0.0}), lower, upper, **SPLITTING) > 0.5


def test_constants_that_cancel_are_covered() -> None:
    nodes = list(cancelling().nodes)
    nodes[1] = Affine((0,), (np.zeros((5, 1)),), np.ones(5))
    kernel = kernel_over(Network(tuple(nodes)))
    lower, upper = np.array([[1.0]]), np.array([[2.0]])
    assert escape(kernel, lower, upper, **SPLITTING) == 0.0
    assert escape(kernel_over(Network(tuple(nodes)), core=0.0), lower, upper, **SPLITTING) > 0.5


def test_splitting_ends_at_what_is_attained() -> None:
    rng = np.random.default_rng(5)
    network = layered(rng, 5, 20, 20, 2, hidden=RELU)
    centre = rng.normal(size=(6, 5))
    found = kernel_over(network).bound(centre - 0.1, centre + 0.1, **{**SPLITTING, "parts": 400})
    assert found.settled.all()
    assert (found.bound - found.found <= 2e-3 * (1 + np.abs(found.found))).all()
    rows = np.tile(centre, (4, 1))
    assert (np.abs(found.points - rows) <= 0.1 + 1e-12).all()
    values = (network(found.points) * np.repeat(np.concatenate([np.eye(2), -np.eye(2)]), 6, axis=0)).sum(
        axis=1
    )
    np.testing.assert_allclose(found.found, values, rtol=0, atol=1e-12)


def test_a_box_where_most_neurons_are_undecided_has_no_core() -> None:
    rng = np.random.default_rng(6)
    network = layered(rng, 5, 20, 20, 2, hidden=RELU)
    centre = rng.normal(size=(3, 5))
    assert not kernel_over(network).bound(centre - 30, centre + 30, **SPLITTING).settled.any()
    assert (
        not kernel_over(layered(rng, 5, 8, 2, hidden=BENT[0]))
        .bound(centre, centre, **SPLITTING)
        .settled.any()
    )
    policy = SimpleNamespace(network=network, spec=None)
    one, more = (reach(policy, centre, 30.0, refine=refine).width.sum() for refine in ("none", "split"))
    assert more < one
