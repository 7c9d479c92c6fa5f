"""The self-check catches faults of the reader, and rounding alone never trips it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from onnx import TensorProto

from tests.policy.models import model_of, node, save, two_layers, weights
from viatool.cli import main
from viatool.errors import PolicyWarning, SelfCheckError
from viatool.policy import load_policy
from viatool.policy.activations import activation
from viatool.policy.network import Activation, Affine, Network, Node
from viatool.policy.operators import Call, Value, registry
from viatool.policy.runtime import Runtime
from viatool.policy.self_check import check_network

Fault = Callable[[Node], Node]


def damaged(network: Network, fault: Fault) -> Network:
    """Apply a fault to the last node that it changes."""
    nodes = list(network.nodes)
    for index in reversed(range(1, len(nodes))):
        changed = fault(nodes[index])
        if changed is not nodes[index]:
            nodes[index] = changed
            return Network(tuple(nodes))
    raise AssertionError("the fault found nothing to damage")


def wrong_operator(node: Node) -> Node:
    return replace(node, function=activation("Sigmoid")) if isinstance(node, Activation) else node


def dropped_bias(node: Node) -> Node:
    return replace(node, bias=np.zeros(node.size)) if isinstance(node, Affine) and node.bias.any() else node


def transposed_weight(node: Node) -> Node:
    square = (
        isinstance(node, Affine) and node.sources and node.weights[0].shape[0] == node.weights[0].shape[1]
    )
    return replace(node, weights=(node.weights[0].T.copy(),)) if square else node  # type: ignore[union-attr]


def one_wrong_weight(node: Node) -> Node:
    if not isinstance(node, Affine) or not node.sources:
        return node
    weight = node.weights[0].copy()
    weight[-1, -1] *= 1.001
    return replace(node, weights=(weight, *node.weights[1:]))


@pytest.mark.parametrize("fault", [wrong_operator, dropped_bias, transposed_weight, one_wrong_weight])
def test_a_damaged_network_is_caught(fault: Fault, tmp_path: Path) -> None:
    policy = load_policy(save(two_layers(hidden=4), tmp_path))
    with pytest.raises(SelfCheckError, match="disagree"):
        check_network(damaged(policy.network, fault), policy.runtime, None)


def with_reader(
    monkeypatch: pytest.MonkeyPatch, operator: str, reader: Callable[[Call], Sequence[Value]]
) -> None:
    for (name, version), entry in registry.registered().items():
        if name == operator:
            monkeypatch.setitem(registry._REGISTRY, (name, version), replace(entry, reader=reader))


def test_a_reader_that_swaps_the_operands_of_a_difference_is_caught(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    from viatool.policy.operators.linear import weighted_sum

    path = save(model_of([node("Sub", ["c", "x"], ["y"])], {"c": weights(1, 1, 4)}), tmp_path)
    load_policy(path)
    with_reader(
        monkeypatch, "Sub", lambda call: [weighted_sum(call, [call.value(1), call.value(0)], (1.0, -1.0))]
    )
    with pytest.raises(SelfCheckError, match="disagree"):
        load_policy(path)


def test_a_reader_that_joins_along_the_wrong_axis_is_caught(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    from viatool.policy.operators.reduction import summed

    nodes = [node("ReduceSum", ["x", "axes"], ["y"], keepdims=0)]
    path = save(model_of(nodes, {"axes": np.array([1])}, shape=(1, 2, 2)), tmp_path)
    load_policy(path)
    with_reader(monkeypatch, "ReduceSum", lambda call: [summed(call, call.computed(0), [2], keep=False)])
    with pytest.raises(SelfCheckError, match="disagree"):
        load_policy(path)


def test_a_reader_that_forgets_the_bias_is_caught(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    from viatool.policy.operators.matrix import matrix_product

    path = save(
        model_of([node("Gemm", ["x", "w", "b"], ["y"])], {"w": weights(1, 4, 2), "b": weights(2, 2)}),
        tmp_path,
    )
    load_policy(path)
    with_reader(monkeypatch, "Gemm", lambda call: [matrix_product(call, call.value(0), call.value(1))])
    with pytest.raises(SelfCheckError, match="disagree"):
        load_policy(path)


def test_another_number_of_actions_is_caught(tmp_path: Path) -> None:
    two = load_policy(save(two_layers(actions=2), tmp_path, "two.onnx"))
    three = load_policy(save(two_layers(actions=3), tmp_path, "three.onnx"))
    with pytest.raises(SelfCheckError, match="3 actions"):
        check_network(two.network, three.runtime, None)


def test_a_program_that_gives_no_number_is_caught(tmp_path: Path) -> None:
    policy = load_policy(save(two_layers(), tmp_path))

    class Broken(Runtime):
        def rows(self, observations: np.ndarray) -> np.ndarray:  # type: ignore[override]
            return np.full((len(observations), 2), np.nan)

    broken = Broken.__new__(Broken)
    broken.__dict__.update(policy.runtime.__dict__)
    with pytest.raises(SelfCheckError):
        check_network(policy.network, broken, None)


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    seed=st.integers(0, 10**6),
    hidden=st.sampled_from([1, 7, 64, 300]),
    scale=st.sampled_from([1e-3, 1.0, 30.0]),
    bend=st.sampled_from(["Relu", "Tanh", "Sigmoid", "Elu", "Softplus", "Mish", "HardSwish"]),
)
def test_rounding_alone_never_trips_the_check(
    seed: int, hidden: int, scale: float, bend: str, tmp_path: Path
) -> None:
    nodes = [
        node("Gemm", ["x", "w1", "b1"], ["h"], transB=1),
        node(bend, ["h"], ["r"]),
        node("Gemm", ["r", "w2"], ["o"], transB=1),
        node("Tanh", ["o"], ["y"]),
    ]
    constants = {
        "w1": weights(seed, hidden, 26, scale=scale),
        "b1": weights(seed + 1, hidden, scale=scale),
        "w2": weights(seed + 2, 2, hidden, scale=1 / hidden**0.5),
    }
    policy = load_policy(save(model_of(nodes, constants, shape=(1, 26), opset=18), tmp_path))
    assert policy.self_check is not None
    assert policy.self_check.points > 0


def test_the_tolerance_is_small_where_rounding_is_small(tmp_path: Path) -> None:
    check = load_policy(save(two_layers(), tmp_path)).self_check
    assert check is not None
    assert check.largest_tolerance < 1e-3


def test_roundings_that_cancel_in_a_few_simulations_do_not_trip_it(tmp_path: Path) -> None:
    """A softmax and a cast to float16 err by nearly the same, so that both may cancel in all simulations."""
    halves = [node("Cast", ["s"], ["h"], to=TensorProto.FLOAT16), node("Cast", ["h"], ["y"], to=1)]
    policy = load_policy(save(model_of([node("Softmax", ["x"], ["s"]), *halves]), tmp_path))
    for seed in range(40):
        check_network(policy.network, policy.runtime, None, seed=seed)


def test_observations_that_rounding_moves_out_of_a_domain_are_left_out(tmp_path: Path) -> None:
    """Where a sigmoid vanishes in float32, its logarithm is minus infinity in the program alone."""
    nodes = [
        node("MatMul", ["x", "w"], ["a"]),
        node("Sigmoid", ["a"], ["s"]),
        node("Log", ["s"], ["l"]),
        node("ReduceMean", ["l"], ["y"], axes=[1], keepdims=1),
    ]
    policy = load_policy(save(model_of(nodes, {"w": weights(0, 4, 3, scale=10.0)}), tmp_path))
    for seed in range(10):
        check_network(policy.network, policy.runtime, None, seed=seed)


def test_observations_on_which_a_partial_sum_overflows_are_left_out(tmp_path: Path) -> None:
    weight = np.array([[2.5e38], [2.5e38], [-2.5e38], [-2.4e38]], dtype=np.float32)
    policy = load_policy(save(model_of([node("MatMul", ["x", "w"], ["y"])], {"w": weight}), tmp_path))
    for seed in range(10):
        check_network(policy.network, policy.runtime, None, seed=seed)


def test_a_comparison_that_rounding_could_explain_whatever_it_says_counts_for_nothing(tmp_path: Path) -> None:
    """``1.5 (relu(x) + 2^27) + tanh(x) - 1.5 2^27`` in float32 holds no digit of x: nearly any action would do."""
    nodes = [
        node("Relu", ["x"], ["r"]),
        node("Add", ["r", "large"], ["a"]),
        node("Tanh", ["x"], ["t"]),
        node("Mul", ["a", "factor"], ["s"]),
        node("Add", ["s", "t"], ["m"]),
        node("Sub", ["m", "larger"], ["y"]),
    ]
    constants = {
        name: np.float32(v) for name, v in (("large", 2**27), ("factor", 1.5), ("larger", 1.5 * 2**27))
    }
    path = save(model_of(nodes, constants), tmp_path)
    with pytest.warns(PolicyWarning, match="could explain nearly any difference"):
        check = load_policy(path).self_check
    assert check is not None
    assert check.points == 0
    told = CliRunner().invoke(main, ["inspect", str(path)])
    assert "could explain nearly any difference" in " ".join(told.output.split())
