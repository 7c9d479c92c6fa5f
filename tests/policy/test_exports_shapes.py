"""Graphs in the shapes that Keras, MATLAB, ML-Agents and Isaac Lab write, built by hand."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper

from tests.policy.models import model_of, node, save, weights
from tests.policy.test_exports_torch import assert_enclosed
from viatool.errors import PolicyError
from viatool.policy import ActionChannel, ObservationChannel, PolicySpecification, load_policy


def keras() -> onnx.ModelProto:
    """tf2onnx: Normalization as Sub and Div, Dense as MatMul and Add, one Dense with its kernel on the left."""
    return model_of(
        [
            node("Sub", ["x", "mean"], ["centred"], name="normalization/sub"),
            node("Div", ["centred", "std"], ["normal"], name="normalization/truediv"),
            node("MatMul", ["normal", "w1"], ["m1"], name="dense/MatMul"),
            node("Add", ["m1", "b1"], ["a1"], name="dense/BiasAdd"),
            node("Elu", ["a1"], ["h1"]),
            node("Transpose", ["h1"], ["t1"], perm=[1, 0]),
            node("MatMul", ["w2", "t1"], ["m2"]),
            node("Transpose", ["m2"], ["m2t"], perm=[1, 0]),
            node("Add", ["b2", "m2t"], ["a2"]),
            node("Mul", ["a2", "s2"], ["scaled"]),
            node("Tanh", ["scaled"], ["y"]),
        ],
        {
            "mean": weights(1, 1, 6), "std": np.abs(weights(2, 1, 6)) + np.float32(0.5), "w1": weights(3, 6, 8),
            "b1": weights(4, 8), "w2": weights(5, 2, 8), "b2": weights(6, 2), "s2": np.float32(0.5),
        },
        shape=("unk__7", 6), opset=15,
    )  # fmt: skip


def matlab() -> onnx.ModelProto:
    """exportONNXNetwork: [1,1,1,n] input, the mean subtracted, layers as convolutions, a scaling layer."""
    return model_of(
        [
            node("Sub", ["x", "input_Mean"], ["input_Sub"]),
            node("Transpose", ["input_Sub"], ["channels"], perm=[0, 3, 1, 2]),
            node("Conv", ["channels", "fc1_W", "fc1_B"], ["fc1"], kernel_shape=[1, 1], strides=[1, 1]),
            node("LeakyRelu", ["fc1"], ["act1"], alpha=0.01),
            node("BatchNormalization", ["act1", "s", "b", "m", "v"], ["norm"], epsilon=1e-5),
            node("Conv", ["norm", "fc2_W"], ["fc2"], kernel_shape=[1, 1]),
            node("Add", ["fc2", "fc2_B"], ["fc2b"]),
            node("Tanh", ["fc2b"], ["tanh"]),
            node("Mul", ["tanh", "scale"], ["scaled"]),
            node("Flatten", ["scaled"], ["y"], axis=1),
        ],
        {
            "input_Mean": weights(1, 1, 1, 1, 6), "fc1_W": weights(2, 8, 6, 1, 1), "fc1_B": weights(3, 8),
            "s": weights(4, 8), "b": weights(5, 8), "m": weights(6, 8), "v": np.abs(weights(7, 8)) + np.float32(0.1),
            "fc2_W": weights(8, 2, 8, 1, 1), "fc2_B": weights(9, 1, 2, 1, 1), "scale": weights(10, 1, 2, 1, 1),
        },
        shape=(1, 1, 1, 6), opset=9,
    )  # fmt: skip


def ml_agents() -> onnx.ModelProto:
    """Several outputs, constants among them, a mask input, a clip and a division by 3 at the end."""
    model = model_of(
        [
            node("Constant", [], ["version_number"], value_floats=[3.0]),
            node("Constant", [], ["memory_size"], value_floats=[0.0]),
            node("Sub", ["x", "running_mean"], ["c"]),
            node("Sqrt", ["variance"], ["deviation"]),
            node("Div", ["c", "deviation"], ["d"]),
            node("Clip", ["d", "minus_five", "five"], ["n"]),
            node("Concat", ["n"], ["inputs"], axis=-1),
            node("Gemm", ["inputs", "w1", "b1"], ["g1"], transB=1),
            node("Sigmoid", ["g1"], ["s1"]),
            node("Mul", ["g1", "s1"], ["swish"]),
            node("Gemm", ["swish", "w2", "b2"], ["mu"], transB=1),
            node("RandomNormalLike", ["mu"], ["noise"]),
            node("Add", ["mu", "noise"], ["sampled"]),
            node("Clip", ["sampled", "minus_three", "three"], ["sampled_clip"]),
            node("Div", ["sampled_clip", "three"], ["continuous_actions"]),
            node("Clip", ["mu", "minus_three", "three"], ["mean_clip"]),
            node("Div", ["mean_clip", "three"], ["deterministic_continuous_actions"]),
        ],
        {
            "running_mean": weights(1, 6), "variance": np.abs(weights(2, 6)) + np.float32(0.3), "w1": weights(3, 8, 6),
            "b1": weights(4, 8), "w2": weights(5, 2, 8), "b2": weights(6, 2), "five": np.float32(5),
            "minus_five": np.float32(-5), "three": np.float32(3), "minus_three": np.float32(-3),
        },
        shape=("batch", 6), opset=13,
        outputs=("version_number", "memory_size", "continuous_actions", "deterministic_continuous_actions"),
    )  # fmt: skip
    model.graph.input.append(helper.make_tensor_value_info("action_masks", TensorProto.FLOAT, ["batch", 4]))
    return model


def isaac_lab() -> onnx.ModelProto:
    """An empirical normaliser inside, ELU layers, float32 throughout, names with slashes and dots."""
    return model_of(
        [
            node("Sub", ["x", "normalizer._mean"], ["/normalizer/Sub"]),
            node("Add", ["normalizer._std", "/normalizer/eps"], ["/normalizer/Add"]),
            node("Div", ["/normalizer/Sub", "/normalizer/Add"], ["/normalizer/Div"]),
            node("Gemm", ["/normalizer/Div", "actor.0.weight", "actor.0.bias"], ["/actor.0/Gemm"], transB=1),
            node("Elu", ["/actor.0/Gemm"], ["/actor.1/Elu"]),
            node("Gemm", ["/actor.1/Elu", "actor.2.weight", "actor.2.bias"], ["y"], transB=1),
        ],
        {
            "normalizer._mean": weights(1, 1, 6), "normalizer._std": np.abs(weights(2, 1, 6)) + np.float32(0.1),
            "/normalizer/eps": np.float32(0.01), "actor.0.weight": weights(3, 8, 6), "actor.0.bias": weights(4, 8),
            "actor.2.weight": weights(5, 2, 8), "actor.2.bias": weights(6, 2),
        },
        shape=(1, 6), opset=18,
    )  # fmt: skip


SPEC: dict[str, Any] = {
    "observation": [ObservationChannel(name="state", size=6)],
    "action": [ActionChannel(name="v", lower=0, upper=1), ActionChannel(name="w", lower=-1, upper=1)],
}


@pytest.mark.parametrize("build", [keras, matlab, isaac_lab])
def test_the_graph_is_read_and_enclosed(build: Any, tmp_path: Path) -> None:
    policy = load_policy(save(build(), tmp_path))
    assert (policy.input_size, policy.output_size) == (6, 2)
    assert_enclosed(policy)


def test_ml_agents_needs_a_choice_and_refuses_the_sampled_action(tmp_path: Path) -> None:
    path = save(ml_agents(), tmp_path)
    with pytest.raises(PolicyError, match="continuous_actions, deterministic_continuous_actions") as choice:
        load_policy(path)
    assert "output:" in choice.value.hint
    with pytest.raises(PolicyError, match="stochastic"):
        load_policy(path, output_name="continuous_actions")

    spec = PolicySpecification(**SPEC, output="deterministic_continuous_actions")
    policy = load_policy(path, spec)
    assert (policy.input_size, policy.output_size) == (6, 2)
    assert_enclosed(policy)
