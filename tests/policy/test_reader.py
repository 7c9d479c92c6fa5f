"""Graphs of every shape that means one observation vector are read as what onnxruntime computes."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper

from tests.policy.models import model_of, node, save, two_layers, weights
from viatool.errors import PolicyError
from viatool.policy import load_policy
from viatool.policy.network import Activation, Affine, Cast

ONES = np.ones((3, 4))


def agrees(path: Path, size: int = 4) -> None:
    policy = load_policy(path)
    observations = np.random.default_rng(0).normal(size=(30, size)).astype(np.float32)
    assert policy.input_size == size
    np.testing.assert_allclose(policy(observations), policy.run(observations), rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize(
    "shape", [(4,), (1, 4), ("batch", 4), (None, 4), (1, 1, 1, 4), (1, 4, 1, 1), (1, 2, 2), ("n", 2, 2)]
)
def test_any_rank_that_means_one_vector(shape: tuple[int | str | None, ...], tmp_path: Path) -> None:
    nodes = [
        node("Reshape", ["x", "flat"], ["f"]),
        node("MatMul", ["f", "w"], ["m"]),
        node("Tanh", ["m"], ["y"]),
    ]
    constants = {"flat": np.array([-1, 4]), "w": weights(1, 4, 2)}
    agrees(save(model_of(nodes, constants, shape=shape), tmp_path))


@pytest.mark.parametrize(
    ("shape", "meaning"),
    [((), "shape"), (("n",), "size"), ((1, "n"), "size"), ((0, 4), "size"), ((1, 2**20), "1048576 numbers")],
)
def test_an_input_without_a_size_is_refused(
    shape: tuple[int | str, ...], meaning: str, tmp_path: Path
) -> None:
    model = model_of([node("Relu", ["x"], ["y"])], shape=shape)
    if not shape:
        model.graph.input[0].type.tensor_type.ClearField("shape")
    with pytest.raises(PolicyError, match=meaning):
        load_policy(save(model, tmp_path))


def test_weights_on_the_left_and_on_the_right(tmp_path: Path) -> None:
    nodes = [
        node("Transpose", ["x"], ["t"], perm=[1, 0]),
        node("MatMul", ["w", "t"], ["m"]),
        node("Add", ["m", "b"], ["a"]),
        node("Relu", ["a"], ["r"]),
        node("Transpose", ["r"], ["u"], perm=[1, 0]),
        node("MatMul", ["u", "v"], ["y"]),
    ]
    constants = {"w": weights(1, 5, 4), "b": weights(2, 5, 1), "v": weights(3, 5, 2)}
    agrees(save(model_of(nodes, constants), tmp_path))


def test_initialisers_listed_as_inputs_are_no_inputs(tmp_path: Path) -> None:
    model = two_layers()
    for tensor in model.graph.initializer:
        model.graph.input.append(helper.make_tensor_value_info(tensor.name, tensor.data_type, tensor.dims))
    agrees(save(model, tmp_path))


@pytest.mark.parametrize("dtype", [TensorProto.FLOAT16, TensorProto.BFLOAT16, TensorProto.DOUBLE])
def test_weights_stored_in_other_precisions(dtype: int, tmp_path: Path) -> None:
    stored = weights(1, 2, 4)
    tensor = helper.make_tensor("w", dtype, [2, 4], stored.ravel().tolist())
    nodes = [node("Cast", ["w"], ["f"], to=TensorProto.FLOAT), node("Gemm", ["x", "f"], ["y"], transB=1)]
    path = save(model_of(nodes, {"w": tensor}), tmp_path)
    agrees(path)
    (affine,) = (n for n in load_policy(path).network.nodes if isinstance(n, Affine))
    np.testing.assert_allclose(affine.weights[0], stored, rtol=2.0**-7)


def test_typed_and_raw_tensors_are_the_same(tmp_path: Path) -> None:
    stored = weights(1, 2, 4)
    call = [node("Gemm", ["x", "w"], ["y"], transB=1)]
    typed = model_of(call, {"w": helper.make_tensor("w", TensorProto.FLOAT, [2, 4], stored.ravel().tolist())})
    raw = model_of(call, {"w": stored})
    assert typed.graph.initializer[0].float_data
    assert raw.graph.initializer[0].raw_data
    one, other = (load_policy(save(m, tmp_path, name)) for m, name in ((typed, "a.onnx"), (raw, "b.onnx")))
    np.testing.assert_array_equal(one(ONES), other(ONES))


@pytest.mark.parametrize("dtype", [TensorProto.DOUBLE, TensorProto.FLOAT16])
def test_the_program_is_known_to_compute_in_another_precision(dtype: int, tmp_path: Path) -> None:
    kind = {TensorProto.DOUBLE: np.float64, TensorProto.FLOAT16: np.float16}[dtype]
    nodes = [node("Gemm", ["x", "w"], ["g"], transB=1), node("Relu", ["g"], ["y"])]
    path = save(model_of(nodes, {"w": weights(1, 2, 4).astype(kind)}, dtype=dtype), tmp_path)
    policy = load_policy(path)
    assert {n.precision for n in policy.network.nodes} == {"float64" if kind is np.float64 else "float16"}
    assert policy.self_check is not None
    assert policy.self_check.largest_tolerance < (1e-13 if kind is np.float64 else 10.0)


def test_a_cast_changes_the_precision_from_there_on(tmp_path: Path) -> None:
    nodes = [
        node("Cast", ["x"], ["d"], to=TensorProto.DOUBLE),
        node("Gemm", ["d", "w"], ["g"], transB=1),
        node("Cast", ["g"], ["y"], to=TensorProto.FLOAT),
    ]
    policy = load_policy(save(model_of(nodes, {"w": weights(1, 2, 4).astype(np.float64)}), tmp_path))
    assert [n.precision for n in policy.network.nodes] == ["float32", "float64", "float64", "float32"]
    assert sum(isinstance(n, Cast) for n in policy.network.nodes) == 2


def test_dead_branches_are_dropped_whatever_they_hold(tmp_path: Path) -> None:
    nodes = [
        node("Tanh", ["x"], ["y"]),
        node("RandomNormalLike", ["x"], ["noise"]),
        node("LSTM", ["x", "noise", "noise"], ["memory"], hidden_size=4),
    ]
    policy = load_policy(save(model_of(nodes), tmp_path))
    assert [type(n).__name__ for n in policy.network.nodes] == ["Input", "Activation"]


def test_a_shape_computation_is_folded(tmp_path: Path) -> None:
    nodes = [
        node("Shape", ["x"], ["s"]),
        node("Gather", ["s", "one"], ["n"], axis=0),
        node("Div", ["n", "two"], ["half"]),
        node("Slice", ["x", "zero", "half", "one"], ["a"]),
        node("Slice", ["x", "half", "n", "one"], ["b"]),
        node("Mul", ["a", "b"], ["y"]),
    ]
    constants = {"zero": np.array([0]), "one": np.array([1]), "two": np.array([2])}
    agrees(save(model_of(nodes, constants), tmp_path))


def test_the_output_is_chosen_by_name_and_never_guessed(tmp_path: Path) -> None:
    nodes = [
        node("Tanh", ["x"], ["action"]),
        node("ReduceSum", ["x"], ["value"]),
        node("Constant", [], ["version"], value_float=3.0),
    ]
    path = save(model_of(nodes, outputs=("action", "value", "version")), tmp_path)

    with pytest.raises(PolicyError, match=r"2 outputs .* action, value"):
        load_policy(path)
    with pytest.raises(PolicyError, match="no output 'speed'"):
        load_policy(path, output_name="speed")
    with pytest.raises(PolicyError, match="does not depend on any input"):
        load_policy(path, output_name="version")
    assert load_policy(path, output_name="action").output_size == 4
    assert load_policy(path, output_name="value").output_size == 1


def test_the_only_output_that_depends_on_the_observation_needs_no_choice(tmp_path: Path) -> None:
    nodes = [node("Tanh", ["x"], ["y"]), node("Constant", [], ["version"], value_float=3.0)]
    assert load_policy(save(model_of(nodes, outputs=("version", "y")), tmp_path)).output_size == 4


def test_an_input_that_the_output_does_not_need_is_ignored(tmp_path: Path) -> None:
    model = model_of([node("Tanh", ["x"], ["y"])])
    model.graph.input.append(helper.make_tensor_value_info("action_masks", TensorProto.FLOAT, [1, 3]))
    agrees(save(model, tmp_path))
    assert load_policy(save(model, tmp_path), input_name="x").input_size == 4
    with pytest.raises(PolicyError, match="no input 'z'"):
        load_policy(save(model, tmp_path), input_name="z")


def scale_function(opset: int) -> onnx.FunctionProto:
    """``scaled(v, factor attribute) = v * factor``, in its own opset."""
    constant = node("Constant", [], ["c"])
    reference = onnx.AttributeProto(
        name="value_float", type=onnx.AttributeProto.FLOAT, ref_attr_name="factor"
    )
    constant.attribute.append(reference)
    return helper.make_function(
        "local", "Scaled", ["v"], ["w"], [constant, node("Mul", ["v", "c"], ["w"])],
        [helper.make_opsetid("", opset)], attributes=["factor"],
    )  # fmt: skip


def test_model_local_functions_are_expanded_in_their_own_opset(tmp_path: Path) -> None:
    twice = helper.make_function(
        "local", "Twice", ["v"], ["w"],
        [
            helper.make_node("Scaled", ["v"], ["inner"], domain="local", factor=0.5),
            helper.make_node("Scaled", ["inner"], ["w"], domain="local", factor=3.0),
        ],
        [helper.make_opsetid("", 17), helper.make_opsetid("local", 1)],
    )  # fmt: skip
    nodes = [
        helper.make_node("Twice", ["x"], ["a"], domain="local"),
        node("Relu", ["a"], ["inner"]),  # the name also stands inside the function
        helper.make_node("Twice", ["inner"], ["y"], domain="local"),
    ]
    model = model_of(nodes, functions=[scale_function(13), twice], domains={"local": 1})
    policy = load_policy(save(model, tmp_path))
    np.testing.assert_allclose(policy(np.array([[1.0, -1.0, 2.0, 0.0]])), [[2.25, 0.0, 4.5, 0.0]])


def test_recursive_and_exploding_functions_are_refused(tmp_path: Path) -> None:
    def calling(name: str, callee: str, times: int) -> onnx.FunctionProto:
        values = ["v", *(f"i{k}" for k in range(times - 1)), "w"]
        calls = [helper.make_node(callee, [a], [b], domain="local") for a, b in pairwise(values)]
        return helper.make_function("local", name, ["v"], ["w"], calls, [helper.make_opsetid("local", 1)])

    start = [helper.make_node("F0", ["x"], ["y"], domain="local")]
    loop = model_of(start, functions=[calling("F0", "F1", 1), calling("F1", "F0", 1)], domains={"local": 1})
    with pytest.raises(PolicyError, match="calls itself"):
        load_policy(save(loop, tmp_path))
    bomb = model_of(
        start, functions=[calling(f"F{k}", f"F{k + 1}", 10) for k in range(12)], domains={"local": 1}
    )
    with pytest.raises(PolicyError, match="nodes"):
        load_policy(save(bomb, tmp_path))


def test_recognised_activations(tmp_path: Path) -> None:
    sqrt_two = np.float32(np.sqrt(2.0))
    graphs = {
        "Silu": [node("Sigmoid", ["x"], ["s"]), node("Mul", ["s", "x"], ["y"])],
        "Mish": [node("Softplus", ["x"], ["s"]), node("Tanh", ["s"], ["t"]), node("Mul", ["x", "t"], ["y"])],
        "Softsign": [
            node("Abs", ["x"], ["a"]),
            node("Add", ["a", "one"], ["b"]),
            node("Div", ["x", "b"], ["y"]),
        ],
        "HardSigmoidGate": [node("HardSigmoid", ["x"], ["s"], alpha=1 / 6), node("Mul", ["x", "s"], ["y"])],
        "SoftplusThreshold": [
            node("Softplus", ["x"], ["s"]),
            node("Greater", ["x", "twenty"], ["c"]),
            node("Where", ["c", "x", "s"], ["y"]),
        ],
        "ErfGate": [
            node("Div", ["x", "root"], ["d"]),
            node("Erf", ["d"], ["e"]),
            node("Add", ["e", "one"], ["f"]),
            node("Mul", ["x", "f"], ["g"]),
            node("Mul", ["g", "half"], ["y"]),
        ],
        "TanhGate": [
            node("Pow", ["x", "three"], ["p"]),
            node("Mul", ["p", "cubic"], ["q"]),
            node("Add", ["x", "q"], ["r"]),
            node("Mul", ["r", "slope"], ["s"]),
            node("Tanh", ["s"], ["t"]),
            node("Add", ["t", "one"], ["u"]),
            node("Mul", ["x", "half"], ["h"]),
            node("Mul", ["h", "u"], ["y"]),
        ],
    }
    constants = {
        "one": np.float32(1), "half": np.float32(0.5), "twenty": np.float32(20), "root": sqrt_two,
        "three": np.float32(3), "cubic": np.float32(0.044715), "slope": np.float32(0.7978845608),
    }  # fmt: skip
    for name, nodes in graphs.items():
        policy = load_policy(save(model_of(nodes, constants, opset=18), tmp_path))
        functions = [n.function.name for n in policy.network.nodes if isinstance(n, Activation)]
        assert functions == [name]


def test_a_product_that_only_looks_like_silu_is_none(tmp_path: Path) -> None:
    nodes = [
        node("Split", ["x"], ["a", "b"], axis=1, num_outputs=2),
        node("Sigmoid", ["a"], ["s"]),
        node("Mul", ["s", "b"], ["y"]),
    ]
    policy = load_policy(save(model_of(nodes, opset=18), tmp_path))
    assert "Product" in [type(n).__name__ for n in policy.network.nodes]


def test_observations_of_the_wrong_size_are_refused(tmp_path: Path) -> None:
    policy = load_policy(save(two_layers(), tmp_path))
    for observations in (np.zeros((3, 5)), np.zeros(4)):
        with pytest.raises(PolicyError, match="takes \\(states, 4\\)"):
            policy(observations)
        with pytest.raises(PolicyError, match="takes \\(states, 4\\)"):
            policy.run(observations)
    assert policy.run(np.zeros((0, 4))).shape == (0, 2)


INTEGERS = np.arange(-60, 60, 10, dtype=np.int32).reshape(4, 3)


@pytest.mark.parametrize("opset", [11, 13, 17, 19, 21])
def test_dequantised_weights_are_read_in_every_version(opset: int, tmp_path: Path) -> None:
    model = model_of(
        [node("DequantizeLinear", ["q", "s"], ["w"]), node("Gemm", ["x", "w"], ["y"])],
        {"q": INTEGERS, "s": np.float32(0.25)},
        opset=opset,
    )
    policy = load_policy(save(model, tmp_path))
    np.testing.assert_array_equal(policy(np.eye(4)), 0.25 * INTEGERS)


def test_a_scale_for_each_channel_in_a_version_that_has_one_alone_is_refused_by_its_reason(
    tmp_path: Path,
) -> None:
    model = model_of(
        [node("DequantizeLinear", ["q", "s"], ["w"]), node("Gemm", ["x", "w"], ["y"])],
        {"q": INTEGERS, "s": np.float32([0.25, 0.5, 1.0])},
        opset=11,
    )
    with pytest.raises(PolicyError, match="a scale for each channel") as caught:
        load_policy(save(model, tmp_path))
    assert "opset_version 13" in caught.value.hint


def test_a_quantised_policy_is_refused_as_such(tmp_path: Path) -> None:
    model = model_of(
        [
            node("QuantizeLinear", ["x", "step", "zero"], ["q"], name="rounded"),
            node("DequantizeLinear", ["q", "step", "zero"], ["d"]),
            node("Relu", ["d"], ["y"]),
        ],
        {"step": np.float32(0.1), "zero": np.int8(0)},
    )
    with pytest.raises(PolicyError, match=r"'rounded' \(QuantizeLinear\).*the policy is quantised") as caught:
        load_policy(save(model, tmp_path))
    assert "before it was quantised" in caught.value.hint
