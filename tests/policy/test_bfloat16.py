"""Policies in bfloat16: bounds hold where onnxruntime runs them, and the operators that it lacks are named."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import ml_dtypes
import onnx
import pytest
from onnx import TensorProto

from tests.policy.enclosure import escapes
from tests.policy.models import model_of, node, save, weights
from viatool.errors import PolicyError
from viatool.policy import load_policy

NARROW = node("Cast", ["x"], ["h"], to=TensorProto.BFLOAT16)
WIDE = node("Cast", ["n"], ["y"], to=TensorProto.FLOAT)


def stored(name: str, array: Any) -> TensorProto:
    return onnx.numpy_helper.from_array(array.astype(ml_dtypes.bfloat16), name)


CONSTANTS = {
    "w": stored("w", weights(1, 4, 4)),
    "s": stored("s", weights(2, 4)),
    "b": stored("b", weights(3, 4)),
}


def model(*nodes: onnx.NodeProto) -> onnx.ModelProto:
    read = {name for call in nodes for name in call.input}
    return model_of(nodes, {name: tensor for name, tensor in CONSTANTS.items() if name in read})


RUN: dict[str, Sequence[onnx.NodeProto]] = {
    "a value that is rounded": [NARROW, node("Identity", ["h"], ["n"]), WIDE],
    "moved elements": [NARROW, node("Transpose", ["h"], ["n"], perm=[1, 0]), WIDE],
    "LayerNormalization": [NARROW, node("LayerNormalization", ["h", "s", "b"], ["n"]), WIDE],
    "stored weights": [
        node("Cast", ["w"], ["v"], to=TensorProto.FLOAT),
        node("MatMul", ["x", "v"], ["y"]),
    ],
}


@pytest.mark.parametrize("nodes", RUN.values(), ids=RUN)
def test_bounds_hold_where_onnxruntime_computes_in_bfloat16(
    nodes: Sequence[onnx.NodeProto], tmp_path: Path
) -> None:
    assert escapes(load_policy(save(model(*nodes), tmp_path)), samples=5000) == 0


LACKING = {
    "MatMul": node("MatMul", ["h", "w"], ["n"]),
    "Add": node("Add", ["h", "b"], ["n"]),
    "Tanh": node("Tanh", ["h"], ["n"]),
    "Relu": node("Relu", ["h"], ["n"]),
}


@pytest.mark.parametrize("operator", LACKING)
def test_an_operator_that_onnxruntime_lacks_in_bfloat16_is_named(operator: str, tmp_path: Path) -> None:
    with pytest.raises(PolicyError, match=operator) as caught:
        load_policy(save(model(NARROW, LACKING[operator], WIDE), tmp_path))
    assert "float32" in caught.value.hint


def test_an_observation_in_bfloat16_is_refused_by_name(tmp_path: Path) -> None:
    narrow = model_of([node("Identity", ["x"], ["y"])], dtype=TensorProto.BFLOAT16)
    with pytest.raises(PolicyError, match="'x' is bfloat16") as caught:
        load_policy(save(narrow, tmp_path))
    assert "float32" in caught.value.hint
