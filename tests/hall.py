"""A hall with one obstacle, and a policy that drives straight for its goal, both written by hand."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

MAP = """\
schema_version: 1
name: hall
arena: {shape: box, center: [0, 0], size: [6, 6]}
obstacles:
  - {shape: circle, center: [0.0, 0.55], radius: 0.3}
scenarios:
  - {name: past, start: [-1.5, 0, 0], goal: [1.5, 0]}
  - {name: clear, start: [-1.5, -2, 0], goal: [1.5, -2]}
generator: {}
"""

SPECIFICATION = {
    "schema_version": 1,
    "observation": [
        {
            "name": "lidar",
            "size": 20,
            "unit": "m",
            "kind": "lidar",
            "lidar": {
                "field_of_view": np.pi,
                "rays": 180,
                "bins": 20,
                "minimum_range": 0.2,
                "maximum_range": 7.0,
            },
        },
        {"name": "goal_distance", "unit": "m", "kind": "goal_distance"},
        {"name": "goal_cosine", "kind": "goal_cosine"},
        {"name": "goal_sine", "kind": "goal_sine"},
        {"name": "previous_linear", "unit": "m/s", "kind": "previous_linear"},
        {"name": "previous_angular", "unit": "rad/s", "kind": "previous_angular"},
        {"name": "budget", "kind": "budget", "value": 1.0},
    ],
    "action": [
        {"name": "linear", "unit": "m/s", "kind": "linear", "lower": 0.0, "upper": 0.5},
        {"name": "angular", "unit": "rad/s", "kind": "angular", "lower": -1.0, "upper": 1.0},
    ],
}


def write_policy(path: Path, inputs: int = 26, *, specification: bool = True) -> Path:
    """Write ``v = 0.25 + 0.25 tanh(goal_cosine)``, ``omega = tanh(2 goal_sine)``."""
    weights = np.zeros((2, inputs), np.float32)
    weights[0, 21], weights[1, 22] = 1.0, 2.0
    constants = {
        "weights": weights,
        "bias": np.zeros(2, np.float32),
        "scale": np.array([0.25, 1.0], np.float32),
        "offset": np.array([0.25, 0.0], np.float32),
    }
    nodes = [
        helper.make_node("Gemm", ["observation", "weights", "bias"], ["raw"], transB=1),
        helper.make_node("Tanh", ["raw"], ["squashed"]),
        helper.make_node("Mul", ["squashed", "scale"], ["scaled"]),
        helper.make_node("Add", ["scaled", "offset"], ["action"]),
    ]
    graph = helper.make_graph(
        nodes,
        "actor",
        [helper.make_tensor_value_info("observation", TensorProto.FLOAT, ["batch", inputs])],
        [helper.make_tensor_value_info("action", TensorProto.FLOAT, ["batch", 2])],
        [numpy_helper.from_array(array, name) for name, array in constants.items()],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    if specification:
        helper.set_model_props(model, {"viatool.spec": json.dumps(SPECIFICATION)})
    onnx.save(model, path)
    return path
