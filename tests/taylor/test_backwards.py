"""Back-substitution: both engines' bounds hold exact values, are as tight as each other, and need every rule."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from tests.taylor.compiled import (
    BENT,
    STRAIGHT,
    Floats,
    branched,
    escape,
    escape_of_bounds,
    kernel_over,
    layered,
)
from viatool.engine.calls import call
from viatool.policy.activations import ActivationFunction, activation
from viatool.policy.network import Activation, Affine, Input, Network
from viatool.taylor import backwards
from viatool.taylor.curve import curve_of
from viatool.taylor.propagation import Box, propagate

Bounds = Callable[[Network, Floats, Floats], tuple[Floats, Floats]]
LEAKY = STRAIGHT[1]


def by_numpy(network: Network, lower: Floats, upper: Floats) -> tuple[Floats, Floats]:
    with np.errstate(over="ignore", invalid="ignore"):  # as `reach` has it
        passes = propagate(network, Box(lower, upper))
        return backwards.hull_backwards(network, [enclosure.hull for enclosure in passes])


def by_the_kernel(**allowances: float) -> Bounds:
    def bounds(network: Network, lower: Floats, upper: Floats) -> tuple[Floats, Floats]:
        low, high = np.empty((2, len(lower), network.output_size))
        done = np.zeros(len(lower), dtype=bool)
        call(
            "viatool_back",
            kernel_over(network, **allowances).packed,
            len(lower),
            lower,
            upper,
            low,
            high,
            done,
        )
        assert done.all()
        return low, high

    return bounds


ENGINES = pytest.mark.parametrize("bounds", [by_numpy, by_the_kernel()], ids=["numpy", "compiled"])


def escape_at(bounds: Bounds, network: Network, centre: Floats, eps: float, seed: int = 0) -> float:
    lower, upper = centre - eps, centre + eps
    return escape_of_bounds(network, lower, upper, bounds(network, lower, upper), seed)


# --- soundness -------------------------------------------------------------------------------------------


@ENGINES
@pytest.mark.parametrize("hidden", [*STRAIGHT, *BENT], ids=lambda function: function.name)
def test_bounds_hold_the_exact_actions(bounds: Bounds, hidden: ActivationFunction) -> None:
    rng = np.random.default_rng(0)
    networks = [layered(rng, 4, 6, 5, 2, hidden=hidden)]
    if hidden in STRAIGHT:
        networks += [branched(rng, hidden), layered(rng, 3, 5, 2, hidden=hidden, scale=30.0, last=True)]
    for network in networks:
        centre = rng.normal(size=(1, network.input_size))
        for eps in (0.0, 1e-8, 0.05, 0.5, 8.0):
            assert escape_at(bounds, network, centre, eps) == 0.0


@ENGINES
@pytest.mark.parametrize("scale", [1e-300, 1e-160, 1e60])
def test_bounds_hold_where_numbers_are_tiny_or_huge(bounds: Bounds, scale: float) -> None:
    for seed in range(2):
        rng = np.random.default_rng(seed)
        network = layered(rng, 3, 5, 4, 2, hidden=LEAKY, scale=scale)
        for eps in (0.0, scale, 5e-324):
            assert escape_at(bounds, network, rng.normal(size=(2, 3)) * scale, eps, seed) == 0.0


@pytest.mark.parametrize(
    "hidden", [STRAIGHT[0], STRAIGHT[4], BENT[0], BENT[1]], ids=lambda function: function.name
)
def test_hulls_that_were_met_hold_every_node(hidden: ActivationFunction) -> None:
    rng = np.random.default_rng(1)
    for network in (layered(rng, 4, 8, 7, 6, 2, hidden=hidden), branched(rng, hidden)):
        centre = rng.normal(size=(2, 4))
        for eps in (1e-8, 0.1, 1.0):
            assert escape(kernel_over(network), centre - eps, centre + eps, backwards=True) == 0.0


def test_a_layer_that_reads_nothing_is_a_constant() -> None:
    """Which numpy does alone."""
    hidden = Affine((), (), np.linspace(-1.0, 2.0, 64))
    network = Network(
        (
            Input(2),
            hidden,
            Activation(1, activation("Relu"), 64),
            Affine((2,), (np.ones((1, 64)),), np.zeros(1)),
        )
    )
    lower, upper = by_numpy(network, np.full((3, 2), -0.1), np.full((3, 2), 0.1))
    exact = np.maximum(hidden.bias, 0.0).sum()
    assert (lower <= exact).all()
    assert (upper >= exact).all()
    assert (upper - lower < 1e-9).all()


@ENGINES
def test_what_overflows_proves_nothing(bounds: Bounds) -> None:
    """Weights of both signs with infinite products give a row that is not a number at a ReLU."""
    nodes = (
        Input(1),
        Affine((0,), (np.ones((1, 1)),), np.zeros(1)),
        Activation(1, STRAIGHT[0], 1),
        Affine((2,), (np.array([[2e200], [-1e200]]),), np.zeros(2)),
        Affine((3,), (np.full((1, 2), 1e109),), np.zeros(1)),
    )
    _, high = bounds(Network(nodes), np.zeros((1, 1)), np.full((1, 1), 1e-200))
    assert not (high < 1e108).any()  # it grows up to 1e109


# --- tightness -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("hidden", [*STRAIGHT, *BENT[:3]], ids=lambda function: function.name)
def test_both_engines_are_as_tight(hidden: ActivationFunction) -> None:
    rng = np.random.default_rng(2)
    network = layered(rng, 5, 10, 9, 3, hidden=hidden)
    centre = rng.normal(size=(4, 5))
    for eps in (0.01, 0.3):
        widths = [
            float(np.subtract(*bounds(network, centre - eps, centre + eps)[::-1]).sum())
            for bounds in (by_numpy, by_the_kernel())
        ]
        np.testing.assert_allclose(widths[1], widths[0], rtol=0.02)


def test_following_neurons_back_is_tighter_where_many_are_undecided() -> None:
    rng = np.random.default_rng(3)
    network = layered(rng, 6, 64, 64, 2, hidden=STRAIGHT[0])
    centre = rng.normal(size=(8, 6))
    kernel = kernel_over(network)
    forward, both = (
        kernel.bound(centre - 0.1, centre + 0.1, backwards=asked).bound.reshape(2, -1).sum()
        for asked in (False, True)
    )
    assert both < 0.97 * forward


# --- every rule is needed --------------------------------------------------------------------------------


def escape_of_sums(bounds: Bounds) -> float:
    rng = np.random.default_rng(0)
    network = layered(rng, 4, 6, 5, 2, hidden=STRAIGHT[0])
    return escape_at(bounds, network, rng.normal(size=(8, 4)), 0.0)


def escape_of_curves(bounds: Bounds) -> float:
    nodes = (Input(8), Activation(0, activation("Mish"), 8))
    return escape_at(bounds, Network(nodes), np.random.default_rng(0).normal(size=(3, 8)), 0.0)


def escape_of_underflow(bounds: Bounds) -> float:
    network = layered(np.random.default_rng(0), 3, 4, 2, hidden=LEAKY, scale=1e-200)
    plain = (
        Affine(node.sources, node.weights, 0 * node.bias) if isinstance(node, Affine) else node
        for node in network.nodes
    )
    return escape_at(bounds, Network(tuple(plain)), np.full((1, 3), 1e-170), 0.0)


def escape_of_shifts(bounds: Bounds) -> float:
    rng = np.random.default_rng(3)
    return escape_at(bounds, layered(rng, 4, 8, 2, hidden=STRAIGHT[0]), rng.normal(size=(2, 4)), 1.0)


@pytest.mark.parametrize(
    ("allowance", "check"),
    [
        ("back", escape_of_sums),
        ("lines", escape_of_curves),
        ("underflow", escape_of_underflow),
        ("errors", escape_of_shifts),
    ],
)
def test_every_allowance_is_needed(allowance: str, check: Callable[[Bounds], float]) -> None:
    assert check(by_the_kernel()) == 0.0
    assert check(by_the_kernel(**{allowance: 0.0})) > 0.0


def wrong_sums() -> float:
    return escape_of_sums(by_numpy)


def wrong_underflow() -> float:
    return escape_of_underflow(by_numpy)


def wrong_shifts() -> float:
    return escape_of_shifts(by_numpy)


def wrong_lines() -> float:
    """Return how far curves leave the lines around them."""
    rng, worst = np.random.default_rng(4), 0.0
    for function in (STRAIGHT[0], STRAIGHT[2], BENT[0], BENT[1]):
        lower = rng.normal(size=(40, 1)) * 2
        upper = lower + rng.uniform(size=(40, 1))
        x = np.linspace(lower, upper, 33)
        (rise, above), (fall, below) = backwards.lines_around(curve_of(function), lower, upper)
        value = function(x)
        worst = max(worst, float(np.maximum(value - rise * x - above, fall * x + below - value).max()))
    return max(worst - 1e-12, 0.0)


def test_curves_lie_between_their_lines() -> None:
    assert wrong_lines() == 0.0
