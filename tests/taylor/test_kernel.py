"""The compiled engine: sound against exact arithmetic and programs, as tight as numpy, and left out without a word."""

from __future__ import annotations

import subprocess
import sys
from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import hatch_build
import viatool
from tests.taylor import compiled
from tests.taylor.compiled import (
    BENT,
    STRAIGHT,
    branched,
    escape,
    escape_of_linear,
    escape_of_parts,
    escape_of_programs,
    inputs_together,
    kernel_over,
    layered,
)
from viatool import engine
from viatool.engine.calls import call, passed
from viatool.errors import BoundsError, ConfigurationError, EnclosureError, ViatoolError
from viatool.policy.activations import ActivationFunction, activation
from viatool.policy.network import Activation, Affine, Input, Network, Node, Product
from viatool.taylor import duality, engine_of, reach
from viatool.taylor.correlated import input_model, reach_linear
from viatool.taylor.first_order import goes_backwards
from viatool.taylor.kernel import kernel_of

ROOT = Path(__file__).parents[2]
THOROUGH = {"rounds": 4, "sweeps": 2, "neurons": 24, "climbs": 4}
LEAKY = activation("LeakyRelu", alpha=float(np.float32(0.01)))


def bare(network: Network) -> Any:
    return SimpleNamespace(network=network, spec=None)


def single(network: Network) -> Network:
    """Return a network whose weights a float32 program holds."""

    def held(node: Node) -> Node:
        if not isinstance(node, Affine):
            return node
        weights = tuple(np.float32(weight).astype(float) for weight in node.weights)
        return Affine(node.sources, weights, np.float32(node.bias).astype(float))

    return Network(tuple(map(held, network.nodes)))


# --- which engine runs -----------------------------------------------------------------------------------


def test_the_compiled_engine_runs_where_it_is_built() -> None:
    assert engine.library() is not None, "build it: python hatch_build.py"
    assert engine.chosen_engine() == "compiled"
    for name in ("via", "via-mission", "via-tanh", "via-64", "via-256"):
        assert engine_of(viatool.load_policy(ROOT / "policies" / f"{name}.onnx").network) == "compiled"


def test_the_environment_chooses_the_engine(monkeypatch: pytest.MonkeyPatch) -> None:
    network = layered(np.random.default_rng(0), 3, 4, 2, hidden=STRAIGHT[0])
    monkeypatch.setenv("VIATOOL_ENGINE", "numpy")
    assert (engine.chosen_engine(), engine_of(network)) == ("numpy", "numpy")
    monkeypatch.setenv("VIATOOL_ENGINE", "fortran")
    with pytest.raises(ConfigurationError, match="expected compiled or numpy"):
        engine.chosen_engine()


def test_an_engine_of_other_sources_or_none_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    engine.library.cache_clear()
    try:
        monkeypatch.setattr(engine, "_digest", lambda: "of other sources")
        assert engine.chosen_engine() == "numpy"
        monkeypatch.setenv("VIATOOL_ENGINE", "compiled")
        with pytest.raises(ConfigurationError, match="not built"):
            engine.chosen_engine()
    finally:
        engine.library.cache_clear()


