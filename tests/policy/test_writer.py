"""Networks written as ONNX come back as the same function, with their specification."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnx
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from viatool.policy import (
    ActionChannel,
    Activation,
    Affine,
    Cast,
    Input,
    Maximum,
    Minimum,
    Network,
    ObservationChannel,
    PolicySpecification,
    Product,
    load_policy,
    write_onnx,
)
from viatool.policy.activations import activation
from viatool.policy.network import Node

FUNCTIONS = [
    activation("Relu"),
    activation("Tanh"),
    activation("Sigmoid"),
    activation("RecurrentSigmoid"),
    activation("RecurrentTanh"),
    activation("LeakyRelu", alpha=0.125),
    activation("Elu"),
    activation("Celu", alpha=2.0),
    activation("Selu"),
    activation("Softplus"),
    activation("Softsign"),
    activation("HardSigmoid", alpha=0.25, beta=0.5),
    activation("HardSwish"),
    activation("Silu"),
    activation("Mish"),
    activation("Gelu"),
    activation("GeluTanh"),
    activation("Erf"),
    activation("Abs"),
    activation("Pow", exponent=3.0),
    activation("Clip", min=-0.5, max=0.75),
    activation("Clip", max=0.75),
    activation("Clip", min=-0.5),
    activation("ThresholdedRelu", alpha=0.25),
]


def numbers(generator: np.random.Generator, *shape: int) -> np.ndarray:
    return generator.normal(size=shape).astype(np.float32).astype(np.float64)


def random_network(seed: int, steps: int) -> Network:
    generator = np.random.default_rng(seed)
    nodes: list[Node] = [Input(int(generator.integers(1, 6)))]
    for _ in range(steps):
        source = int(generator.integers(0, len(nodes)))
        size = nodes[source].size
        same = [i for i, n in enumerate(nodes) if n.size == size]
        other = int(generator.choice(same))
        kinds: list[Node] = [
            Affine((source,), (numbers(generator, 3, size),), numbers(generator, 3)),
            Affine((source,), (np.diag(numbers(generator, size)),), numbers(generator, size)),
            Affine((source,), (np.eye(size)[::-1].copy(),), np.zeros(size)),
            Affine((source,), (-np.eye(size),), np.zeros(size)),
            Affine((source,), (np.eye(size),), numbers(generator, size)),
            Affine((), (), numbers(generator, size)),
            Activation(source, FUNCTIONS[int(generator.integers(len(FUNCTIONS)))], size),
        ]
        if other != source:
            mixed = (numbers(generator, 2, size), numbers(generator, 2, size))
            kinds += [
                Affine((source, other), (np.eye(size), np.eye(size)), np.zeros(size)),
                Affine(
                    (source, other),
                    (numbers(generator, 2, size), numbers(generator, 2, size)),
                    numbers(generator, 2),
                ),
                Product(source, other, size),
                Maximum(source, other, size),
                Minimum(source, other, size),
            ]
        nodes.append(kinds[int(generator.integers(len(kinds)))])
    last = nodes[-1]
    mixed = (numbers(generator, 2, last.size), numbers(generator, 2, nodes[0].size))
    nodes.append(Affine((len(nodes) - 1, 0), mixed, numbers(generator, 2)))
    return Network(tuple(nodes))


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(seed=st.integers(0, 10**6), steps=st.integers(1, 8))
@example(seed=4503, steps=5)  # a Max beside a Clip, whose constants must not share a name
def test_a_round_trip_keeps_the_function(seed: int, steps: int, tmp_path: Path) -> None:
    network = random_network(seed, steps)
    path = tmp_path / "policy.onnx"
    write_onnx(network, None, path)

    policy = load_policy(path)

    onnx.checker.check_model(onnx.load(path), full_check=True)
    observations = np.random.default_rng(seed).normal(size=(20, network.input_size))
    expected = network(observations)
    usable = np.isfinite(expected).all(axis=1) & (np.abs(expected) < 1e30).all(axis=1)
    np.testing.assert_allclose(policy(observations)[usable], expected[usable], rtol=1e-12, atol=1e-12)


def test_a_chain_comes_back_bit_for_bit(tmp_path: Path) -> None:
    generator = np.random.default_rng(0)
    nodes = (
        Input(4),
        Affine((0,), (np.diag(numbers(generator, 4)),), numbers(generator, 4)),
        Affine((1,), (numbers(generator, 7, 4),), numbers(generator, 7)),
        Activation(2, activation("Relu"), 7),
        Affine((3,), (numbers(generator, 2, 7),), numbers(generator, 2)),
        Activation(4, activation("Tanh"), 2),
    )
    write_onnx(Network(nodes), None, tmp_path / "policy.onnx")
    policy = load_policy(tmp_path / "policy.onnx")
    observations = generator.normal(size=(100, 4))
    np.testing.assert_array_equal(policy(observations), Network(nodes)(observations))
    assert [n.op_type for n in onnx.load(tmp_path / "policy.onnx").graph.node] == [
        "Mul",
        "Add",
        "Gemm",
        "Relu",
        "Gemm",
        "Tanh",
    ]


def test_other_precisions(tmp_path: Path) -> None:
    weight = np.array([[0.1, 0.2]])
    nodes = (
        Input(2),
        Cast(0, 2, "float64"),
        Affine((1,), (weight,), np.array([0.3]), "float64"),
        Cast(2, 1, "float32"),
    )
    write_onnx(Network(nodes), None, tmp_path / "policy.onnx")
    (affine,) = (n for n in load_policy(tmp_path / "policy.onnx").network.nodes if isinstance(n, Affine))
    np.testing.assert_array_equal(affine.weights[0], weight)


def test_the_specification_travels_in_the_file(tmp_path: Path) -> None:
    spec = PolicySpecification(
        observation=[ObservationChannel(name="x", size=2, unit="m")],
        action=[ActionChannel(name="v", lower=0.0, upper=1.0)],
        training={"seed": 3, "method": "VIA"},
    )
    network = Network((Input(2), Affine((0,), (np.ones((1, 2)),), np.zeros(1))))
    write_onnx(network, spec, tmp_path / "policy.onnx")
    assert load_policy(tmp_path / "policy.onnx").spec == spec
    with pytest.raises(ValueError, match="3 to 1"):
        write_onnx(
            Network((Input(3), Affine((0,), (np.ones((1, 3)),), np.zeros(1)))), spec, tmp_path / "x.onnx"
        )


def test_what_cannot_be_stored_is_refused_and_leaves_no_file(tmp_path: Path) -> None:
    for node in (
        Affine((0,), (np.full((1, 2), 0.1),), np.zeros(1)),
        Activation(0, activation("LeakyRelu", alpha=0.1), 2),
        Activation(0, activation("Clip", min=0.1), 2),
    ):
        with pytest.raises(ValueError, match="representable"):
            write_onnx(Network((Input(2), node)), None, tmp_path / "policy.onnx")
    assert list(tmp_path.iterdir()) == []


def test_writing_twice_gives_the_same_bytes(tmp_path: Path) -> None:
    for name in ("a.onnx", "b.onnx"):
        write_onnx(random_network(1, 5), None, tmp_path / name)
    assert (tmp_path / "a.onnx").read_bytes() == (tmp_path / "b.onnx").read_bytes()
