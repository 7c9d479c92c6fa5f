"""Models that end in the number of what they chose are read up to the values that are compared."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest
from onnx import helper

import viatool
from tests.choosing import TABLE, choosing_specification, write_choosing
from viatool.errors import PolicyError
from viatool.policy import load_policy


@pytest.mark.parametrize("end", ["ArgMax", "TopK"])
def test_the_values_before_the_choice_are_the_policy(tmp_path: Path, end: str) -> None:
    path = write_choosing(tmp_path / "chosen.onnx", end=end)
    policy, plain = load_policy(path), load_policy(write_choosing(tmp_path / "values.onnx"))
    seen = np.random.default_rng(0).uniform(0.2, 3.0, (200, 26))
    np.testing.assert_allclose(policy.run(seen), plain.run(seen), rtol=1e-6, atol=1e-6)
    session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    number = session.run(["chosen"], {"observation": seen.astype(np.float32)})[0].ravel()
    assert len(set(number.tolist())) > 1
    np.testing.assert_array_equal(policy.run(seen).argmax(axis=1), number)
    sets, other = viatool.reach(policy, seen[:20], 0.02), viatool.reach(plain, seen[:20], 0.02)
    np.testing.assert_array_equal(sets.possible, other.possible)


def test_what_carries_the_number_on_is_passed_over(tmp_path: Path) -> None:
    path = write_choosing(tmp_path / "chosen.onnx", end="ArgMax")
    model = onnx.load(path)
    model.graph.node.append(helper.make_node("Cast", ["chosen"], ["as_float"], to=onnx.TensorProto.FLOAT))
    del model.graph.output[:]
    model.graph.output.append(helper.make_tensor_value_info("as_float", onnx.TensorProto.FLOAT, ["batch"]))
    onnx.save(model, path)
    assert load_policy(path).output_size == 5


def test_another_choice_is_refused_by_name(tmp_path: Path) -> None:
    path = write_choosing(tmp_path / "least.onnx", end="ArgMin")
    with pytest.raises(PolicyError, match="ArgMin") as refused:
        load_policy(path)
    assert "kind: choice" in str(refused.value.hint)
    path = write_choosing(tmp_path / "last.onnx", end="ArgMax")
    model = onnx.load(path)
    model.graph.node[-1].attribute.append(helper.make_attribute("select_last_index", 1))
    onnx.save(model, path)
    with pytest.raises(PolicyError, match="first of the largest"):
        load_policy(path)


def test_without_a_table_the_choice_is_refused_with_what_to_give(tmp_path: Path) -> None:
    path = write_choosing(tmp_path / "chosen.onnx", end="ArgMax")
    model = onnx.load(path)
    del model.metadata_props[:]
    onnx.save(model, path)
    with pytest.raises(PolicyError, match="discrete choice") as refused:
        load_policy(path)
    assert "kind: choice" in str(refused.value.hint)


def test_values_of_another_number_than_the_table_are_refused(tmp_path: Path) -> None:
    told = choosing_specification().model_dump(mode="json", exclude_none=True)
    told["action"][0]["commands"] = told["action"][0]["commands"][:4]
    told["action"][0]["upper"] = 3.0
    spec = choosing_specification().model_validate(told)
    with pytest.raises(PolicyError, match="5 actions"):
        load_policy(write_choosing(tmp_path / "chosen.onnx", spec, end="ArgMax"))


def with_table(path, rows, operator="Gather"):
    """Let a model that ends in the number of its choice send the row of a table instead."""
    model = onnx.load(path)
    index = "chosen"
    if operator == "GatherND":
        model.graph.initializer.append(onnx.numpy_helper.from_array(np.array([-1]), "behind"))
        model.graph.node.append(helper.make_node("Unsqueeze", ["chosen", "behind"], ["index"]))
        index = "index"
    if isinstance(rows, str):
        source = rows
    else:
        source = "table"
        model.graph.initializer.append(onnx.numpy_helper.from_array(np.array(rows, np.float32), "table"))
    model.graph.node.append(helper.make_node(operator, [source, index], ["command"]))
    del model.graph.output[:]
    model.graph.output.append(helper.make_tensor_value_info("command", onnx.TensorProto.FLOAT, None))
    onnx.save(model, path)
    return path


@pytest.mark.parametrize("operator", ["Gather", "GatherND"])
def test_a_model_that_takes_its_command_out_of_the_table_is_read_up_to_the_values(
    operator: str, tmp_path: Path
) -> None:
    path = with_table(write_choosing(tmp_path / "sent.onnx", end="ArgMax"), TABLE, operator)
    policy = load_policy(path)
    seen = np.random.default_rng(0).uniform(0.2, 3.0, (50, 26))
    session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    sent = session.run(["command"], {"observation": seen.astype(np.float32)})[0]
    chosen = policy.run(seen).argmax(axis=1)
    np.testing.assert_array_equal(sent.reshape(-1, 2), np.array(TABLE, np.float32)[chosen])


def test_another_table_and_a_row_of_computed_values_are_refused(tmp_path: Path) -> None:
    path = with_table(write_choosing(tmp_path / "other.onnx", end="ArgMax"), TABLE[::-1])
    with pytest.raises(PolicyError, match="of a table of its own, its specification names"):
        load_policy(path)
    path = with_table(write_choosing(tmp_path / "computed.onnx", end="ArgMax"), "values")
    with pytest.raises(PolicyError, match="discrete choice"):
        load_policy(path)


def test_a_discrete_policy_of_stable_baselines_is_read_up_to_its_probabilities(tmp_path: Path) -> None:
    """PPO's predict: logits less the logarithm of the sum of their exponentials, a softmax, and the largest."""
    path = write_choosing(tmp_path / "likely.onnx")
    model = onnx.load(path)
    for call in (
        helper.make_node("ReduceLogSumExp", ["values"], ["total"], axes=[-1], keepdims=1),
        helper.make_node("Sub", ["values", "total"], ["logits"]),
        helper.make_node("Softmax", ["logits"], ["likely"], axis=-1),
        helper.make_node("ArgMax", ["likely"], ["chosen"], axis=-1, keepdims=0),
    ):
        model.graph.node.append(call)
    del model.graph.output[:]
    model.graph.output.append(helper.make_tensor_value_info("chosen", onnx.TensorProto.INT64, ["batch"]))
    onnx.save(model, path)
    policy, plain = load_policy(path), load_policy(write_choosing(tmp_path / "values.onnx"))
    seen = np.random.default_rng(0).uniform(0.2, 3.0, (40, 26))
    session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    sets, other = (viatool.reach(one, seen, 0.02) for one in (policy, plain))
    rng = np.random.default_rng(1)
    for _ in range(20):
        points = (seen + rng.uniform(-0.0199, 0.0199, seen.shape)).astype(np.float32)
        number = session.run(["chosen"], {"observation": points})[0].ravel()
        assert sets.possible[np.arange(len(seen)), number].all()
    assert sets.possible.sum() <= 1.2 * other.possible.sum()
