"""The deployed program: single rows exactly, batches where the model allows them."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest

from tests.policy.models import model_of, node, save, two_layers, weights
from viatool.errors import PolicyError
from viatool.policy import load_policy

OBSERVATIONS = np.random.default_rng(0).normal(size=(200, 4)).astype(np.float32)


@pytest.mark.parametrize("shape", [("batch", 4), (1, 4)])
def test_single_rows_are_bit_for_bit_what_onnxruntime_gives(
    shape: tuple[int | str, ...], tmp_path: Path
) -> None:
    model = two_layers()
    del model.graph.input[0].type.tensor_type.shape.dim[0]
    model.graph.input[0].CopyFrom(model_of([node("Relu", ["x"], ["y"])], shape=shape).graph.input[0])
    path = save(model, tmp_path)
    session = onnxruntime.InferenceSession(str(path))
    policy = load_policy(path)
    for row in OBSERVATIONS[:20]:
        expected = session.run(None, {"x": row[None]})[0]
        np.testing.assert_array_equal(policy.run(row[None]), expected)


def test_a_model_for_one_observation_runs_batches(tmp_path: Path) -> None:
    nodes = [node("Gemm", ["x", "w"], ["g"], transB=1), node("Tanh", ["g"], ["y"])]
    policy = load_policy(save(model_of(nodes, {"w": weights(1, 2, 4)}, shape=(1, 4)), tmp_path))
    assert policy.runtime.batches
    one_by_one = np.concatenate([policy.run(row[None]) for row in OBSERVATIONS])
    np.testing.assert_allclose(policy.run(OBSERVATIONS), one_by_one, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize(
    "nodes",
    [
        [node("Reshape", ["x", "flat"], ["f"]), node("MatMul", ["f", "w"], ["y"])],
        [
            node("ReduceMean", ["x"], ["m"], axes=[0], keepdims=1),
            node("Sub", ["x", "m"], ["d"]),
            node("Add", ["d", "x"], ["y"]),
        ],
        [node("Softmax", ["x"], ["s"], axis=0), node("Add", ["s", "x"], ["y"])],
    ],
    ids=["static reshape", "mean over the batch", "softmax over the batch"],
)
@pytest.mark.parametrize("shape", [("batch", 4), (1, 4)])
def test_a_model_that_mixes_a_batch_runs_one_by_one(
    nodes: list[onnx.NodeProto], shape: tuple[int | str, ...], tmp_path: Path
) -> None:
    constants = {"flat": np.array([1, -1]), "w": weights(1, 4, 2)}
    policy = load_policy(save(model_of(nodes, constants, shape=shape), tmp_path))
    assert not policy.runtime.batches
    np.testing.assert_allclose(policy.run(OBSERVATIONS), policy(OBSERVATIONS), rtol=1e-5, atol=1e-6)


MEAN = node("ReduceMean", ["x"], ["m"], axes=[0], keepdims=1)
LARGEST = node("ReduceMax", ["x"], ["m"], axes=[0], keepdims=1)


def opened_by(name: str, *before: onnx.NodeProto, product: bool = False) -> list[onnx.NodeProto]:
    """Return x and a gate that is closed where the value of the name is below 50; or the mean times that gate."""
    gate = [node("Sub", [name, "far"], ["above"]), node("Relu", ["above"], ["gate"])]
    passed = [node("Mul", ["m", "gate"], ["passed"])] if product else [node("Identity", ["gate"], ["passed"])]
    return [*before, *gate, *passed, node("Add", ["x", "passed"], ["y"])]


GATED = {
    "the mean of a batch": opened_by("m", MEAN),
    "the largest of a batch": opened_by("m", LARGEST),
    "less than the mean": opened_by("d", MEAN, node("Sub", ["m", "x"], ["d"])),
    "more than the mean": opened_by("d", MEAN, node("Sub", ["x", "m"], ["d"])),
    "the mean through a gate of its own": opened_by("x", MEAN, product=True),
}


@pytest.mark.parametrize("nodes", GATED.values(), ids=GATED)
def test_a_batch_that_is_mixed_behind_a_closed_gate_is_found_when_the_policy_is_loaded(
    nodes: list[onnx.NodeProto], tmp_path: Path
) -> None:
    policy = load_policy(save(model_of(nodes, {"far": np.float32(50.0)}, shape=("batch", 4)), tmp_path))
    far = np.array([[60.0] * 4, [300.0] * 4, [-200.0] * 4, [1.0] * 4])
    assert not policy.runtime.batches
    np.testing.assert_allclose(policy.run(far), policy(far), rtol=1e-6)


def test_without_self_check_nothing_is_batched_and_the_actions_are_the_same(tmp_path: Path) -> None:
    path = save(two_layers(), tmp_path)
    checked, unchecked = load_policy(path), load_policy(path, self_check=False)
    assert unchecked.self_check is None
    assert not unchecked.runtime.batches
    np.testing.assert_allclose(checked.run(OBSERVATIONS), unchecked.run(OBSERVATIONS), rtol=1e-6, atol=1e-6)


def test_a_policy_travels_to_another_process(tmp_path: Path) -> None:
    policy = load_policy(save(two_layers(), tmp_path))
    copy = pickle.loads(pickle.dumps(policy))
    np.testing.assert_array_equal(copy.run(OBSERVATIONS), policy.run(OBSERVATIONS))
    np.testing.assert_array_equal(copy(OBSERVATIONS), policy(OBSERVATIONS))


def test_the_hash_is_that_of_the_file(tmp_path: Path) -> None:
    import hashlib

    path = save(two_layers(), tmp_path)
    assert load_policy(path).sha256 == hashlib.sha256(path.read_bytes()).hexdigest()


def test_an_optional_input_left_out_at_the_end_does_not_crash_onnxruntime(tmp_path: Path) -> None:
    nodes = [node("LayerNormalization", ["x", "s", ""], ["y"])]
    policy = load_policy(save(model_of(nodes, {"s": weights(1, 4)}), tmp_path))
    np.testing.assert_allclose(policy.run(OBSERVATIONS), policy(OBSERVATIONS), rtol=1e-4, atol=1e-5)


def test_onnxruntime_reports_to_nobody_what_is_run(tmp_path: Path) -> None:
    """Some of its builds leave an identifier and a log to be sent in the home folder, unless they are told not to."""
    program = "from viatool import load_policy; load_policy('via')"
    environment = {
        name: text for name, text in os.environ.items() if name not in ("CI", "ORT_DISABLE_TELEMETRY")
    }
    homes = dict.fromkeys(("HOME", "XDG_CACHE_HOME", "USERPROFILE", "LOCALAPPDATA"), str(tmp_path))
    subprocess.run([sys.executable, "-c", program], env={**environment, **homes}, check=True)
    assert not [path for path in tmp_path.rglob("*") if "onnxruntime" in path.name]


def test_an_operator_that_onnxruntime_lacks_in_float32_takes_another_version(tmp_path: Path) -> None:
    with pytest.raises(PolicyError, match="Swish") as caught:
        load_policy(save(model_of([node("Swish", ["x"], ["y"], alpha=0.7)], opset=25), tmp_path))
    assert "a version of ONNX" in caught.value.hint


def test_an_operator_that_onnxruntime_lacks_in_float64_is_named(tmp_path: Path) -> None:
    double = model_of([node("Erf", ["x"], ["y"])], dtype=onnx.TensorProto.DOUBLE)
    with pytest.raises(PolicyError, match="Erf") as caught:
        load_policy(save(double, tmp_path))
    assert "float32" in caught.value.hint
