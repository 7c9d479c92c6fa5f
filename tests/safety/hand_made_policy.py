"""A policy written by hand: it turns to the goal, shies from near rays and slows down before obstacles."""

from __future__ import annotations

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from viatool.policy import ActionChannel, LidarSpecification, ObservationChannel, PolicySpecification

BINS = 20


def specification(budget=True, **changes):
    lidar = LidarSpecification(field_of_view=np.pi, rays=180, bins=BINS, minimum_range=0.2, maximum_range=7.0)
    channels = [
        ObservationChannel(name="lidar", size=BINS, unit="m", kind="lidar", lidar=lidar),
        ObservationChannel(name="goal_distance", unit="m", kind="goal_distance"),
        ObservationChannel(name="goal_cosine", kind="goal_cosine"),
        ObservationChannel(name="goal_sine", kind="goal_sine"),
        ObservationChannel(name="previous_linear", unit="m/s", kind="previous_linear"),
        ObservationChannel(name="previous_angular", unit="rad/s", kind="previous_angular"),
    ]
    if budget:
        channels.append(ObservationChannel(name="budget", kind="budget", value=7.3))
    actions = [
        ActionChannel(name="v", unit="m/s", lower=0.0, upper=0.5, kind="linear"),
        ActionChannel(name="omega", unit="rad/s", lower=-1.0, upper=1.0, kind="angular"),
    ]
    return PolicySpecification(**{"observation": channels, "action": actions, **changes})


def layers(caution=0.25, size=26):
    """One hidden layer: 20 units that feel nearness, and the goal's sine and cosine passed on as they are."""
    hidden, bias = np.zeros((BINS + 2, size)), np.zeros(BINS + 2)
    hidden[:BINS, :BINS] = -np.eye(BINS)
    bias[:BINS] = 1.4
    hidden[BINS, 22], hidden[BINS + 1, 21], bias[BINS:] = 1.0, 1.0, 1.0
    bearing = np.linspace(-np.pi / 2, np.pi / 2, BINS)
    output = np.zeros((2, BINS + 2))
    output[0, :BINS] = -caution * np.maximum(np.cos(bearing), 0.0) ** 2
    output[0, BINS + 1] = 0.1
    output[1, :BINS] = np.where(bearing > 0, -1.0, 1.0) * np.cos(bearing) * 0.9
    output[1, BINS] = 1.6
    return hidden, bias, output, np.array([0.4, -1.6])


def write_policy(path, spec=None, size=26, **options):
    """Write it as ONNX with the specification in its metadata; returns the path."""
    hidden, bias, output, offset = layers(size=size, **options)
    limits = [np.array([0.0, -1.0]), np.array([0.5, 1.0])]
    names = {"W": hidden, "b": bias, "V": output, "c": offset, "low": limits[0], "high": limits[1]}
    initializers = [numpy_helper.from_array(array.astype(np.float32), name) for name, array in names.items()]
    nodes = [
        helper.make_node("Gemm", ["observation", "W", "b"], ["pre"], transB=1),
        helper.make_node("Relu", ["pre"], ["post"]),
        helper.make_node("Gemm", ["post", "V", "c"], ["raw"], transB=1),
        helper.make_node("Max", ["raw", "low"], ["raised"]),
        helper.make_node("Min", ["raised", "high"], ["action"]),
    ]
    values = [
        helper.make_tensor_value_info(name, TensorProto.FLOAT, ["batch", count])
        for name, count in (("observation", size), ("action", 2))
    ]
    graph = helper.make_graph(nodes, "policy", [values[0]], [values[1]], initializers)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    if spec is not None:
        helper.set_model_props(model, {"viatool.spec": spec.to_json()})
    onnx.save(model, path)
    return path
