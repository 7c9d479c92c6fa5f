"""Curvature as squares: bounds hold against exact values and fractions, and are tight where nothing else fits."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from fractions import Fraction
from itertools import product
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from numpy.typing import NDArray

from tests import oracles
from tests.strategies import BoxPlan, NetworkPlan, box_plans, network_plans
from tests.taylor.containment import _points as points_of
from tests.taylor.test_mutants import BOTH, SQUARE, TANH, Mutant, chain, mutated
from tests.taylor.test_wide import most_symbols
from viatool.errors import EnclosureError
from viatool.policy.network import Network
from viatool.taylor.propagation import Box, propagate
from viatool.taylor.squares import SquareProblem, spectral_norm

Floats = NDArray[np.float64]


def escape_of_squares(network: Network, centre: Any, eps: Any, *, symbols: int | None = None) -> float:
    """Return how far an exact action leaves the bounds by squares over boxes; 0 if none does."""
    centre = np.atleast_2d(np.array(centre, dtype=np.float64))
    eps = np.broadcast_to(np.asarray(eps, dtype=np.float64), centre.shape)
    seeds = np.concatenate([np.eye(network.output_size), -np.eye(network.output_size)])
    with np.errstate(all="ignore"), most_symbols(symbols) if symbols else nullcontext():
        passes = propagate(network, Box(centre - eps, centre + eps))
        asked = np.broadcast_to(seeds, (centre.shape[0], *seeds.shape))
        bound = SquareProblem.of(network, passes, asked, neurons=64, rule="chebyshev").upper()
    points = points_of(network, centre, eps, np.random.default_rng(13), 40)
    values = network(points.reshape(-1, points.shape[2])).reshape(*points.shape[:2], -1) @ seeds.T
    worst = 0.0
    for b, q in product(range(centre.shape[0]), range(len(seeds))):
        point = points[values[:, b, q].argmax(), b].tolist()
        exact = oracles.precise(network, point)
        gap = sum(oracles.MP.mpf(s) * v for s, v in zip(seeds[q], exact, strict=True)) - oracles.MP.mpf(
            bound[b, q]
        )
        worst = max(worst, float(gap)) if gap > 0 else worst  # a bound that is not a number says nothing
    return worst


@given(network_plans(most_inputs=5, most_layers=3, most_width=12), box_plans(most_batch=2))
@settings(max_examples=30, deadline=None, suppress_health_check=list(HealthCheck))
def test_no_action_escapes(plan: NetworkPlan, boxes: BoxPlan) -> None:
    network = plan.build()
    try:
        assert escape_of_squares(network, *boxes.build(plan.inputs)) == 0
    except EnclosureError:
        return


def random_problem(rng: np.random.Generator, symbols: int, squares: int) -> SquareProblem:
    """One question with weights of both signs."""
    linear = rng.normal(size=(1, 1, symbols)) * 10.0 ** rng.integers(-3, 2)
    weights = rng.normal(size=(1, 1, squares)) * 10.0 ** rng.integers(-3, 2)
    forms = rng.normal(size=(1, squares, symbols))
    return SquareProblem(np.zeros((1, 1)), linear, weights, forms, np.zeros((1, 1)))


def exact_value(problem: SquareProblem, corner: list[int]) -> Fraction:
    """Evaluate a problem of one question at a corner of its cube, as a fraction."""

    def dot(form: Floats) -> Fraction:
        return sum((Fraction(c) * y for c, y in zip(form.tolist(), corner, strict=True)), Fraction(0))

    squares = zip(problem.weights[0, 0].tolist(), problem.forms[0], strict=True)
    return dot(problem.linear[0, 0]) + sum(
        (Fraction(weight) * dot(form) ** 2 for weight, form in squares), Fraction(0)
    )


def escape_of_problems(symbols: int, squares: int) -> float:
    """Return how far a corner of some cube exceeds its bound."""
    worst, rng = 0.0, np.random.default_rng([symbols, squares])
    for _ in range(30):
        problem = random_problem(rng, symbols, squares)
        bound = Fraction(float(problem.upper()[0, 0]))
        signs = np.where(problem.linear[0, 0] >= 0, 1, -1).tolist()
        corners = [list(c) for c in product((-1, 1), repeat=symbols)] if symbols <= 6 else [signs]
        worst = max(worst, *(float(exact_value(problem, corner) - bound) for corner in corners))
    return worst


@pytest.mark.parametrize(("symbols", "squares"), [(1, 1), (3, 2), (6, 4), (6, 0), (40, 0)])
def test_no_corner_of_a_cube_exceeds_the_bound(symbols: int, squares: int) -> None:
    assert escape_of_problems(symbols, squares) <= 0


def test_a_monotone_quadratic_is_bounded_nearly_exactly() -> None:
    rng = np.random.default_rng(4)
    forms = rng.normal(size=(1, 20, 60)) / 8
    linear = 40 * np.sign(rng.normal(size=(1, 1, 60)))
    problem = SquareProblem(np.zeros((1, 1)), linear, rng.normal(size=(1, 1, 20)), forms, np.zeros((1, 1)))
    attained = float(exact_value(problem, np.sign(linear[0, 0]).astype(int).tolist()))
    assert float(problem.upper()[0, 0]) - attained <= 1e-9 * attained


@pytest.mark.parametrize("size", [1, 5, 64])
def test_the_spectral_norm_is_bounded_from_above_and_not_far(size: int) -> None:
    matrices = np.random.default_rng(size).normal(size=(7, size, size))
    exact = np.linalg.norm(matrices, 2, axis=(-2, -1))
    assert (spectral_norm(matrices) >= exact * (1 - 1e-12)).all()
    assert (spectral_norm(matrices) <= 1.01 * exact * size ** (1 / 16)).all()
    assert (spectral_norm(np.zeros((2, 3, 3))) == 0).all()


TWICE = chain(1, ([[1.0]], [1.0]), SQUARE, ([[1.0]], [-1.0]), SQUARE, BOTH)


def squares(network: Network, centre: Any, eps: float, symbols: int | None = None) -> Callable[[], float]:
    """Check exact values against the bounds by squares."""
    return lambda: escape_of_squares(network, centre, eps, symbols=symbols)


MUTANTS = [
    Mutant(
        squares(chain(1, ([[1.0]], [1.25]), TANH, BOTH), [[0.0]], 0.5),
        "squares.SquareProblem._traded",
        "polynomial.error.reshape(lower.shape) + result_spare",
        "result_spare",
    ),
    Mutant(
        lambda: escape_of_problems(6, 4),
        "squares.SquareProblem._norms",
        "spectral_norm(forms @ np.swapaxes(forms, 1, 2)) + rounding",
        "1.0",
    ),
    Mutant(
        squares(TWICE, [[0.0]], 0.5, symbols=1),
        "squares.SquareProblem._traded",
        "+ result_spare\n    error = error + np.abs(slope) * spare + np.abs(bend) * spare * (2 * norm + spare)",
        "",
    ),
    Mutant(
        lambda: escape_of_problems(40, 0),
        "squares.SquareProblem.upper",
        "gamma(terms, ENGINE_ROUNDOFF) * size",
        "0 * size",
    ),
]


@pytest.mark.parametrize("mutant", MUTANTS, ids=str)
def test_every_rule_is_needed(mutant: Mutant) -> None:
    assert mutant.check() <= 0
    with mutated(mutant):
        assert mutant.check() > 0
