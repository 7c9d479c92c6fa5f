"""What onnxruntime runs in place of a file: read, compared, kept beside the file's network, or refused by name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

import numpy as np
import onnx
import pytest

from tests.policy import rewritten as models
from tests.policy.enclosure import escapes
from tests.policy.models import model_of, node, save, two_layers, weights
from viatool.errors import PolicyError, SelfCheckError
from viatool.policy import Policy, describe, load_policy
from viatool.policy.activations import activation
from viatool.policy.executed import Executed
from viatool.policy.fused import fused_operators
from viatool.policy.identity import is_same
from viatool.policy.network import Activation, Affine, Input, Maximum, Network, Node, Product
from viatool.policy.runtime import Optimisation, Runtime
from viatool.policy.self_check import check_executed

LEVELS = get_args(Optimisation)
OURS = {"domain": "com.microsoft"}


def operators(policy: Policy, level: Optimisation = "default") -> list[str]:
    """Return what onnxruntime runs at a level."""
    return [call.op_type for call in policy.runtime.at(level).executed_model().graph.node]


def is_power(node: Node) -> bool:
    return isinstance(node, Activation) and node.function.name == "Pow"


# Which networks are one


def example() -> list[Node]:
    """Input, two layers side by side, and what couples them."""
    weight = np.arange(6.0).reshape(2, 3) + 1.0
    return [
        Input(3),
        Affine((0,), (weight,), np.array([0.5, -1.0])),
        Affine((0,), (2.0 * weight,), np.zeros(2), roundings=1),
        Activation(1, activation("LeakyRelu", alpha=0.25), 2),
        Product(2, 3, 2),
        Affine((3, 4), (np.eye(2), 3.0 * np.eye(2)), np.zeros(2)),
    ]


def changed(index: int, **fields: Any) -> Callable[[], list[Node]]:
    def make() -> list[Node]:
        nodes = example()
        nodes[index] = replace(nodes[index], **fields)  # type: ignore[type-var]
        return nodes

    return make


def nudged() -> list[Node]:
    nodes = example()
    assert isinstance(nodes[1], Affine)
    weight = nodes[1].weights[0].copy()
    weight[1, 2] = np.nextafter(weight[1, 2], 9.0)
    nodes[1] = replace(nodes[1], weights=(weight,))
    return nodes


OTHERS = {
    "a weight by one place": nudged,
    "a bias": changed(1, bias=np.array([0.5, -1.0 + 2.0**-52])),
    "roundings": changed(2, roundings=2),
    "what was merged": changed(2, merged_weights=(np.full((2, 3), 99.0),)),
    "what was merged into the bias": changed(2, merged_bias=np.ones(2)),
    "a precision": changed(4, precision="float16"),
    "a parameter": changed(3, function=activation("LeakyRelu", alpha=0.125)),
    "a function": changed(3, function=activation("Relu")),
    "a kind": lambda: [*example()[:4], Maximum(2, 3, 2), example()[5]],
    "a source": changed(3, source=2),
    "a source twice": changed(4, left=3, right=3),
    "weights exchanged between sources": changed(5, weights=(3.0 * np.eye(2), np.eye(2))),
    "the input": changed(0, precision="float64"),
}


@pytest.mark.parametrize("other", OTHERS.values(), ids=OTHERS)
def test_networks_that_differ_in_anything_are_not_the_same(other: Callable[[], list[Node]]) -> None:
    assert not is_same(Network(tuple(example())), Network(tuple(other())))


def test_networks_are_the_same_whatever_the_order_of_nodes_and_sources() -> None:
    nodes = example()
    first, second, bend = nodes[1], nodes[2], nodes[3]
    turned = [
        nodes[0],
        second,
        first,
        replace(bend, source=2),  # type: ignore[type-var]
        Product(3, 1, 2),
        Affine((4, 3), (3.0 * np.eye(2), np.eye(2)), np.zeros(2)),
    ]
    assert is_same(Network(tuple(nodes)), Network(tuple(turned)))


# What is kept


@pytest.mark.parametrize("name", ["via", "via-tanh"])
def test_joined_layers_are_the_network_of_the_file(name: str) -> None:
    policy = load_policy(name)
    assert "FusedGemm" in operators(policy)
    assert policy.rewritten == ()


REWRITTEN = {
    "gelu": (models.odd_gelu(), "Gelu"),
    "layer normalisation": (models.layer_norm(4.0), "LayerNormalization"),
    "layer normalisation in an older opset": (models.layer_norm(4.0, opset=13), "LayerNormalization"),
}


@pytest.mark.parametrize(("model", "operator"), REWRITTEN.values(), ids=REWRITTEN)
def test_what_computes_something_else_is_kept_beside_the_file(
    model: onnx.ModelProto, operator: str, tmp_path: Path
) -> None:
    policy = load_policy(save(model, tmp_path))

    assert operator in operators(policy)
    (other,) = policy.rewritten
    assert not is_same(other, policy.network)
    rows = np.random.default_rng(0).normal(size=(20, policy.input_size)).astype(np.float32).astype(np.float64)
    np.testing.assert_allclose(policy.run(rows), other(rows), rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(policy.runtime.at("none").rows(rows), policy(rows), rtol=1e-5, atol=1e-6)


def test_constants_are_computed_in_the_precision_in_which_the_program_computes_them(tmp_path: Path) -> None:
    """A processor without float16 multiplies the two numbers in float32, and rounds the product to nothing less."""
    model = models.halves()
    policy = load_policy(save(model, tmp_path))
    first, second = (
        onnx.numpy_helper.to_array(stored).astype(np.float32) for stored in model.graph.initializer
    )

    rows = np.eye(4)
    assert (policy.run(rows) == np.diag(first * second)).all()
    (other,) = policy.rewritten
    assert (other(rows) == np.diag(first * second)).all()


def test_what_another_output_keeps_from_being_joined_is_a_network_of_its_own(tmp_path: Path) -> None:
    policy = load_policy(save(models.shared_normalisation(), tmp_path), output_name="y")
    exponents = [
        {dict(node.function.parameters)["exponent"] for node in network.nodes if is_power(node)}
        for network in (policy.network, *policy.rewritten)
    ]
    assert exponents == [{4.0}, {2.0}, {2.0, 4.0}]


def test_several_outputs_that_cannot_be_run_together_do_not_matter(tmp_path: Path) -> None:
    model = two_layers()
    model.graph.node.append(node("Unheard", ["x"], ["other"], domain="com.example"))
    model.opset_import.append(onnx.helper.make_opsetid("com.example", 1))
    model.graph.output.append(onnx.helper.make_tensor_value_info("other", onnx.TensorProto.FLOAT, None))
    assert load_policy(save(model, tmp_path), output_name="y").rewritten == ()


@pytest.mark.parametrize("kind", [np.float16, np.float64])
def test_a_rectifier_with_a_slope_for_each_element_is_read_where_it_is_run_as_a_selection(
    kind: Any, tmp_path: Path
) -> None:
    """Without a kernel for the type, onnxruntime compares with 0 and selects."""
    dtype = onnx.helper.np_dtype_to_tensor_dtype(np.dtype(kind))
    slopes = {"s": np.array([0.25, 0.1, -0.5, 1e-3], dtype=kind)}
    policy = load_policy(save(model_of([node("PRelu", ["x", "s"], ["y"])], slopes, dtype=dtype), tmp_path))

    assert "Where" in operators(policy, "none")
    assert escapes(policy, samples=2000) == 0


# What cannot be read


def test_integer_arithmetic_that_the_optimiser_puts_in_is_refused_by_name(tmp_path: Path) -> None:
    path = save(models.integer_product(), tmp_path)
    with pytest.raises(
        PolicyError, match=r"runs it at .* 'extended': 1 node .*\n.*MatMulNBits.* 8 bits"
    ) as caught:
        load_policy(path)
    assert "dequantise" in caught.value.hint
    assert "MatMulNBits" in str(describe(path).problems[0])


def test_a_runtime_that_does_not_write_what_it_runs_is_refused(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    import onnxruntime

    path, session = save(two_layers(), tmp_path), onnxruntime.InferenceSession

    def silent(model: bytes, options: Any, **others: Any) -> Any:
        options.optimized_model_filepath = ""
        return session(model, options, **others)

    monkeypatch.setattr(onnxruntime, "InferenceSession", silent)
    with pytest.raises(PolicyError, match="does not write the model that it runs"):
        load_policy(path)


def test_a_folder_that_cannot_be_written_is_refused(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def full(*_: Any, **__: Any) -> Any:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("viatool.policy.runtime.tempfile.TemporaryDirectory", full)
    with pytest.raises(PolicyError, match="No space left on device"):
        load_policy(save(two_layers(), tmp_path))


# The check of both


@pytest.mark.parametrize("level", ["none", "default"])
def test_the_self_check_runs_the_program_as_it_is_deployed_and_as_it_was_written(
    level: Optimisation, tmp_path: Path
) -> None:
    policy = load_policy(save(two_layers(), tmp_path))
    wrong = replace(policy.network.nodes[-1], function=activation("Sigmoid"))  # type: ignore[type-var]
    networks = dict.fromkeys(LEVELS, policy.network) | {level: Network((*policy.network.nodes[:-1], wrong))}
    with pytest.raises(SelfCheckError, match="disagree"):
        check_executed(Executed(networks, ()), policy.runtime, None)


def test_levels_of_optimisation_are_those_of_onnxruntime(tmp_path: Path) -> None:
    policy = load_policy(save(models.odd_gelu(), tmp_path))
    rows = np.array([[10.0]])
    values = {level: float(policy.runtime.at(level).rows(rows)[0, 0]) for level in LEVELS}
    assert values["none"] > 10.00005
    assert values["default"] < 10.00001


# Operators of onnxruntime's own


def pair(*calls: onnx.NodeProto, shape: tuple[int, ...] = (1, 4), **constants: Any) -> onnx.ModelProto:
    return model_of(calls, constants, shape=shape, domains={"com.microsoft": 1})


W, B = weights(1, 4, 3), weights(2, 3)
GEMM = {"alpha": 0.5, **OURS}
ACTIVATIONS: dict[str, dict[str, float]] = {
    "Elu": {"activation_alpha": 0.3},
    "HardSigmoid": {"activation_alpha": 0.3, "activation_beta": 0.4},
    "LeakyRelu": {"activation_alpha": 0.3},
    "Relu": {},
    "Selu": {"activation_alpha": 1.5, "activation_gamma": 1.1},
    "Sigmoid": {},
    "Softplus": {},
    "Softsign": {},
    "Tanh": {},
    "ThresholdedRelu": {"activation_alpha": 0.3},
}
NORMAL = {"g": weights(5, 4), "b": weights(6, 4), "c": weights(7, 4)}
KERNEL = {"w": weights(1, 3, 2, 3), "b": weights(2, 3)}

FUSED: dict[str, onnx.ModelProto] = {
    **{
        f"FusedGemm {name}": pair(
            node("FusedGemm", ["x", "w", "b"], ["y"], activation=name, **numbers, **GEMM), w=W, b=B
        )
        for name, numbers in ACTIVATIONS.items()
    },
    "FusedMatMul alpha": pair(node("FusedMatMul", ["x", "w"], ["y"], alpha=0.3, **OURS), w=W),
    "FusedMatMul transA": pair(
        node("FusedMatMul", ["x", "w"], ["y"], transA=1, **OURS), shape=(1, 2, 4), w=weights(3, 2, 3)
    ),
    "FusedMatMul transB": pair(
        node("Tanh", ["x"], ["t"]), node("FusedMatMul", ["x", "t"], ["y"], transB=1, **OURS), shape=(1, 2, 4)
    ),
    "FusedConv Relu": pair(
        node("FusedConv", ["x", "w", "b"], ["y"], activation="Relu", pads=[1, 1], **OURS),
        shape=(1, 2, 4),
        **KERNEL,
    ),
    "FusedConv Clip": pair(
        node("FusedConv", ["x", "w"], ["y"], activation="Clip", activation_params=[-0.3, 0.7], **OURS),
        shape=(1, 2, 4),
        w=KERNEL["w"],
    ),
    "FusedConv HardSigmoid": pair(
        node("FusedConv", ["x", "w"], ["y"], activation="HardSigmoid", activation_params=[0.3, 0.4], **OURS),
        shape=(1, 2, 4),
        w=KERNEL["w"],
    ),
    "FusedConv sum": pair(
        node(
            "FusedConv", ["x", "w", "", "z"], ["y"], activation="LeakyRelu", activation_params=[0.3], **OURS
        ),
        shape=(1, 2, 4, 4),
        w=weights(1, 3, 2, 3, 3),
        z=weights(3, 1, 3, 2, 2),
    ),
    "Gelu": pair(node("Gelu", ["x"], ["y"], **OURS)),
    "BiasGelu": pair(node("BiasGelu", ["x", "b"], ["y"], **OURS), b=NORMAL["b"]),
    "FastGelu": pair(node("FastGelu", ["x"], ["y"], **OURS)),
    "FastGelu bias": pair(node("FastGelu", ["x", "b"], ["y"], **OURS), b=NORMAL["b"]),
    "QuickGelu": pair(node("QuickGelu", ["x"], ["y"], **OURS)),
    "QuickGelu alpha": pair(node("QuickGelu", ["x"], ["y"], alpha=1.0, **OURS)),
    "SkipLayerNormalization": pair(
        node("SkipLayerNormalization", ["x", "s", "g", "b", "c"], ["y"], epsilon=1e-3, **OURS),
        shape=(1, 2, 4),
        s=weights(8, 1, 2, 4),
        **NORMAL,
    ),
    "SkipLayerNormalization sum": pair(
        node("SkipLayerNormalization", ["x", "s", "g"], ["n", "", "", "t"], **OURS),
        node("Add", ["n", "t"], ["y"]),
        shape=(1, 2, 4),
        s=weights(8, 1, 2, 4),
        g=NORMAL["g"],
    ),
    "SkipSimplifiedLayerNormalization": pair(
        node("SkipSimplifiedLayerNormalization", ["x", "s", "g", "c"], ["y"], epsilon=1e-3, **OURS),
        shape=(1, 2, 4),
        s=weights(8, 1, 2, 4),
        g=NORMAL["g"],
        c=NORMAL["c"],
    ),
    "SimplifiedLayerNormalization": pair(
        node("SimplifiedLayerNormalization", ["x", "g"], ["y"], epsilon=1e-3), g=NORMAL["g"]
    ),
}


@pytest.mark.parametrize("model", FUSED.values(), ids=FUSED)
def test_an_operator_of_onnxruntime_means_what_it_computes(model: onnx.ModelProto, tmp_path: Path) -> None:
    policy = load_policy(save(model, tmp_path))
    rows = np.random.default_rng(3).normal(size=(50, policy.input_size)).astype(np.float32)
    np.testing.assert_allclose(policy(rows), policy.run(rows), rtol=2e-5, atol=2e-5)


def test_every_operator_that_is_read_through_its_parts_is_compared() -> None:
    written = {name.split()[0] for name in FUSED} | {"LayerNormalization"}  # in an older opset, above
    assert {name.split(".")[-1] for name in fused_operators()} == written


@pytest.mark.parametrize(
    ("call", "reason"),
    [
        (node("FusedGemm", ["x", "w", "b"], ["y"], name="culprit", activation="Swirl", **OURS), "'Swirl'"),
        (node("FusedMatMul", ["x", "w"], ["y"], name="culprit", transBatchA=1, **OURS), "first axis"),
        (node("Inverse", ["x"], ["y"], name="culprit", **OURS), "not ONNX"),
    ],
    ids=["activation", "batches", "unknown"],
)
def test_what_an_operator_of_onnxruntime_does_otherwise_is_refused(
    call: onnx.NodeProto, reason: str, tmp_path: Path
) -> None:
    with pytest.raises(PolicyError, match=f"culprit.*{reason}"):
        load_policy(save(pair(call, w=W, b=B), tmp_path))


def test_a_runtime_at_another_level_has_sessions_of_its_own(tmp_path: Path) -> None:
    runtime = load_policy(save(models.odd_gelu(), tmp_path)).runtime
    plain = runtime.at("none")
    assert isinstance(plain, Runtime)
    assert (runtime.rows(np.array([[10.0]])) != plain.rows(np.array([[10.0]]))).all()
