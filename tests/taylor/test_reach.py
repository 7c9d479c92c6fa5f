"""What a user of `reach` relies on: shapes, errors, repeatability, degenerate boxes, and honest attained values."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.oracles import MP, precise
from tests.strategies import NetworkPlan
from tests.taylor.containment import Bare
from viatool import load_policy
from viatool.errors import ConfigurationError, EnclosureError
from viatool.policy.activations import activation
from viatool.policy.network import Activation, Affine, Cast, Input, Network
from viatool.taylor import ReachableSet, reach
from viatool.taylor import reach as reach_function

Floats = NDArray[np.float64]

FUNCTIONS = tuple(activation(name) for name in ("Relu", "Tanh"))
ACTOR = NetworkPlan(4, inputs=5, width=12, actions=2, activations=FUNCTIONS).build()
OBSERVATIONS = np.random.default_rng(8).normal(size=(37, 5))
FEW = OBSERVATIONS[:9]
FIELDS = ("lower", "upper", "attained_lower", "attained_upper")
REFINEMENTS = ("none", "monotone", "split")


def ask(
    network: Network = ACTOR, observations: Any = OBSERVATIONS, eps: Any = 0.05, **options: Any
) -> ReachableSet:
    return reach(Bare(network), observations, eps, **{"most_parts": 12, **options})


@pytest.mark.parametrize("refine", REFINEMENTS)
def test_bounds_have_one_row_for_each_state_and_enclose_what_is_attained(refine: str) -> None:
    sets = ask(observations=FEW, refine=refine, arithmetic="real")
    assert all(getattr(sets, name).shape == (9, 2) for name in FIELDS)
    slack = 1e-12
    assert (sets.lower <= sets.attained_lower + slack).all()
    assert (sets.attained_lower <= sets.attained_upper).all()
    assert (sets.attained_upper <= sets.upper + slack).all()
    assert (sets.deviation == 0).all()


@pytest.mark.parametrize("refine", REFINEMENTS)
def test_the_same_question_has_the_same_answer(refine: str) -> None:
    first, second = ask(observations=FEW, refine=refine), ask(observations=FEW, refine=refine)
    for name in FIELDS:
        assert (getattr(first, name) == getattr(second, name)).all()


@pytest.mark.parametrize("refine", REFINEMENTS)
@pytest.mark.parametrize("order", [1, 2])
def test_the_answer_for_a_state_does_not_depend_on_its_neighbours(refine: str, order: int) -> None:
    together = ask(observations=FEW, refine=refine, order=order)
    for rows in (slice(0, 1), slice(2, 9)):
        alone = ask(observations=FEW[rows], refine=refine, order=order)
        for name in FIELDS:
            np.testing.assert_allclose(getattr(alone, name), getattr(together, name)[rows], rtol=0, atol=1e-9)


def test_many_states_are_the_same_as_few() -> None:
    many = ask(observations=np.tile(OBSERVATIONS, (30, 1)))
    few = ask()
    np.testing.assert_allclose(many.upper, np.tile(few.upper, (30, 1)), atol=1e-10)
    np.testing.assert_allclose(many.lower, np.tile(few.lower, (30, 1)), atol=1e-10)


def test_no_states_give_no_bounds() -> None:
    assert ask(observations=np.empty((0, 5))).lower.shape == (0, 2)


def test_refinement_only_tightens() -> None:
    none, monotone, split = (ask(observations=FEW, refine=r, arithmetic="real") for r in REFINEMENTS)
    for looser, tighter in ((none, monotone), (monotone, split)):
        assert (tighter.upper <= looser.upper + 1e-12).all()
        assert (tighter.lower >= looser.lower - 1e-12).all()


def test_the_float32_contract_contains_the_real_one_by_the_stated_deviation() -> None:
    real, deployed = ask(arithmetic="real"), ask(arithmetic="float32")
    assert (deployed.deviation > 0).all()
    further = np.stack([deployed.upper - real.upper, real.lower - deployed.lower])
    assert (further >= 0).all()
    np.testing.assert_allclose(further.max(axis=0), deployed.deviation, rtol=1e-6)


@pytest.mark.parametrize("refine", REFINEMENTS)
def test_a_point_has_a_width_of_rounding_only(refine: str) -> None:
    sets = ask(eps=0.0, arithmetic="real", refine=refine)
    assert sets.width.max() <= 1e-12
    for b in range(4):
        exact = precise(ACTOR, OBSERVATIONS[b].tolist())
        for a in range(2):
            assert MP.mpf(sets.lower[b, a]) <= exact[a] <= MP.mpf(sets.upper[b, a])
    assert ask(eps=0.0, arithmetic="float32", refine=refine).width.max() <= 1e-4


def test_eps_may_be_one_number_one_for_each_channel_or_one_for_each_state() -> None:
    scalar = ask(eps=0.05)
    for eps in (np.full(5, 0.05), np.full((37, 5), 0.05), [0.05] * 5, np.float32(0.05).item()):
        np.testing.assert_allclose(ask(eps=eps).upper, scalar.upper, rtol=1e-6)
    narrow = ask(eps=[0.0, 0.0, 0.05, 0.0, 0.0])
    assert (narrow.width < scalar.width).all()


def test_larger_boxes_contain_smaller_ones() -> None:
    widths = [ask(eps=eps, arithmetic="real") for eps in (0.0, 0.01, 0.1, 1.0, 10.0)]
    for inner, outer in pairwise(widths):
        assert (outer.upper >= inner.attained_upper).all()
        assert (outer.lower <= inner.attained_lower).all()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"observations": np.zeros((3, 4))}, "expected (B, 5)"),
        ({"observations": np.zeros(5)}, "expected (B, 5)"),
        ({"observations": np.full((2, 5), np.nan)}, "NaN"),
        ({"observations": np.full((2, 5), np.inf)}, "infinity"),
        ({"eps": -0.1}, "eps"),
        ({"eps": np.nan}, "eps"),
        ({"eps": np.inf}, "eps"),
        ({"eps": [0.1, 0.1]}, "eps has shape"),
        ({"eps": np.full((36, 5), 0.1)}, "eps has shape"),
        ({"order": 0}, "order"),
        ({"approximation": "spline"}, "approximation"),
        ({"refine": "maximally"}, "refine"),
        ({"arithmetic": "float8"}, "arithmetic"),
    ],
)
def test_misuse_is_refused_with_the_value_and_what_was_expected(change: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        ask(**change)
    assert words in caught.value.message
    assert caught.value.hint


def test_a_reciprocal_over_zero_has_no_enclosure() -> None:
    network = Network((Input(1), Activation(0, activation("Reciprocal"), 1)))
    with pytest.raises(EnclosureError):
        ask(network, [[0.05]], 0.1)
    assert np.isfinite(ask(network, [[0.2]], 0.1).width).all()


def test_an_overflow_of_the_program_has_no_enclosure() -> None:
    weight = np.array([[3.0e38]])
    network = Network((Input(1), Affine((0,), (weight,), np.zeros(1)), Affine((1,), (weight,), np.zeros(1))))
    with pytest.raises(EnclosureError, match="float32"):
        ask(network, [[1.0]], 0.1, arithmetic="float32")


def test_a_constant_action_has_no_width() -> None:
    network = Network((Input(2), Affine((), (), np.array([0.25, -3.0]))))
    sets = ask(network, [[0.0, 1.0]], 0.5)
    np.testing.assert_allclose(sets.lower, [[0.25, -3.0]], atol=1e-6)
    np.testing.assert_allclose(sets.upper, [[0.25, -3.0]], atol=1e-6)


def test_a_copied_input_is_exact_in_real_arithmetic() -> None:
    network = Network((Input(2), Affine((0,), (np.eye(2),), np.zeros(2))))
    sets = ask(network, [[0.5, -1.0]], 0.25, arithmetic="real")
    np.testing.assert_allclose(sets.lower, [[0.25, -1.25]], atol=1e-12)
    np.testing.assert_allclose(sets.upper, [[0.75, -0.75]], atol=1e-12)


def test_lower_precision_widens_the_contract() -> None:
    def actor(precision: Any) -> Network:
        weight = np.array([[0.5, -0.25, 1.5]])
        return Network(
            (
                Input(3, precision),
                Affine((0,), (weight,), np.array([0.125]), precision),
                Activation(1, activation("Tanh"), 1, precision),
                Cast(2, 1, "float32"),
            )
        )

    widths = [
        ask(actor(precision), [[0.1, 0.2, 0.3]], 0.0, arithmetic="float32").width[0, 0]
        for precision in ("float64", "float32", "float16")
    ]
    assert widths[0] < widths[1] < widths[2] < 0.1


def test_channels_that_the_specification_fixes_keep_a_width_of_zero() -> None:
    class Specification:
        def radii(self, eps: float) -> Floats:
            return np.array([eps, eps, 0.0, eps, 0.0])

    policy = Bare(ACTOR, Specification())
    by_name = reach_function(policy, OBSERVATIONS, 0.05)
    by_hand = ask(eps=[0.05, 0.05, 0.0, 0.05, 0.0])
    np.testing.assert_allclose(by_name.upper, by_hand.upper)
    np.testing.assert_allclose(by_name.lower, by_hand.lower)


def test_progress_counts_every_state_once() -> None:
    done: list[int] = []
    ask(progress=done.append)
    assert sum(done) == 37


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (np.ones((2, 26)) * 1j, "observations hold complex128 values, expected real numbers"),
        (np.ones((2, 26)).astype(str), "observations hold <U32 values"),
        ([[None] * 26], "observations hold object values"),
        ([[0.0] * 26, [0.0] * 25], "observations are rows of different lengths"),
    ],
    ids=["complex", "text", "nothing", "ragged"],
)
def test_observations_that_are_no_numbers_are_refused(given, said):
    policy = load_policy("policies/via.onnx")
    with pytest.raises(ConfigurationError, match=said):
        reach(policy, given, 0.01)
    with pytest.raises(ConfigurationError, match=said):
        policy.run(given)
