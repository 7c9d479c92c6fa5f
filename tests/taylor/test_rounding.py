"""The model of rounding: its margins hold for the installed onnxruntime, and its rules for sums and copies."""

from __future__ import annotations

import numpy as np
import pytest

from tests.benchmarks.activation_error import LARGEST, UNIT, worst_error
from tests.strategies import ACTIVATIONS
from tests.taylor.squash_program import escape_of_squash
from viatool.errors import EnclosureError
from viatool.policy.activations import ActivationFunction, activation
from viatool.policy.network import Affine, Input, Network
from viatool.taylor.deviation import runtime_deviation
from viatool.taylor.rounding import activation_error, affine_rounding, gamma

STEEP = (
    activation("Elu", alpha=1e4),
    activation("Celu", alpha=300.0),
    activation("Selu", alpha=500.0, gamma=-40.0),
    activation("HardSigmoid", alpha=50.0, beta=-1000.0),
    activation("LeakyRelu", alpha=70.0),
)


@pytest.mark.parametrize("function", [*ACTIVATIONS, *STEEP], ids=str)
def test_onnxruntime_stays_within_half_of_the_margin_of_an_activation(function: ActivationFunction) -> None:
    worst = worst_error(function, 40_009, -LARGEST, LARGEST)
    assert worst.points > 40_000
    assert 2 * worst.units <= function.error.roundings(function.named)


def test_a_spelled_logistic_errs_by_what_its_exponential_errs() -> None:
    for x in np.linspace(-80.0, 80.0, 321):
        argument = np.full((1, 1), x)
        value = 1.0 / (1.0 + np.exp(-argument))
        allowed = activation_error(activation("Logistic"), "float32", (argument, argument), value)
        for error in (-1.0, 1.0):
            exponential = np.exp(-argument) * (1.0 + error * 16 * UNIT * max(1.0, abs(x)))
            assert abs(1.0 / (1.0 + exponential) - value) <= allowed


@pytest.mark.parametrize("name", ["Sigmoid", "Tanh"])
def test_a_squash_errs_by_what_its_exponential_errs_and_no_more_far_out(name: str) -> None:
    assert escape_of_squash(name) <= 0
    far = np.full((1, 1), 80.0)
    assert activation_error(activation(name), "float32", (far, far), np.ones((1, 1))) < 13 * UNIT


def test_the_sum_of_n_terms_errs_by_n_roundings() -> None:
    for terms in (1, 7, 1000):
        assert gamma(terms, UNIT) >= terms * UNIT
        assert gamma(terms, UNIT) <= 1.001 * terms * UNIT


def test_so_many_terms_that_nothing_can_be_said_are_refused() -> None:
    with pytest.raises(EnclosureError, match="no useful error bound") as caught:
        gamma(200, 2.0**-8)
    assert "float32" in caught.value.hint


def test_a_copied_or_negated_value_is_exact_and_any_other_row_is_not() -> None:
    weight = np.array([[1.0, 0.0], [0.0, -1.0], [1.0, 1.0], [0.5, 0.0], [1.0, 0.0], [0.0, 0.0]])
    bias = np.array([0.0, 0.0, 0.0, 0.0, 0.25, 3.0])
    factor, _ = affine_rounding(Affine((0,), (weight,), bias), UNIT)
    assert (factor[[0, 1, 5]] == 0).all()
    assert (factor[[2, 3, 4]] > 0).all()


def test_weights_that_stand_for_several_operations_round_more_often() -> None:
    weight, bias = np.array([[0.5, 1.5]]), np.array([0.25])
    once, _ = affine_rounding(Affine((0,), (weight,), bias), UNIT)
    more, _ = affine_rounding(Affine((0,), (weight,), bias, roundings=3), UNIT)
    assert more[0] >= once[0] + 3 * UNIT
    copied, _ = affine_rounding(Affine((0,), (np.eye(1),), np.zeros(1), roundings=2), UNIT)
    assert copied[0] > 0


def test_the_deviation_holds_over_the_whole_box_not_only_at_its_ends() -> None:
    network = Network((Input(1), Affine((0,), (np.array([[3.0]]),), np.zeros(1))))
    wide = np.array([[2.0]])
    box = [(-wide, wide), (-3 * wide, 3 * wide)]
    at_zero = [(0 * wide, 0 * wide), (0 * wide, 0 * wide)]
    assert runtime_deviation(network, box)[0, 0] >= 6 * UNIT
    assert runtime_deviation(network, at_zero)[0, 0] < 1e-30


def test_the_engine_itself_is_far_more_precise_than_the_program() -> None:
    network = Network((Input(1), Affine((0,), (np.array([[3.0]]),), np.ones(1))))
    box = [(np.array([[-2.0]]), np.array([[2.0]])), (np.array([[-5.0]]), np.array([[7.0]]))]
    program, engine = runtime_deviation(network, box), runtime_deviation(network, box, engine=True)
    assert 0 < engine[0, 0] < 1e-8 * program[0, 0]
