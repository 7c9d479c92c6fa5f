"""Branch and bound with dual bounds: exact extrema where they can be known, and what its rules are needed for."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import viatool.taylor.duality as duality
import viatool.taylor.parts as parts
import viatool.taylor.splitting as splitting
from tests.attacks import milp_maximum
from viatool.errors import BoundsError
from viatool.policy.activations import activation
from viatool.policy.network import Activation, Affine, Input, Network
from viatool.taylor import ReachableSet, reach
from viatool.taylor.propagation import Box

Floats = NDArray[np.float64]

EPS = 0.1
STATES = np.random.default_rng(5).uniform(-1, 1, (4, 6))


def network_of(name: str, sizes: tuple[int, ...] = (6, 14, 14, 2), seed: int = 1) -> Network:
    random = np.random.default_rng(seed)
    nodes: list[Input | Affine | Activation] = [Input(sizes[0])]
    for before, after in pairwise(sizes):
        weight = random.normal(size=(after, before)) * np.sqrt(2 / before)
        nodes.append(Affine((len(nodes) - 1,), (weight,), 0.1 * random.normal(size=after)))
        nodes.append(Activation(len(nodes) - 1, activation(name), after))
    return Network(tuple(nodes[:-1]))


def split(network: Network, **options: float) -> ReachableSet:
    policy = SimpleNamespace(network=network, spec=None)
    return reach(policy, STATES, EPS, refine="split", arithmetic="real", **options)  # type: ignore[arg-type]


def escape(sets: ReachableSet, network: Network) -> float:
    """Return how far exact extrema of a ReLU network stick out of its bounds."""
    worst = -np.inf
    for row, state in enumerate(STATES):
        for action in range(2):
            for sign, bound in ((1.0, sets.upper[row, action]), (-1.0, -sets.lower[row, action])):
                seed = sign * np.eye(2)[action]
                worst = max(worst, milp_maximum(network, state - EPS, state + EPS, seed) - bound)
    return worst


def test_bounds_hold_and_are_exact_up_to_the_tolerance() -> None:
    network = network_of("Relu")
    sets = split(network, tolerance=1e-6, most_parts=2000)
    assert escape(sets, network) <= 1e-6  # the tolerance of the solver
    assert (sets.width - sets.attained_width <= 2e-5 * sets.attained_width).all()


@pytest.mark.parametrize("name", ["Relu", "LeakyRelu", "Abs", "Tanh", "Silu", "HardSwish", "Elu"])
def test_splitting_only_tightens_and_keeps_every_sampled_action_inside(name: str) -> None:
    network = network_of(name)
    policy = SimpleNamespace(network=network, spec=None)
    loose = reach(policy, STATES, EPS, refine="none", arithmetic="real")
    tight = split(network, most_parts=64)
    assert (tight.lower >= loose.lower).all()
    assert (tight.upper <= loose.upper).all()
    errors = np.random.default_rng(2).choice([-1.0, -0.3, 0.4, 1.0], (len(STATES), 20_000, 6)) * EPS
    actions = network((STATES[:, None] + errors).reshape(-1, 6)).reshape(len(STATES), -1, 2)
    assert (actions.max(axis=1) <= tight.upper).all()
    assert (actions.min(axis=1) >= tight.lower).all()
    assert (tight.attained_upper <= tight.upper).all()
    assert (tight.attained_lower >= tight.lower).all()


def test_it_stops_at_its_effort_with_a_bound_that_holds() -> None:
    network = network_of("Relu", (6, 30, 30, 2), seed=4)
    few, many = split(network, most_parts=4), split(network, most_parts=400)
    assert (few.width >= many.width - 1e-12).all()
    assert few.width.sum() > 1.001 * many.width.sum()
    assert escape(few, network) <= 1e-6


def _lower_halves_only(original: Callable[..., parts.BoxParts]) -> Callable[..., parts.BoxParts]:
    def halves(self: parts.BoxParts) -> parts.BoxParts:
        both = original(self)
        return both.rows(np.arange(both.owner.size // 2))

    return halves


def _without_slack(original: Callable[..., duality.DualProblem]) -> Callable[..., duality.DualProblem]:
    def of(*given: object) -> duality.DualProblem:
        problem = original(*given)
        return replace(problem, slack=problem.slack - 0.05)

    return of


def _any_sign(original: Callable[..., Floats]) -> Callable[..., Floats]:
    def median(form: Floats, direction: Floats, slope: Floats) -> Floats:
        return original(form, direction, slope) - 0.5

    return median


def test_no_exact_extremum_escapes() -> None:
    network = network_of("Relu")
    assert escape(split(network), network) <= 1e-6


@pytest.mark.parametrize(
    ("place", "name", "mutant"),
    [
        (parts.BoxParts, "halves", _lower_halves_only),
        (duality.DualProblem, "of", _without_slack),
        (duality, "_weighted_median", _any_sign),
        (splitting, "largest_of_each", lambda original: lambda parts, count: original(parts, 1) & False),
    ],
    ids=["upper halves dropped", "conditions too strict", "negative multipliers", "waiting parts forgotten"],
)
@pytest.mark.usefixtures("numpy_engine")
def test_a_broken_rule_lets_an_exact_extremum_escape(
    place: object, name: str, mutant: Callable[..., object], monkeypatch: pytest.MonkeyPatch
) -> None:
    network = network_of("Relu")
    monkeypatch.setattr(place, name, mutant(getattr(place, name)))
    with suppress(BoundsError):  # which the engine itself notices
        assert escape(split(network), network) > 1e-6


@pytest.mark.parametrize("shift", [0.0, 0.1, 0.15, 0.2])
def test_a_part_without_a_point_is_empty_however_its_hulls_cross(shift: float) -> None:
    """x is at most -1 for one neuron and at least 1 for another: their sum over all x shows that it cannot be."""
    layers = (
        Affine((0,), (np.ones((2, 1)),), np.zeros(2)),
        Activation(1, activation("Gelu"), 2),
        Affine((2,), (np.array([[1.0, 0.1]]),), np.full(1, shift)),
        Activation(3, activation("Sigmoid"), 1),
    )
    network = Network((Input(1), *layers))
    extrema: Any = SimpleNamespace(box=Box(np.array([[-2.0]]), np.array([[2.0]])), seed=np.ones((1, 1)))
    here = parts.BoxParts(
        np.zeros(1, np.int64), np.array([[2, 2]]), np.array([[0, 1]]), np.array([[-1, 1]]),
        np.array([[-1.0, 1.0]]), np.full(1, np.inf), np.zeros(1, np.int64), np.zeros(1, np.int64), np.zeros(1),
    )  # fmt: skip
    examined, _ = parts._by_numpy(network, extrema, here, None, "chebyshev")
    assert examined.bound.tolist() == [-np.inf]


def test_a_maximum_over_no_symbols_is_its_constant() -> None:
    """As of an action that depends on no input that is free, under a condition on it."""
    problem = duality.DualProblem(
        np.zeros((2, 0)), np.array([1.0, -2.0]), np.zeros((2, 1, 0)), np.ones((2, 1))
    )
    for multipliers in (duality.descend(problem), duality.solve_exactly(problem)[0]):
        _, values = problem.value(multipliers)
        np.testing.assert_allclose(values, problem.constant, rtol=1e-12)
