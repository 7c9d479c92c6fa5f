"""The deviation of a program against the worst one: every rounding in the direction that hurts, as Fractions."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from viatool.errors import EnclosureError
from viatool.policy.activations import ActivationFunction, activation
from viatool.policy.network import Activation, Affine, Cast, Input, Network, Node, Precision, Product
from viatool.rounding import LARGEST, SMALLEST_NORMAL, UNIT_ROUNDOFF
from viatool.taylor import approximation
from viatool.taylor.approximation import approximate_linearly
from viatool.taylor.curve import curve_of
from viatool.taylor.deviation import runtime_deviation

PRECISIONS: tuple[Precision, ...] = ("bfloat16", "float16", "float32", "float64")


def deviation(nodes: list[Node], point: list[float]) -> Fraction:
    """Return the deviation of the last node at a point, for a network of one action."""
    network = Network(tuple(nodes))
    values = network.values(np.array([point]))
    return Fraction(float(runtime_deviation(network, [(v, v) for v in values])[0, 0]))


def affine(source: int, weight: Any, bias: float, precision: Precision, roundings: int = 0) -> Affine:
    return Affine(
        (source,), (np.atleast_2d(np.array(weight, dtype=float)),), np.array([bias]), precision, roundings
    )


def units(precision: Precision) -> Fraction:
    return Fraction(UNIT_ROUNDOFF[precision])


@pytest.mark.parametrize("roundings", [0, 2])
@pytest.mark.parametrize("bias", [0.0, 3.0])
@pytest.mark.parametrize("terms", [1, 2, 5, 60])
@pytest.mark.parametrize("precision", PRECISIONS)
def test_a_dot_product_rounded_away_at_every_step_is_within_the_deviation(
    precision: Precision, terms: int, bias: float, roundings: int
) -> None:
    unit, weight = units(precision), 1.5
    found = deviation(
        [Input(terms, precision), affine(0, [[weight] * terms], bias, precision, roundings)], [1.0] * terms
    )
    received = (1 + unit) + Fraction(SMALLEST_NORMAL[precision])
    # one rounding for each product, one for each sum; the first term takes part in all sums
    sums = terms - 1 + (bias != 0)
    worst = terms * Fraction(weight) * received * (1 + unit) ** (1 + sums + roundings)
    worst += Fraction(bias) * (1 + unit) ** (sums + roundings)
    assert found >= worst - terms * Fraction(weight) - Fraction(bias)


@pytest.mark.parametrize("weight", [3.0, 1.1, 0.3, 2.5])
@pytest.mark.parametrize("precision", PRECISIONS)
def test_a_product_by_a_number_that_is_no_sign_rounds(precision: Precision, weight: float) -> None:
    unit = units(precision)
    found = deviation([Input(1, precision), affine(0, [[weight]], 0.0, precision)], [1.0])
    assert found >= Fraction(weight) * ((1 + unit) ** 2 - 1)
    copied = deviation([Input(1, precision), affine(0, [[-1.0]], 0.0, precision)], [1.0])
    assert copied < unit * Fraction(5, 4)


@pytest.mark.parametrize("precision", PRECISIONS)
def test_the_square_of_a_rounded_number_is_within_the_deviation(precision: Precision) -> None:
    unit = units(precision)
    found = deviation([Input(1, precision), Product(0, 0, 1, precision)], [1.0])
    assert found >= (1 + unit) ** 3 - 1


@pytest.mark.parametrize("precision", ["float16", "float32"])
def test_a_product_that_is_flushed_to_zero_is_within_the_deviation(precision: Precision) -> None:
    small = 2.0 ** -(8 if precision == "float16" else 70)
    found = deviation([Input(1, precision), Product(0, 0, 1, precision)], [small])
    assert found >= Fraction(small) ** 2


@pytest.mark.parametrize(
    ("before", "after"), [("float64", "float32"), ("float32", "float16"), ("float32", "bfloat16")]
)
def test_a_cast_rounds_to_a_narrower_type_only(before: Precision, after: Precision) -> None:
    stored = units(before)
    narrowed = deviation([Input(1, before), Cast(0, 1, after)], [1.0])
    assert narrowed >= (1 + stored) * (1 + units(after)) - 1
    widened = deviation([Input(1, after), Cast(0, 1, before)], [1.0])
    assert units(after) <= widened < units(after) * Fraction(5, 4)


@pytest.mark.parametrize(
    ("function", "lower", "upper", "slope"),
    [
        (activation("Relu"), -1.0, 1.0, 1.0),
        (activation("LeakyRelu", alpha=-2.0), -1.0, 0.1, 2.0),
        (activation("LeakyRelu", alpha=0.25), -1.0, 0.0, 1.0),
        (activation("Abs"), -1.0, 0.5, 1.0),
    ],
)
def test_what_moves_an_argument_moves_the_value_by_its_steepest_slope(
    function: ActivationFunction, lower: float, upper: float, slope: float
) -> None:
    network = Network((Input(1, "float16"), Activation(0, function, 1, "float32")))
    moved = UNIT_ROUNDOFF["float16"] * max(abs(lower), abs(upper)) + SMALLEST_NORMAL["float16"]
    hulls = [(np.array([[lower]]), np.array([[upper]]))]
    value = curve_of(function).range(*hulls[0])
    found = runtime_deviation(network, [*hulls, (value.lower, value.upper)])[0, 0]
    assert found >= slope * moved


def test_a_neuron_that_rounding_may_wake_deviates() -> None:
    network = Network((Input(1, "float16"), Activation(0, activation("Relu"), 1, "float16")))
    asleep = (np.array([[-1e-6]]), np.array([[-1e-6]]))
    found = runtime_deviation(network, [asleep, (np.zeros((1, 1)), np.zeros((1, 1)))])[0, 0]
    assert found >= SMALLEST_NORMAL["float16"] - 1e-6


def test_a_partial_sum_that_may_overflow_is_refused() -> None:
    nodes = [Input(2, "float16"), affine(0, [[60000.0, -60000.0]], 0.0, "float16")]
    with pytest.raises(EnclosureError, match="float16"):
        deviation(nodes, [1.0, 1.0])


def test_the_numbers_of_the_precisions_are_those_of_ieee_754() -> None:
    for precision in ("float16", "float32", "float64"):
        facts = np.finfo(precision)
        assert UNIT_ROUNDOFF[precision] == float(facts.eps) / 2
        assert SMALLEST_NORMAL[precision] == float(facts.smallest_normal)
        assert 0.9 * float(facts.max) < LARGEST[precision] <= float(facts.max)
    assert UNIT_ROUNDOFF["bfloat16"] == 2.0**-8  # seven bits and the hidden one
    assert SMALLEST_NORMAL["bfloat16"] == SMALLEST_NORMAL["float32"]
    assert LARGEST["bfloat16"] <= (2 - 2.0**-7) * 2.0**127


def test_a_straight_piece_near_its_root_counts_the_rounding_of_its_terms() -> None:
    function = activation("HardSigmoid", alpha=float(np.float32(0.2)))
    slope = Fraction(float(np.float32(0.2)))
    generator = np.random.default_rng(0)
    centre = float(Fraction(-1, 2) / slope) * (1 - 10.0 ** generator.uniform(-12, -3, 400))
    lower, upper = centre, centre * (1 - 1e-9)
    lower, upper = np.minimum(lower, upper), np.maximum(lower, upper)
    kept = (lower > float(Fraction(-1, 2) / slope)) & (upper < 0)
    lower, upper, about = lower[kept], upper[kept], generator.uniform(0.5, 1.0, kept.sum())
    line = approximate_linearly(curve_of(function), lower, upper, "chebyshev", about)
    for c, k, e, x, z in zip(*line.coefficients, line.error, upper, about, strict=True):
        exact = slope * Fraction(float(x)) + Fraction(1, 2)
        approximated = Fraction(float(c)) + Fraction(float(k)) * (Fraction(float(x)) - Fraction(float(z)))
        assert abs(exact - approximated) <= Fraction(float(e))


@pytest.mark.parametrize("share", [0.0, 0.3, 0.5, 0.9, 1.0])
@pytest.mark.parametrize(
    ("name", "lower", "upper"), [("Softplus", -3.0, 4.0), ("Exp", -2.0, 1.0), ("Tanh", 0.1, 3.0)]
)
def test_a_tangent_at_any_point_bounds_a_bent_curve(
    name: str, lower: float, upper: float, share: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    def point(curve: Any, left: Any, right: Any, *rest: Any) -> Any:
        return left + share * (right - left)

    monkeypatch.setattr(approximation, "_stationary_point", point)
    curve = curve_of(activation(name))
    ends = np.array([lower]), np.array([upper])
    slope = (curve.value(ends[1]) - curve.value(ends[0])) / (upper - lower)
    found = approximation.residual_range(curve, *ends, slope)
    x = np.linspace(lower, upper, 4001)
    residual = curve.value(x) - slope * x
    assert found.lower[0] <= residual.min()
    assert found.upper[0] >= residual.max()