def test_without_a_compiler_nothing_is_built_and_nothing_fails(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    folder = tmp_path / hatch_build.ENGINE
    folder.mkdir(parents=True)
    (folder / "kernel.c").write_text("int main(void) { return 0; }")
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CC", raising=False)
    assert hatch_build.compile_kernel(tmp_path) is None
    assert [path.name for path in folder.iterdir()] == ["kernel.c"]


def test_a_checkout_says_which_engine_runs() -> None:
    command = [sys.executable, "-m", "viatool", "--version"]
    said = subprocess.run(command, capture_output=True, text=True, check=True, cwd=ROOT).stdout
    assert f"engine {engine.chosen_engine()}" in said.splitlines()


def test_a_network_that_is_not_covered_is_left_to_numpy() -> None:
    nodes: tuple[Node, ...] = (Input(2), Affine((0,), (np.eye(2),), np.zeros(2)), Product(0, 1, 2))
    assert engine_of(Network(nodes)) == "numpy"
    softsign = (Input(2), Activation(0, activation("Softsign"), 2))
    assert engine_of(Network(softsign)) == "numpy"
    assert np.isfinite(reach(bare(Network(softsign)), np.zeros((3, 2)), 0.1).width).all()


# --- inputs that move together ---------------------------------------------------------------------------


@pytest.mark.parametrize("hidden", [*STRAIGHT, *BENT], ids=str)
def test_linear_models_hold_the_exact_actions_of_inputs_that_move_together(
    hidden: ActivationFunction,
) -> None:
    rng = np.random.default_rng(5)
    for last in (False, True):
        network = layered(rng, 4, 6, 5, 2, hidden=hidden, scale=1.5, last=last)
        for spread in (0.05, 1.0):
            assert escape_of_linear(kernel_over(network), inputs_together(rng, network, spread=spread)) == 0.0
    network = branched(rng, hidden)
    assert escape_of_linear(kernel_over(network), inputs_together(rng, network)) == 0.0


def test_linear_models_need_what_each_input_has_to_itself() -> None:
    rng = np.random.default_rng(6)
    network = layered(rng, 4, 6, 2, hidden=STRAIGHT[0])
    given = inputs_together(rng, network)
    assert escape_of_linear(kernel_over(network), given, assumed=0.5 * given[2]) > 1e-3


@pytest.mark.parametrize(("allowance", "hidden"), [("sums", STRAIGHT[0]), ("errors", BENT[0])], ids=str)
def test_linear_models_need_every_allowance(allowance: str, hidden: ActivationFunction) -> None:
    rng = np.random.default_rng(7)
    network = layered(rng, 5, 8, 8, 2, hidden=hidden, scale=3.0)
    without = kernel_over(network, **{allowance: 0.0})
    spread = 1e-9 if allowance == "sums" else 0.3
    assert any(
        escape_of_linear(without, inputs_together(rng, network, spread=spread), seed=n) > 0 for n in range(8)
    )


@pytest.mark.parametrize("name", ["via-mission", "via-tanh"])
def test_both_engines_give_the_same_linear_models(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    network, rng = viatool.load_policy(ROOT / "policies" / f"{name}.onnx").network, np.random.default_rng(8)
    inputs = input_model(*inputs_together(rng, network, count=40, symbols=5, spread=0.01))
    compiled_ = reach_linear(network, inputs, 4)
    monkeypatch.setenv("VIATOOL_ENGINE", "numpy")
    by_numpy = reach_linear(network, inputs, 4)
    for field in ("lower", "upper", "centre", "slope", "rest"):
        np.testing.assert_allclose(getattr(compiled_, field), getattr(by_numpy, field), rtol=1e-9, atol=1e-10)


# --- soundness -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("hidden", STRAIGHT, ids=lambda function: function.name)
def test_bounds_hold_the_exact_values_of_piecewise_linear_networks(hidden: ActivationFunction) -> None:
    for seed in range(3):
        rng = np.random.default_rng(seed)
        for network in (layered(rng, 4, 6, 5, 2, hidden=hidden), branched(rng, hidden)):
            for eps in (0.0, 1e-9, 0.05, 1.0):
                centre = rng.normal(size=(2, 4))
                assert escape(kernel_over(network), centre - eps, centre + eps, seed, **THOROUGH) == 0.0


@pytest.mark.parametrize("hidden", BENT, ids=lambda function: function.name)
def test_bounds_hold_the_values_of_curved_networks(hidden: ActivationFunction) -> None:
    rng = np.random.default_rng(1)
    for network in (
        layered(rng, 4, 6, 2, hidden=hidden),
        layered(rng, 3, 4, 2, hidden=hidden, scale=30.0, last=True),
    ):
        for eps in (0.0, 1e-9, 0.05, 1.0, 8.0):
            centre = rng.normal(size=(1, network.input_size))
            assert escape(kernel_over(network), centre - eps, centre + eps, samples=3, **THOROUGH) == 0.0


@pytest.mark.parametrize("scale", [1e-300, 1e-160, 1e-30, 1e30, 1e100])
def test_bounds_hold_where_numbers_are_tiny_or_huge(scale: float) -> None:
    for seed in range(4):
        rng = np.random.default_rng(seed)
        network = layered(rng, 3, 5, 2, hidden=LEAKY, scale=scale)
        for eps in (0.0, scale, 1.0, 5e-324):
            centre = rng.normal(size=(2, 3)) * scale
            assert escape(kernel_over(network), centre - eps, centre + eps, seed, **THOROUGH) == 0.0


@pytest.mark.parametrize("hidden", STRAIGHT, ids=lambda function: function.name)
def test_bounds_of_parts_hold_the_exact_values_where_their_conditions_hold(
    hidden: ActivationFunction,
) -> None:
    for seed in range(6):
        rng = np.random.default_rng(seed)
        network = layered(rng, 3, 6, 5, 2, hidden=hidden)
        centre = rng.normal(size=(4, 3))
        for eps in (1e-6, 0.3, 2.0):
            assert escape_of_parts(kernel_over(network), centre - eps, centre + eps, seed) == 0.0


def test_a_part_without_a_point_is_known_to_be_empty() -> None:
    network = Network(
        (Input(1), Activation(0, STRAIGHT[0], 1), Affine((1,), (np.ones((1, 1)),), np.zeros(1)))
    )
    one, zero = np.ones((1, 1)), np.zeros((1, 1), dtype=np.int64)
    conditions = (zero + 1, zero, zero + 1, 2.0 * one)
    found = kernel_over(network).examine(-one, one, np.zeros(1, dtype=np.int64), one[0], conditions)
    assert found.bound[0] == -np.inf


def test_bounds_hold_what_float32_programs_do_in_any_order() -> None:
    for seed in range(4):
        rng = np.random.default_rng(seed)
        for hidden in (*STRAIGHT, *BENT[:3]):
            network = single(layered(rng, 4, 6, 5, 2, hidden=hidden))
            centre = rng.normal(size=(4, 4))
            for eps in (0.0, 0.05):
                assert escape_of_programs(kernel_over(network), centre - eps, centre + eps, seed) <= 0.0


def test_a_box_at_a_kink_counts_both_slopes() -> None:
    network = Network(
        (Input(1), Activation(0, activation("Abs"), 1), Affine((1,), (np.ones((1, 1)),), np.zeros(1)))
    )
    for lower, upper in ((0.0, 1.0), (-1.0, 0.0), (-1.0, 1.0), (0.0, 0.0)):
        assert escape(kernel_over(network), np.array([[lower]]), np.array([[upper]]), **THOROUGH) == 0.0


# --- every allowance is needed ---------------------------------------------------------------------------


def _escape_of_sums(**allowances: float) -> float:
    rng = np.random.default_rng(0)
    network = layered(rng, 4, 6, 5, 2, hidden=STRAIGHT[0])
    centre = rng.normal(size=(3, 4))
    return escape(kernel_over(network, **allowances), centre, centre)


def _escape_of_lines(**allowances: float) -> float:
    network = Network((Input(8), Activation(0, LEAKY, 8)))
    centre = -np.abs(np.random.default_rng(0).normal(size=(3, 8)))
    return escape(kernel_over(network, **allowances), centre, centre)


def _escape_of_tables(**allowances: float) -> float:
    network = Network((Input(8), Activation(0, activation("Tanh"), 8)))
    centre = np.random.default_rng(0).normal(size=(3, 8))
    return escape(kernel_over(network, **allowances), centre, centre)


def _escape_of_underflow(**allowances: float) -> float:
    network = layered(np.random.default_rng(0), 3, 4, 2, hidden=LEAKY, scale=1e-200)
    centre = np.full((1, 3), 1e-170)
    plain = tuple(
        Affine(node.sources, node.weights, 0 * node.bias) if isinstance(node, Affine) else node
        for node in network.nodes
    )
    return escape(kernel_over(Network(plain), **allowances), centre, centre)


def _escape_of_errors(**allowances: float) -> float:
    network = layered(np.random.default_rng(3), 4, 8, 2, hidden=STRAIGHT[0])
    centre = np.random.default_rng(4).normal(size=(2, 4))
    return escape(kernel_over(network, **allowances), centre - 1, centre + 1, samples=20)


def _escape_of_program(**allowances: float) -> float:
    network = single(layered(np.random.default_rng(5), 4, 6, 5, 2, hidden=STRAIGHT[0]))
    centre = np.random.default_rng(6).normal(size=(8, 4))
    return escape_of_programs(kernel_over(network, **allowances), centre, centre)


def _escape_of_slopes(**allowances: float) -> float:
    """Return by how much an action is larger in the box than anywhere on the face that is left of it."""
    weights = np.array(
        [[1e16], [-1.0], [-1.0], [-1.0], [2.0 - 1e16]]
    )  # -1 together, 2 as float64 adds them up
    network = Network(
        (
            Input(1),
            Affine((0,), (weights,), np.zeros(5)),
            Affine((1,), (np.ones((1, 5)),), np.zeros(1)),
        )
    )
    found = kernel_over(network, **allowances).bound(np.array([[-1.0]]), np.array([[1.0]]), rounds=4)
    ends = zip((-1, 1), found.face_lower[:, 0], found.face_upper[:, 0], strict=True)
    return max(1.0 - max(sign * low, sign * high) for sign, low, high in ends)


def _escape_of_tilts(**allowances: float) -> float:
    """Return how far the exact value of multipliers lies above what they are said to prove."""
    rng, kernel = (
        np.random.default_rng(7),
        kernel_over(layered(np.random.default_rng(7), 2, 2, hidden=LEAKY), **allowances),
    )
    worst = Fraction(0)
    for _ in range(20):
        objective, forms, slack = rng.normal(size=7), rng.normal(size=(3, 7)), rng.uniform(size=3)
        beta, constant, bound = rng.uniform(size=3), rng.normal(size=1), np.empty(1)
        call("viatool_dual", kernel.packed, 7, 3, constant, objective, forms, slack, beta, bound)
        exact = Fraction(constant[0]) + sum(
            Fraction(b) * Fraction(s) for b, s in zip(beta, slack, strict=True)
        )
        for s in range(7):
            exact += abs(
                Fraction(objective[s]) + sum(Fraction(beta[d]) * Fraction(forms[d, s]) for d in range(3))
            )
        worst = max(worst, exact - Fraction(bound[0]))
    return float(worst)


@pytest.mark.parametrize(
    ("allowance", "check"),
    [
        ("sums", _escape_of_sums),
        ("lines", _escape_of_lines),
        ("lines", _escape_of_tables),
        ("underflow", _escape_of_underflow),
        ("slopes", _escape_of_slopes),
        ("tilts", _escape_of_tilts),
        ("program", _escape_of_program),
        ("errors", _escape_of_errors),
    ],
)
def test_every_allowance_is_needed(allowance: str, check: Any) -> None:
    assert check() <= 0.0
    assert check(**{allowance: 0.0}) > 0.0


# --- beside numpy ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("refine", ["none", "monotone", "split"])
@pytest.mark.parametrize("name", ["via", "via-tanh", "via-mission"])
def test_both_engines_agree_on_shipped_policies(
    name: str, refine: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    policy = viatool.load_policy(ROOT / "policies" / f"{name}.onnx")
    observations = np.random.default_rng(8).uniform(0.3, 3.0, (12, policy.input_size))
    sets = {}
    for chosen in ("numpy", "compiled"):
        with compiled.engine_chosen(monkeypatch, chosen):
            sets[chosen] = reach(policy, observations, 0.01, refine=refine)
    ours, theirs = sets["compiled"], sets["numpy"]
    if refine == "none" and not goes_backwards(policy.network):  # numpy leaves arguments as they are
        np.testing.assert_allclose(ours.width, theirs.width, rtol=1e-6)
    if refine == "none":
        assert ours.attained_width.sum() >= 0.99 * theirs.attained_width.sum()
    assert ours.width.sum() <= theirs.width.sum() * (1 + 1e-6)
    assert (ours.width <= theirs.width * 1.01).all()  # which part is split next may differ


def test_the_best_multipliers_are_found_without_linear_programming(monkeypatch: pytest.MonkeyPatch) -> None:
    network = layered(np.random.default_rng(15), 6, 12, 12, 2, hidden=STRAIGHT[0])
    observations = np.random.default_rng(16).normal(size=(6, 6))
    with compiled.engine_chosen(monkeypatch, "numpy"):
        theirs = reach(bare(network), observations, 0.2, refine="split")

    def refused(*given: Any, **named: Any) -> Any:
        raise AssertionError("a linear program")

    monkeypatch.setattr(duality, "_linear_program", refused)
    ours = reach(bare(network), observations, 0.2, refine="split")
    assert (ours.width <= theirs.width * (1 + 1e-3)).all()
    assert (ours.attained_width >= theirs.attained_width * (1 - 1e-3)).all()


def test_wide_layers_get_the_dual_bound_of_numpy(monkeypatch: pytest.MonkeyPatch) -> None:
    network = layered(np.random.default_rng(9), 6, 130, 130, 2, hidden=STRAIGHT[0])
    observations = np.random.default_rng(10).normal(size=(3, 6))
    width = {}
    for chosen in ("numpy", "compiled"):
        with compiled.engine_chosen(monkeypatch, chosen):
            width[chosen] = reach(bare(network), observations, 0.1, refine="none").width
    assert width["compiled"].sum() <= 1.001 * width["numpy"].sum()


@pytest.mark.parametrize("refine", ["none", "monotone"])
@pytest.mark.parametrize("functions", [(), (BENT[0],), (STRAIGHT[0], BENT[0])], ids=str)
def test_networks_without_weights_get_the_bounds_of_numpy(
    functions: tuple[ActivationFunction, ...], refine: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    network = Network((Input(3), *(Activation(source, each, 3) for source, each in enumerate(functions))))
    observations = np.random.default_rng(18).normal(size=(5, 3))
    sets = {}
    for chosen in ("numpy", "compiled"):
        with compiled.engine_chosen(monkeypatch, chosen):
            assert engine_of(network) == chosen
            sets[chosen] = reach(bare(network), observations, 0.01, refine=refine)
    for end in ("lower", "upper"):
        np.testing.assert_allclose(
            getattr(sets["compiled"], end), getattr(sets["numpy"], end), rtol=1e-12, atol=1e-12
        )


def test_arrays_reach_the_kernel_by_rows_whatever_their_order() -> None:
    network = single(layered(np.random.default_rng(19), 3, 4, 2, hidden=BENT[0]))
    kernel = kernel_over(network)
    centre = np.random.default_rng(20).normal(size=(4, 3))
    found = kernel.bound(centre - 0.1, centre + 0.1)
    hulls = kernel.hulls(found.lower, found.upper)
    by_columns = [(np.asfortranarray(lower), np.asfortranarray(upper)) for lower, upper in hulls]
    given, turned = kernel.deviation(hulls, None), kernel.deviation(by_columns, None)
    assert given is not None
    assert turned is not None
    for ours, theirs in zip(given, turned, strict=True):
        np.testing.assert_array_equal(ours, theirs)


@pytest.mark.parametrize(
    "array",
    [np.zeros((3, 2)).T, np.zeros((4, 4))[:, ::2], np.zeros(3, np.float32), np.zeros(3, ">f8")],
    ids=["columns", "gaps", "float32", "swapped"],
)
def test_an_array_that_is_not_what_c_reads_is_refused(array: np.ndarray) -> None:
    with pytest.raises(BoundsError, match="internal error: an array of"):
        passed(array)


def test_a_state_gets_the_same_bounds_alone_and_among_others() -> None:
    network = layered(np.random.default_rng(11), 5, 9, 9, 2, hidden=BENT[0])
    observations = np.random.default_rng(12).normal(size=(7, 5))
    together = reach(bare(network), observations, 0.1)
    for row in range(7):
        alone = reach(bare(network), observations[row : row + 1], 0.1)
        np.testing.assert_array_equal(alone.lower[0], together.lower[row])
        np.testing.assert_array_equal(alone.upper[0], together.upper[row])


def test_a_wide_node_that_many_narrow_ones_read_has_room(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(17)
    nodes: list[Node] = [Input(3), Affine((0,), (rng.normal(size=(200, 3)),), rng.normal(size=200))]
    for _ in range(40):
        nodes.append(Affine((1,), (rng.normal(size=(2, 200)),), np.zeros(2)))
    reads = tuple(range(2, len(nodes)))
    nodes.append(Affine(reads, tuple(rng.normal(size=(2, 2)) for _ in reads), np.zeros(2)))
    network, observations = Network(tuple(nodes)), rng.normal(size=(2, 3))
    sets = []
    for chosen in ("numpy", "compiled"):
        with compiled.engine_chosen(monkeypatch, chosen):
            sets.append(reach(bare(network), observations, 0.1, arithmetic="real"))
    np.testing.assert_allclose(sets[0].lower, sets[1].lower, rtol=1e-6)
    np.testing.assert_allclose(sets[0].upper, sets[1].upper, rtol=1e-6)


def test_both_engines_refuse_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    huge = Network(
        (
            Input(1),
            Affine((0,), (np.full((1, 1), 1e200),), np.zeros(1), "float64"),
            Affine((1,), (np.full((1, 1), 1e200),), np.zeros(1), "float64"),
        )
    )
    tame = layered(np.random.default_rng(13), 1, 2, 1, hidden=STRAIGHT[0])
    for network, observation in ((tame, np.nan), (tame, np.inf), (huge, 1.0)):
        said = []
        for chosen in ("numpy", "compiled"):
            with compiled.engine_chosen(monkeypatch, chosen), pytest.raises(ViatoolError) as caught:
                reach(bare(network), np.array([[observation]]), 0.1)
            said.append((type(caught.value), str(caught.value)))
        assert said[0] == said[1]


def test_what_the_kernel_leaves_is_bounded_by_numpy() -> None:
    network = layered(np.random.default_rng(14), 2, 4, 2, hidden=BENT[0], scale=1e8)
    observations = np.array([[0.1, 0.2], [3.0, -2.0], [1e-12, 0.0]])
    kernel = kernel_of(network, len(network.nodes))
    assert kernel is not None
    assert not kernel.bound(observations, observations).done.all()
    found = reach(bare(network), observations, 0.0, arithmetic="real")
    assert (found.lower <= network(observations)).all()
    assert (network(observations) <= found.upper).all()
    with pytest.raises(EnclosureError):
        reach(bare(network), observations, 1e300)
