"""Bounds hold for the file's network and for those that run in its place; without the latter they do not."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import onnx
import onnxruntime
import pytest
import sympy
from numpy.typing import NDArray

from tests.policy import rewritten as models
from tests.policy.models import save
from viatool.policy import Policy, load_policy
from viatool.policy.activations import activation
from viatool.policy.network import Activation, Affine, Input, Network
from viatool.taylor.correlated import (
    CorrelatedReach,
    LinearReach,
    input_model,
    reach_correlated,
    reach_linear,
)
from viatool.taylor.reach import networks_of, reach
from viatool.taylor.symbolic import symbolic_actions

Floats = NDArray[np.float64]


def of_networks(network: Network, *rewritten: Network) -> SimpleNamespace:
    """A policy of which no program is run while it is bounded."""
    return SimpleNamespace(network=network, rewritten=rewritten, spec=None)


def excess(policy: Any, program: Policy, centre: Floats, eps: float, **options: Any) -> float:
    """By how much a program leaves the bounds of a policy at most, as written and as it is deployed."""
    found = reach(policy, centre, eps, **options)
    generator = np.random.default_rng(0)
    worst = -np.inf
    for start, lower, upper in zip(centre, found.lower, found.upper, strict=True):
        signs = np.where(generator.random((60, len(start))) < 0.5, -1.0, 1.0)
        rows = np.concatenate([start + eps * signs, start + eps * generator.uniform(-1.0, 1.0, signs.shape)])
        rows = rows.astype(np.float32)
        rows = np.where(rows > start + eps, np.nextafter(rows, np.float32(-np.inf)), rows)
        rows = np.where(rows < start - eps, np.nextafter(rows, np.float32(np.inf)), rows).astype(np.float64)
        for runtime in (program.runtime, program.runtime.at("none")):
            actions = runtime.rows(rows)
            worst = max(worst, float(np.maximum(actions - upper, lower - actions).max()))
    return worst


CASES = {
    "gelu": (models.odd_gelu(), np.array([[10.0]]), 0.01),
    "gelu, the other way": (models.odd_gelu(0.499996), np.array([[10.0], [-0.5]]), 0.001),
    "layer normalisation": (models.layer_norm(4.0), np.array([[0.5, -1.0, 2.0, 0.25]]), 0.01),
}


@pytest.mark.parametrize(("model", "centre", "eps"), CASES.values(), ids=CASES)
@pytest.mark.parametrize("options", [{}, {"refine": "none"}, {"refine": "split"}, {"order": 2}], ids=str)
def test_bounds_hold_for_the_program_as_written_and_as_deployed(
    model: onnx.ModelProto, centre: Floats, eps: float, options: dict[str, Any], tmp_path: Path
) -> None:
    policy = load_policy(save(model, tmp_path))
    assert excess(policy, policy, centre, eps, **options) <= 0.0
    assert excess(of_networks(policy.network), policy, centre, eps, **options) > 0.0  # the file alone


def test_what_another_output_keeps_from_being_joined_counts(tmp_path: Path) -> None:
    """Of the whole file one of two normalisations runs as written, and the other as the runtime has it."""
    path = save(models.shared_normalisation(), tmp_path)
    policy = load_policy(path, output_name="y")
    session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    row = np.array([[0.5, -1.0, 2.0, 0.25]])
    action = session.run(["y"], {"x": row.astype(np.float32)})[0]

    def beyond(given: Any) -> float:
        found = reach(given, row, 0.0)
        return float(np.maximum(action - found.upper, found.lower - action).max())

    assert beyond(policy) <= 0.0
    assert beyond(of_networks(policy.network, policy.rewritten[0])) > 0.0  # what runs for this output alone


def test_real_bounds_are_about_the_file_alone(tmp_path: Path) -> None:
    policy = load_policy(save(models.odd_gelu(), tmp_path))
    row = np.array([[10.0]])
    exact = reach(policy, row, 0.0, arithmetic="real")
    assert exact.upper[0, 0] - exact.lower[0, 0] < 1e-10
    assert exact.lower[0, 0] > 10.00005


def test_what_is_attained_is_attained_by_one_of_the_programs(tmp_path: Path) -> None:
    policy = load_policy(save(models.odd_gelu(), tmp_path))
    found = reach(policy, np.array([[10.0]]), 0.0)
    np.testing.assert_allclose(found.attained_lower, 10.0, rtol=1e-12)
    np.testing.assert_allclose(found.attained_upper, 20.0 * np.float64(np.float32(0.500004)), rtol=1e-12)


def two_programs(seed: int = 0, apart: float = 0.05) -> SimpleNamespace:
    """A policy of two actions whose runtime runs other weights, an other bias, and sharper bends."""
    generator = np.random.default_rng(seed)

    def network(shift: float) -> Network:
        first, second = weights
        return Network(
            (
                Input(3),
                Affine((0,), (first * (1 + shift),), np.full(5, shift)),
                Activation(1, activation("Tanh"), 5),
                Affine((2,), (second,), np.full(2, -shift)),
            )
        )

    weights = generator.normal(size=(5, 3)), generator.normal(size=(2, 5))
    return of_networks(network(0.0), network(apart), network(-2.0 * apart))


def correlated(
    policy: Any,
) -> tuple[Callable[[Floats, Floats], Floats], CorrelatedReach, LinearReach, Floats]:
    """Bounds over inputs that move together, and how to make inputs of symbols."""
    generator = np.random.default_rng(1)
    centre, own = generator.normal(size=(20, 3)), generator.uniform(0.0, 0.02, (20, 3))
    shared = generator.normal(0.0, 0.1, (20, 2, 3))
    inputs = input_model(centre, shared, own)
    networks = networks_of(policy, "float32")
    return (
        lambda z, e: centre + np.einsum("bv,bvn->bn", z, shared) + own * e,
        CorrelatedReach.hull([reach_correlated(network, inputs) for network in networks]),
        LinearReach.hull([reach_linear(network, inputs, 2) for network in networks]),
        shared,
    )


def beyond_correlated(policy: Any, programs: tuple[Network, ...]) -> tuple[float, float, float]:
    """By how much programs leave bounds of `reach_correlated`, of `reach_linear`, and its forms."""
    points, found, linear, _ = correlated(policy)
    generator = np.random.default_rng(2)
    worst = np.full(3, -np.inf)
    for _ in range(100):
        z, e = np.sign(generator.uniform(-1, 1, (20, 2))), generator.uniform(-1, 1, (20, 3))
        form = linear.centre + np.einsum("bv,bva->ba", z, linear.slope)
        for program in programs:
            actions = program(points(z, e))
            excesses = (
                np.maximum(actions - found.upper, found.lower - actions),
                np.maximum(actions - linear.upper, linear.lower - actions),
                np.abs(actions - form) - linear.rest,
            )
            worst = np.maximum(worst, [np.max(one) for one in excesses])
    return tuple(worst)


def test_correlated_bounds_and_forms_hold_for_every_program() -> None:
    policy = two_programs()
    programs = (policy.network, *policy.rewritten)
    assert max(beyond_correlated(policy, programs)) <= 0.0
    alone = of_networks(policy.network)
    assert min(beyond_correlated(alone, programs)) > 0.0


@pytest.mark.parametrize("order", [1, 2])
def test_a_symbolic_action_holds_for_every_program(order: int) -> None:
    policy = two_programs(apart=0.01)
    alone = of_networks(policy.network)
    programs = (policy.network, *policy.rewritten)
    generator = np.random.default_rng(3)
    row, eps = generator.normal(size=3), 0.05

    def beyond(given: Any) -> float:
        worst = -np.inf
        written = symbolic_actions(given, row, eps, order=order)
        symbols = [sympy.Symbol(f"d_x{entry}", real=True) for entry in range(3)]
        polynomials = [sympy.lambdify(symbols, action.polynomial) for action in written]
        for errors in eps * generator.uniform(-1.0, 1.0, (200, 3)):
            for program in programs:
                values = program((row + errors)[None])[0]
                for value, polynomial, action in zip(values, polynomials, written, strict=True):
                    worst = max(worst, abs(value - polynomial(*errors)) - action.remainder)
        return worst

    assert beyond(policy) <= 0.0
    assert beyond(alone) > 0.0
