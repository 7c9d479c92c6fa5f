"""Every declared activation, its derivatives and its approximations, against high precision."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.oracles import MP, activate, derivative, kinks
from tests.strategies import ACTIVATIONS as OF_MODELS
from viatool.policy.activations import ActivationFunction, activation, declared_activations
from viatool.taylor.approximation import approximate
from viatool.taylor.curve import curve_of

Floats = NDArray[np.float64]

TAILS = (
    1e-300,
    1e-18,
    1e-9,
    1e-4,
    0.03,
    0.2,
    0.5,
    0.7,
    1.0,
    1.3,
    2.0,
    3.0,
    4.5,
    7.0,
    12.0,
    21.0,
    40.0,
    300.0,
    1e9,
)
ACTIVATIONS = (*OF_MODELS, activation("ClippedTan", min=-0.5, max=0.75))  # steering stands in no model
POSITIVE_ONLY = {"Log", "Reciprocal", "Sqrt"}
BESIDE = MP.mpf(10) ** -120


def named(function: ActivationFunction) -> str:
    return "-".join([function.name, *(f"{value:g}" for _, value in function.parameters)])


@cache
def samples(function: ActivationFunction, order: int) -> tuple[Floats, Floats, Floats]:
    """Return points and, at each, the smallest and largest value of a derivative, rounded inward."""
    points = {*TAILS, *(-x for x in TAILS), *kinks(function)}
    points |= {kink + side * gap for kink in kinks(function) for side in (-1, 1) for gap in (1e-15, 1e-7)}
    points.discard(0.0 if function.name in POSITIVE_ONLY else np.nan)
    if function.name in POSITIVE_ONLY:
        points = {x for x in points if x > 0}
    if function.name == "Exp":
        points = {x for x in points if abs(x) <= 300}
    if function.name == "Pow":
        points |= {0.0}
    x = np.array(sorted(points))
    lows, highs = [], []
    for point in x.tolist():
        near = [MP.mpf(point)]
        if point in kinks(function):
            with MP.workprec(900):
                near = [MP.mpf(point) - BESIDE, MP.mpf(point) + BESIDE]
        values = [derivative(function, p, order) for p in near]
        lows.append(_not_above(min(values)))
        highs.append(-_not_above(-max(values)))
    return x, np.array(lows), np.array(highs)


def _not_above(value: Any) -> float:
    """Return the largest float that is not above a value, give or take what the oracle itself errs by."""
    value = value + abs(value) * MP.mpf(10) ** -50 + MP.mpf(10) ** -60
    near = float(value)
    return near if MP.mpf(near) <= value else float(np.nextafter(near, -np.inf))


def test_every_declared_activation_is_tested() -> None:
    assert {function.name for function in ACTIVATIONS} == set(declared_activations())


def wrong_ranges(function: ActivationFunction, order: int) -> list[tuple[float, float]]:
    """Return the intervals on which the range of a derivative misses a value that is taken."""
    x, low, high = samples(function, order)
    first, last = np.triu_indices(x.size)
    found = curve_of(function).range(x[first], x[last], order)
    wrong = []
    for k, (i, j) in enumerate(zip(first.tolist(), last.tolist(), strict=True)):
        if found.lower[k] > low[i : j + 1].min() or found.upper[k] < high[i : j + 1].max():
            wrong.append((float(x[i]), float(x[j])))
    return wrong


@pytest.mark.parametrize("order", [0, 1, 2])
@pytest.mark.parametrize("function", ACTIVATIONS, ids=named)
def test_ranges_contain_the_function_and_its_derivatives(function: ActivationFunction, order: int) -> None:
    assert not wrong_ranges(function, order)


@pytest.mark.parametrize("function", ACTIVATIONS, ids=named)
def test_ranges_of_the_function_are_tight(function: ActivationFunction) -> None:
    rng = np.random.default_rng(0)
    middle = rng.uniform(0.1 if function.name in POSITIVE_ONLY else -4, 4, 200)
    half = 10.0 ** rng.uniform(-6, 0, 200)
    lower = np.maximum(middle - half, 0.05) if function.name in POSITIVE_ONLY else middle - half
    upper = np.maximum(middle + half, lower)
    found = curve_of(function).range(lower, upper)
    grid = function(lower + (upper - lower) * np.linspace(0, 1, 4001)[:, None])
    slack = 1e-3 * (grid.max(axis=0) - grid.min(axis=0)) + 1e-12
    assert (found.lower >= grid.min(axis=0) - slack).all()
    assert (found.upper <= grid.max(axis=0) + slack).all()


@pytest.mark.parametrize("function", ACTIVATIONS, ids=named)
def test_points_beyond_reach_have_no_wrong_range(function: ActivationFunction) -> None:
    if function.name in POSITIVE_ONLY | {"Exp", "Pow", "Gelu", "ErfGate", "Erf"}:
        pytest.skip("overflows there, in the oracle or in truth")
    ends = np.array([1e31, 1e200])
    for lower, upper in ((-ends, ends), (ends, 2 * ends), (-2 * ends, -ends)):
        found = curve_of(function).range(lower, upper)
        for k in range(2):
            for x in (lower[k], upper[k]):
                value = activate(function, MP.mpf(x))
                assert MP.mpf(found.lower[k]) <= value <= MP.mpf(found.upper[k])


def intervals(function: ActivationFunction, seed: int) -> tuple[Floats, Floats]:
    """Return intervals of every length, some of them about a kink, some far out, some of a single point."""
    rng = np.random.default_rng(seed)
    half = np.concatenate([[0.0], 10.0 ** np.linspace(-14, 1.2, 15)])
    middle = rng.normal(size=half.size) * 10.0 ** rng.uniform(-1, 1, half.size)
    if kinks(function):
        middle[::3] = rng.choice(kinks(function), middle[::3].size) + half[::3] * rng.uniform(
            -1.2, 1.2, middle[::3].size
        )
    lower, upper = middle - half, middle + half
    if function.name in POSITIVE_ONLY:
        lower, upper = np.abs(middle) + 0.01, np.abs(middle) + 0.01 + half
    if function.name == "Exp":
        lower, upper = np.minimum(lower, 30), np.minimum(upper, 30)
    return lower, upper


@cache
def values_on_intervals(function: ActivationFunction) -> tuple[Floats, Floats, Floats, list[list[Any]]]:
    """Return intervals (K,), points on each (P, K), and the function there in high precision."""
    lower, upper = intervals(function, 3)
    rng = np.random.default_rng(4)
    fraction = np.concatenate([[0.0, 1.0], rng.uniform(size=5)])
    points = np.clip(lower + (upper - lower) * fraction[:, None], lower, upper)
    inside = [kink for kink in kinks(function) if kink > 0 or function.name not in POSITIVE_ONLY]
    points = np.concatenate([points, *(np.clip(kink, lower, upper)[None] for kink in inside)])
    return lower, upper, points, [[activate(function, MP.mpf(x)) for x in row] for row in points.tolist()]


def wrong_approximations(function: ActivationFunction, rule: Any, degree: int) -> list[tuple[float, float]]:
    """Return the intervals on which an approximation is further away than it says."""
    lower, upper, points, values = values_on_intervals(function)
    centre = lower + (upper - lower) * np.random.default_rng(5).uniform(-0.5, 1.5, lower.size)
    with np.errstate(all="ignore"):
        found = approximate(curve_of(function), lower, upper, degree, rule, centre)
    wrong = []
    for k in range(lower.size):
        coefficients = [MP.mpf(c) for c in found.coefficients[::-1, k].tolist()]
        for row, exact in zip(points.tolist(), values, strict=True):
            distance = abs(exact[k] - MP.polyval(coefficients, MP.mpf(row[k]) - MP.mpf(centre[k])))
            if distance > MP.mpf(found.error[k]):
                wrong.append((float(lower[k]), float(upper[k])))
    return wrong


@pytest.mark.parametrize("function", ACTIVATIONS, ids=named)
def test_approximation_errors_are_proved(function: ActivationFunction) -> None:
    for rule in ("chebyshev", "bernstein", "taylor"):
        for degree in (1, 2, 3):
            assert not wrong_approximations(function, rule, degree), (rule, degree)


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("name", ["Tanh", "Sigmoid", "Gelu", "Relu"])
def test_approximation_errors_are_near_the_best_possible(name: str, degree: int) -> None:
    function = next(f for f in ACTIVATIONS if f.name == name)
    lower, upper = np.array([-0.4, 0.2, -1.0, -0.3]), np.array([0.5, 0.9, 2.0, 1.0])
    found = approximate(curve_of(function), lower, upper, degree, "chebyshev", (lower + upper) / 2)
    for k in range(lower.size):
        nodes = (
            np.cos((np.arange(400) + 0.5) * np.pi / 400) * (upper[k] - lower[k]) / 2
            + (lower[k] + upper[k]) / 2
        )
        fit = np.polynomial.Chebyshev.fit(nodes, function(nodes), degree)
        least = np.abs(function(nodes) - fit(nodes)).max() / 2.2  # a least-squares fit is near the best one
        assert found.error[k] <= 10 * least + 1e-12


@pytest.mark.parametrize("limit", [1e17, 1e30, float(np.finfo(np.float32).max), 1.7e308])
@pytest.mark.parametrize("sides", [("max",), ("min",), ("min", "max")])
def test_limits_far_away_limit_nothing_near(sides: tuple[str, ...], limit: float) -> None:
    lower, upper = np.array([-3.0, -1e16, 2.0]), np.array([5.0, -1e15, 1e15])
    limits = {"min": -limit, "max": limit}
    curve = curve_of(activation("Clip", **{side: limits[side] for side in sides}))
    found, slopes = curve.range(lower, upper), curve.range(lower, upper, 1)
    np.testing.assert_array_equal([found.lower, found.upper], [lower, upper])
    np.testing.assert_array_equal([slopes.lower, slopes.upper], np.ones((2, 3)))


@pytest.mark.parametrize("x", [1e31, 1e40, 1e99])
@pytest.mark.parametrize("name", ["Tanh", "Sigmoid", "Silu", "Softplus", "Gelu", "Elu", "Mish", "Softsign"])
def test_doubles_beyond_all_float32_numbers_have_a_range(name: str, x: float) -> None:
    curve = curve_of(activation(name))
    for sign in (-1.0, 1.0):
        ends = np.sort(sign * np.array([x, 1.5 * x]))
        value = curve.range(ends[:1], ends[1:])
        exact = curve.function(ends)
        assert np.isfinite([value.lower[0], value.upper[0]]).all()
        assert value.lower[0] <= exact.min() <= exact.max() <= value.upper[0]
