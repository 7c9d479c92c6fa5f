"""A policy that heads for its goal and turns away from what is near, written by hand: it arrives in both tasks."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from tests.hall import SPECIFICATION

NEAR = 1.2  # metres within which it reacts


def write_dodging_policy(path: Path) -> Path:
    """Write ``omega = tanh(2 goal_sine + sum of w_i relu(1.2 - bin_i))``, w positive on the right, else negative."""
    bins = np.arange(20)
    hidden = np.zeros((26, 22), np.float32)
    hidden[bins, bins] = -1.0  # relu(NEAR - bin)
    hidden[21, 20], hidden[22, 21] = 1.0, 1.0
    bias = np.zeros(22, np.float32)
    bias[:20], bias[20:] = NEAR, 3.0  # cosine and sine pass through
    out = np.zeros((22, 2), np.float32)
    out[20, 0] = 0.5
    out[21, 1] = 2.0
    ahead = np.exp(-(((bins - 9.5) / 5.0) ** 2))
    out[:20, 1] = np.where(bins < 10, 1.2, -1.2) * ahead  # bin 0 looks to the right
    constants = {
        "hidden": hidden,
        "bias": bias,
        "out": out,
        "shift": np.array([-1.5, -6.0], np.float32),
        "scale": np.array([0.25, 1.0], np.float32),
        "offset": np.array([0.25, 0.0], np.float32),
    }
    nodes = [
        helper.make_node("Gemm", ["observation", "hidden", "bias"], ["h"]),
        helper.make_node("Relu", ["h"], ["r"]),
        helper.make_node("Gemm", ["r", "out", "shift"], ["raw"]),
        helper.make_node("Tanh", ["raw"], ["squashed"]),
        helper.make_node("Mul", ["squashed", "scale"], ["scaled"]),
        helper.make_node("Add", ["scaled", "offset"], ["action"]),
    ]
    graph = helper.make_graph(
        nodes,
        "actor",
        [helper.make_tensor_value_info("observation", TensorProto.FLOAT, ["batch", 26])],
        [helper.make_tensor_value_info("action", TensorProto.FLOAT, ["batch", 2])],
        [numpy_helper.from_array(array, name) for name, array in constants.items()],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    helper.set_model_props(model, {"viatool.spec": json.dumps(SPECIFICATION)})
    onnx.save(model, path)
    return path
