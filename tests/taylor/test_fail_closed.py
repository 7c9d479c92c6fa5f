"""Whatever is not a number, or the wrong way round, proves nothing: it is refused, or nothing is known of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.strategies import ACTIVATIONS
from tests.taylor.containment import Bare
from viatool.errors import BoundsError, ConfigurationError, EnclosureError, ViatoolError
from viatool.policy.activations import ActivationFunction, activation
from viatool.policy.network import Activation, Affine, Input, Maximum, Minimum, Network, Product
from viatool.taylor import Box, propagation, reach
from viatool.taylor import refinement as refining
from viatool.taylor.approximation import approximate
from viatool.taylor.correlated import input_model, reach_correlated, reach_linear
from viatool.taylor.curve import curve_of
from viatool.taylor.derivatives import gradient_bounds
from viatool.taylor.deviation import runtime_deviation
from viatool.taylor.polynomial_range import range_of_quadratics
from viatool.taylor.propagation import Enclosure, propagate
from viatool.taylor.refinement import collapse_monotone, extrema_of
from viatool.taylor.rounding import gamma, widen

NAN, INFINITY = float("nan"), float("inf")
NOT_A_NUMBER = np.array([NAN])
RELU, TANH = activation("Relu"), activation("Tanh")
CLIP = activation("Clip", min=-0.5, max=0.5)
ENDS = [(NAN, NAN), (NAN, 1.0), (-1.0, NAN)]


def affine(weight: Any, bias: Any = (0.0,)) -> Affine:
    return Affine((0,), (np.atleast_2d(np.array(weight, dtype=float)),), np.array(bias, dtype=float))


def network(*functions: ActivationFunction, weight: float = 1.0) -> Network:
    nodes = [Activation(index + 1, function, 1) for index, function in enumerate(functions)]
    return Network((Input(1), affine(weight), *nodes))


@pytest.mark.parametrize(
    ("observations", "eps", "named"),
    [
        ([[NAN]], 0.1, "NaN"),
        ([[INFINITY]], 0.1, "infinity"),
        ([[0.0]], NAN, "eps"),
        ([[0.0]], INFINITY, "eps"),
        ([[0.0]], -0.1, "eps"),
        ([[0.0], [1.0]], [[0.1], [NAN]], "eps"),
    ],
)
def test_observations_and_eps_that_are_no_finite_numbers_are_refused(
    observations: Any, eps: Any, named: str
) -> None:
    with pytest.raises(ConfigurationError, match=named):
        reach(Bare(network(TANH)), observations, eps)


@pytest.mark.parametrize("options", [{}, {"refine": "none"}, {"refine": "split"}, {"order": 2}], ids=str)
@pytest.mark.parametrize("arithmetic", ["real", "float32"])
@pytest.mark.parametrize("functions", [(), (RELU,), (TANH,), (CLIP,), (RELU, CLIP), (CLIP, CLIP)], ids=str)
def test_values_that_overflow_are_refused_whatever_comes_after(
    functions: tuple[ActivationFunction, ...], arithmetic: str, options: Any
) -> None:
    weights = np.array([[1e308, 1e308]]), np.array([[0.0]])
    first = Affine((0,), (np.array([[1e308], [-1e308]]),), np.zeros(2))
    nodes = [Activation(index + 2, function, 1) for index, function in enumerate(functions)]
    cancelling = Network((Input(1), first, Affine((1,), weights[:1], np.zeros(1)), *nodes))
    with pytest.raises(EnclosureError):
        reach(Bare(cancelling), [[4.0]], 1.0, arithmetic=arithmetic, **options)


@pytest.mark.parametrize("ends", [*ENDS, (1.0, -1.0)], ids=str)
def test_a_box_that_is_empty_or_not_a_number_is_refused(ends: tuple[float, float]) -> None:
    with pytest.raises(BoundsError):
        Box(*(np.array([[end]]) for end in ends))


@pytest.mark.parametrize("derivative", [0, 1, 2])
@pytest.mark.parametrize("function", ACTIVATIONS, ids=str)
def test_nothing_is_known_of_an_activation_between_ends_that_are_no_numbers(
    function: ActivationFunction, derivative: int
) -> None:
    lower, upper = (np.array(ends) for ends in zip(*ENDS, strict=True))
    found = curve_of(function).range(lower, upper, derivative)
    assert (found.lower == -np.inf).all()
    assert (found.upper == np.inf).all()


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("function", ACTIVATIONS, ids=str)
def test_no_activation_is_approximated_between_ends_that_are_no_numbers(
    function: ActivationFunction, degree: int
) -> None:
    for lower, upper in ENDS:
        with pytest.raises(EnclosureError):
            approximate(
                curve_of(function), np.array([lower]), np.array([upper]), degree, "chebyshev", np.zeros(1)
            )


@pytest.mark.parametrize("ends", ENDS, ids=str)
def test_no_neuron_is_stable_and_no_input_is_fixed_where_hulls_are_no_numbers(
    ends: tuple[float, float],
) -> None:
    hull = (np.array([[ends[0]]]), np.array([[ends[1]]]))
    box = Box(np.array([[-1.0]]), np.array([[1.0]]))
    seed = np.ones((1, 1))
    for node in (
        Activation(1, RELU, 1),
        Activation(1, CLIP, 1),
        Maximum(1, 1, 1),
        Minimum(1, 1, 1),
        Product(1, 1, 1),
    ):
        asked = Network((Input(1), affine(1.0), node))
        hulls = [(box.lower, box.upper), hull, hull]
        if isinstance(node, Maximum | Minimum):  # both sides may win, and their slopes are 1
            low, high = gradient_bounds(asked, hulls, seed)
            assert low <= 1 <= high
            continue
        face = collapse_monotone(asked, box, hulls, seed)
        assert (face.lower == box.lower).all()
        assert (face.upper == box.upper).all()


def test_a_slope_that_is_not_a_number_has_no_sign() -> None:
    low, high = range_of_quadratics(NOT_A_NUMBER, np.ones(1))
    assert np.isnan(low).all()
    assert np.isnan(high).all()


def test_a_deviation_of_hulls_that_are_no_numbers_is_refused() -> None:
    asked = network(CLIP)
    hulls = [(np.zeros((1, 1)), np.zeros((1, 1))) for _ in asked.nodes]
    for index in range(len(hulls)):
        for ends in ENDS:
            given = list(hulls)
            given[index] = (np.array([[ends[0]]]), np.array([[ends[1]]]))
            with pytest.raises(EnclosureError):
                runtime_deviation(asked, given)
    with pytest.raises(EnclosureError):
        gamma(NOT_A_NUMBER, 2.0**-24)


def test_bounds_that_are_crossed_are_refused_and_such_that_are_no_numbers_say_nothing() -> None:
    lower, upper = widen(NOT_A_NUMBER, NOT_A_NUMBER, np.zeros(1))
    assert (lower == -np.inf).all()
    assert (upper == np.inf).all()
    lower, upper = widen(np.zeros(1), np.ones(1), NOT_A_NUMBER)
    assert (lower == -np.inf).all()
    assert (upper == np.inf).all()
    with pytest.raises(BoundsError):
        widen(np.ones(1), np.zeros(1), np.full(1, 10.0))


@pytest.mark.parametrize("search", [reach_correlated, lambda *given: reach_linear(*given, 1)])
@pytest.mark.parametrize("part", [0, 1, 2])
def test_correlated_inputs_that_are_no_numbers_are_refused(part: int, search: Callable[..., Any]) -> None:
    given = [np.zeros((1, 1)), np.zeros((1, 1, 1)), np.zeros((1, 1))]
    given[part] = np.full(given[part].shape, NAN)
    with pytest.raises(ViatoolError):
        search(network(CLIP), input_model(*given))


def _crossed(enclosure: Enclosure) -> Enclosure:
    return replace(enclosure, lower=enclosure.upper + 1.0, upper=enclosure.lower)


@pytest.mark.parametrize("refine", ["none", "monotone", "split"])
@pytest.mark.usefixtures("numpy_engine")
def test_a_hull_of_a_hidden_node_that_is_crossed_ends_the_run(
    monkeypatch: pytest.MonkeyPatch, refine: Any
) -> None:
    original = propagation._enclose_activation
    monkeypatch.setattr(propagation, "_enclose_activation", lambda *given: _crossed(original(*given)))
    asked = Network((Input(1), affine(1.0), Activation(1, RELU, 1), replace(affine(-1.0), sources=(2,))))
    with pytest.raises(BoundsError):
        reach(Bare(asked), [[0.0]], 1.0, refine=refine)


@pytest.mark.usefixtures("numpy_engine")
def test_crossed_bounds_of_an_action_end_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    def crossed(network: Network, points: NDArray[np.float64], seed: NDArray[np.float64]) -> Any:
        return np.full(points.shape[0], -1e3)

    monkeypatch.setattr(refining, "bound_at_points", crossed)
    with pytest.raises(BoundsError) as caught:
        reach(Bare(network(weight=2.0)), [[0.0]], 1.0)
    assert "bug" in caught.value.hint


@pytest.mark.usefixtures("numpy_engine")
def test_a_bound_that_is_not_a_number_is_not_cut_to_the_range_of_the_squash(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def unknown(network: Network, points: NDArray[np.float64], seed: NDArray[np.float64]) -> Any:
        return np.full(points.shape[0], NAN)

    monkeypatch.setattr(refining, "bound_at_points", unknown)
    with pytest.raises(EnclosureError):
        reach(Bare(network(CLIP)), [[0.0]], 1.0)


def test_questions_without_a_bound_stay_without_one() -> None:
    asked = network(TANH)
    box = Box(np.array([[-1.0]]), np.array([[1.0]]))
    passes = propagate(asked, box)
    extrema = extrema_of(box, np.full((1, 1), NAN), np.full((1, 1), NAN))
    assert np.isnan(extrema.bound).all()
    refined = refining.refine_by_pieces(asked, extrema, passes)
    assert not (refined.bound < 0.5).any()
