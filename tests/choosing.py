"""A policy written by hand that chooses among five commands: that of the table which is nearest to its wish."""

from __future__ import annotations

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from tests.safety.hand_made_policy import layers, specification

TABLE = [[0.5, 0.0], [0.35, 0.6], [0.35, -0.6], [0.05, 1.0], [0.05, -1.0]]
_WEIGHT = np.array([2.0, 1.0])


def choosing_specification(**changes):
    """The observations of the policy with continuous commands, and a table."""
    told = specification().model_dump(mode="json", exclude_none=True)
    told["schema_version"] = 2
    told["action"] = [{"name": "move", "kind": "choice", "axes": ["linear", "angular"], "commands": TABLE}]
    return specification().model_validate({**told, **changes})


def write_choosing(path, spec=None, end="", caution=0.05):
    """Write it as ONNX with its specification; with an end, such as ArgMax, its output is the number chosen."""
    hidden, bias, output, offset = layers(caution=caution)
    table = np.array(TABLE)
    values = (table * _WEIGHT) @ output
    constant = (table * _WEIGHT) @ offset - 0.5 * (table**2 * _WEIGHT).sum(axis=1)
    tensors = [
        numpy_helper.from_array(np.asarray(array).astype(np.float32), name)
        for name, array in (("W", hidden), ("b", bias), ("V", values), ("c", constant))
    ]
    nodes = [
        helper.make_node("Gemm", ["observation", "W", "b"], ["pre"], transB=1),
        helper.make_node("Relu", ["pre"], ["post"]),
        helper.make_node("Gemm", ["post", "V", "c"], ["values"], transB=1),
    ]
    made = helper.make_tensor_value_info("values", TensorProto.FLOAT, ["batch", 5])
    if end == "ArgMax":
        nodes.append(helper.make_node("ArgMax", ["values"], ["chosen"], axis=-1, keepdims=0))
        made = helper.make_tensor_value_info("chosen", TensorProto.INT64, ["batch"])
    if end == "ArgMin":
        nodes.append(helper.make_node("ArgMin", ["values"], ["chosen"], axis=-1, keepdims=0))
        made = helper.make_tensor_value_info("chosen", TensorProto.INT64, ["batch"])
    if end == "TopK":
        tensors.append(numpy_helper.from_array(np.array([1], np.int64), "one"))
        nodes.append(helper.make_node("TopK", ["values", "one"], ["best", "chosen"], axis=-1))
        made = helper.make_tensor_value_info("chosen", TensorProto.INT64, ["batch", 1])
    seen = helper.make_tensor_value_info("observation", TensorProto.FLOAT, ["batch", hidden.shape[1]])
    graph = helper.make_graph(nodes, "policy", [seen], [made], tensors)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    helper.set_model_props(model, {"viatool.spec": (spec or choosing_specification()).to_json()})
    onnx.save(model, path)
    return path
