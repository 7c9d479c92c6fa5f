"""Models that end in the number of what they chose are read up to the values that are compared."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest
from onnx import helper

import viatool
from tests.choosing import choosing_specification, write_choosing
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
