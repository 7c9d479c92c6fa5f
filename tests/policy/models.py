"""ONNX models built by hand for the tests."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import onnx
from onnx import TensorProto, helper

node = helper.make_node


def weights(seed: int, *shape: int, scale: float = 1.0) -> Any:
    """Random float32 numbers."""
    return (scale * np.random.default_rng(seed).normal(size=shape)).astype(np.float32)


def model_of(
    nodes: Sequence[onnx.NodeProto],
    initializers: dict[str, Any] | None = None,
    *,
    shape: Sequence[int | str | None] = (1, 4),
    opset: int = 17,
    dtype: int = TensorProto.FLOAT,
    output_dtype: int | None = None,
    outputs: Sequence[str] = ("y",),
    functions: Sequence[onnx.FunctionProto] = (),
    domains: dict[str, int] | None = None,
) -> onnx.ModelProto:
    """A model from input x to the outputs."""
    graph = helper.make_graph(
        list(nodes),
        "test",
        [helper.make_tensor_value_info("x", dtype, list(shape))],
        [helper.make_tensor_value_info(name, output_dtype or dtype, None) for name in outputs],
        [
            array if isinstance(array, TensorProto) else onnx.numpy_helper.from_array(np.asarray(array), name)
            for name, array in (initializers or {}).items()
        ],
    )
    imports = [
        helper.make_opsetid("", opset),
        *(helper.make_opsetid(d, v) for d, v in (domains or {}).items()),
    ]
    model = helper.make_model(graph, opset_imports=imports, functions=list(functions))
    model.ir_version = 10
    return model


def save(model: onnx.ModelProto, folder: Path, name: str = "policy.onnx") -> Path:
    """Write a model and return its path."""
    path = folder / name
    path.write_bytes(model.SerializeToString())
    return path


def two_layers(seed: int = 0, size: int = 4, hidden: int = 5, actions: int = 2) -> onnx.ModelProto:
    """A small actor: Gemm, Relu, Gemm, Tanh."""
    return model_of(
        [
            node("Gemm", ["x", "w1", "b1"], ["h"], transB=1),
            node("Relu", ["h"], ["r"]),
            node("Gemm", ["r", "w2", "b2"], ["o"], transB=1),
            node("Tanh", ["o"], ["y"]),
        ],
        {
            "w1": weights(seed, hidden, size),
            "b1": weights(seed + 1, hidden),
            "w2": weights(seed + 2, actions, hidden),
            "b2": weights(seed + 3, actions),
        },
        shape=("batch", size),
    )
