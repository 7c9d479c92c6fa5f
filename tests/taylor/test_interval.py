"""Interval arithmetic contains the exact result; the library functions are as accurate as it assumes."""

from __future__ import annotations

import operator
from collections.abc import Callable
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from tests.oracles import MP
from viatool.taylor.interval import ENCLOSED_FUNCTIONS, Interval, step_down, step_up

SPECIAL = np.array(
    [
        0.0,
        5e-324,
        1.5e-323,
        2.2e-308,
        1e-160,
        1e-16,
        0.1,
        1 / 3,
        1 - 2.0**-53,
        1.0,
        1 + 2.0**-52,
        np.pi,
        1e8 + 1 / 3,
        2.0**53 + 2,
        1e154,
        1.7e308,
    ]
)
POINTS = np.concatenate([-SPECIAL[::-1], SPECIAL])
OPERATIONS: dict[str, Callable[[Any, Any], Any]] = {
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "/": operator.truediv,
}


def contains(interval: Interval, index: int, value: Fraction) -> bool:
    low, high = float(interval.lower[index]), float(interval.upper[index])
    if np.isposinf(low) or np.isneginf(high):
        return False
    return (np.isneginf(low) or Fraction(low) <= value) and (np.isposinf(high) or value <= Fraction(high))


def wrong_operations(name: str) -> list[tuple[float, float]]:
    """Return the operands for which an operation on points misses the exact result."""
    left, right = (side.ravel() for side in np.meshgrid(POINTS, POINTS))
    if name == "/":
        left, right = left[right != 0], right[right != 0]
    with np.errstate(all="ignore"):
        result = OPERATIONS[name](Interval(left, left), Interval(right, right))
    exact = [OPERATIONS[name](Fraction(a), Fraction(b)) for a, b in zip(left, right, strict=True)]
    return [(left[k], right[k]) for k in range(left.size) if not contains(result, k, exact[k])]


@pytest.mark.parametrize("name", OPERATIONS)
def test_operations_on_points_contain_the_exact_result(name: str) -> None:
    assert not wrong_operations(name)


@pytest.mark.parametrize("name", OPERATIONS)
def test_operations_on_intervals_contain_every_combination_of_points(name: str) -> None:
    rng = np.random.default_rng(0)
    ends = np.sort(rng.choice(POINTS, (300, 2)), axis=1), np.sort(rng.choice(POINTS, (300, 2)), axis=1)
    with np.errstate(all="ignore"):
        result = OPERATIONS[name](*(Interval(end[:, 0], end[:, 1]) for end in ends))
    for k in range(300):
        inside = [[x for x in POINTS if low <= x <= high] for low, high in (ends[0][k], ends[1][k])]
        for a in (inside[0][0], inside[0][len(inside[0]) // 2], inside[0][-1]):
            for b in (inside[1][0], inside[1][len(inside[1]) // 2], inside[1][-1]):
                if name != "/" or b != 0:
                    assert contains(result, k, OPERATIONS[name](Fraction(a), Fraction(b))), (ends[0][k], a, b)


@pytest.mark.parametrize("exponent", [2, 3, 4, 5, -1, -2])
def test_integer_powers_contain_the_exact_result(exponent: int) -> None:
    low, high = (side.ravel() for side in np.meshgrid(POINTS, POINTS))
    low, high = low[low <= high], high[low <= high]
    with np.errstate(all="ignore"):
        result = Interval(low, high) ** exponent
    for k in range(low.size):
        for x in (low[k], high[k], max(low[k], min(high[k], 1e-16)), max(low[k], min(high[k], -1e-16))):
            if exponent > 0 or x != 0:
                assert contains(result, k, Fraction(x) ** exponent), (low[k], high[k], x)


def test_division_by_an_interval_around_zero_is_the_whole_line() -> None:
    with np.errstate(all="ignore"):
        result = 1.0 / Interval(np.array([-1.0, 0.0, -2.0]), np.array([1.0, 4.0, 0.0]))
    assert result.lower[0] == -np.inf
    assert result.upper[0] == np.inf
    assert result.lower[1] <= 0.25 <= result.lower[1] + 1e-15
    assert result.upper[1] == np.inf
    assert result.lower[2] == -np.inf
    assert result.upper[2] - 1e-15 <= -0.5 <= result.upper[2]


def test_steps_move_every_number() -> None:
    finite = POINTS[np.abs(POINTS) < 1e308]
    assert (step_down(finite) < finite).all()
    assert (step_up(finite) > finite).all()
    assert (step_up(finite) <= finite + np.abs(finite) * 5e-16 + 1e-323).all()


def _normal_cdf(x: Any) -> Any:
    return MP.erfc(-x / MP.sqrt(2)) / 2


REGIONS: dict[str, tuple[Callable[[Any], Any], list[tuple[float, float]]]] = {
    "exp": (MP.exp, [(-745, -700), (-700, -1), (-1e-8, 1e-8), (-1, 1), (1, 709)]),
    "log": (MP.log, [(1e-320, 1e-300), (1e-9, 0.5), (0.999, 1.001), (0.5, 2), (2, 1e300)]),
    "tanh": (MP.tanh, [(-25, -15), (-5, -0.1), (1e-300, 1e-290), (1e-9, 1e-3), (0.1, 25)]),
    "erf": (MP.erf, [(-7, -4), (-4, -0.1), (1e-300, 1e-290), (1e-9, 1e-3), (0.1, 7)]),
    "NormalCdf": (_normal_cdf, [(-45, -37), (-37, -20), (-20, -5), (-5, -0.1), (-1e-3, 1e-3), (0.1, 9)]),
    "sqrt": (MP.sqrt, [(0, 1e-320), (1e-9, 1), (1, 1e300)]),
}


def wrong_functions(name: str, share: float) -> list[float]:
    """Return the points at which a function is missed when its margin shrinks to a share."""
    truth, regions = REGIONS[name]
    rng = np.random.default_rng(1)
    wrong = []
    for low, high in regions:
        x = np.concatenate([[low, high], rng.uniform(low, high, 200)])
        if low > 0 and high / low > 1e3:
            x[100:] = np.exp(rng.uniform(np.log(low), np.log(high), 102))
        result = ENCLOSED_FUNCTIONS[name](Interval(x, x))
        middle, half = result.lower / 2 + result.upper / 2, result.upper / 2 - result.lower / 2
        for k in range(x.size):
            value = truth(MP.mpf(x[k]))
            if not MP.mpf(result.lower[k]) <= value <= MP.mpf(result.upper[k]):
                wrong.append(float(x[k]))
            clipped = name != "exp" and abs(middle[k]) > 1 - 1e-14
            if not clipped and abs(middle[k]) > 1e-290 and abs(value - MP.mpf(middle[k])) > half[k] * share:
                wrong.append(float(x[k]))
    return wrong


@pytest.mark.parametrize("name", REGIONS)
def test_functions_contain_the_true_value_with_half_of_their_margin_unused(name: str) -> None:
    assert not wrong_functions(name, share=0.5)


def test_undefined_results_are_the_whole_line() -> None:
    x = np.array([-1.0])
    with np.errstate(all="ignore"):
        result = ENCLOSED_FUNCTIONS["log"](Interval(x, x))
    assert np.isneginf(result.lower[0])
    assert np.isposinf(result.upper[0])
