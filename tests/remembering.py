"""Policies with memory over time, as ONNX built by hand, and onnxruntime by itself as the oracle of what they do."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import onnx
from onnx import TensorProto, helper

from tests.policy.models import node, save, weights
from viatool.policy import PolicySpecification
from viatool.policy.specification_file import load_specification

RAYS = 12
SENSED = RAYS + 3
HIDDEN = 6

SPECIFICATION = """schema_version: 2
robot: turtlebot3
control_interval: 0.1
observation:
  - {{name: lidar, kind: lidar, scale: 0.2, lidar: {{field_of_view: 3.14159, rays: {rays}, maximum_range: 5.0}}}}
  - {{name: distance, kind: goal_distance}}
  - {{name: cosine, kind: goal_cosine}}
  - {{name: sine, kind: goal_sine}}
{more}action:
  - {{name: v, kind: linear, unit: m/s, lower: 0.0, upper: 0.5, scale: 0.25, offset: 0.25}}
  - {{name: omega, kind: angular, unit: rad/s, lower: -1.0, upper: 1.0}}
memory: {memory}
"""


def recurrent(
    kind: str = "GRU", *, batch: int | str = 1, strength: float = 1.0, hidden: int = HIDDEN
) -> onnx.ModelProto:
    """A cell whose state is an input and an output of the graph, with the action behind it."""
    gates = {"GRU": 3, "LSTM": 4, "RNN": 1}[kind]
    states = ["h", "c"] if kind == "LSTM" else ["h"]
    made = [f"{name}_out" for name in states]
    constants: dict[str, Any] = {
        "first": np.array([0]), "w": weights(1, 1, gates * hidden, SENSED, scale=0.3),
        "r": weights(2, 1, gates * hidden, hidden, scale=0.6), "b": weights(3, 1, 2 * gates * hidden, scale=0.2),
        "v": weights(4, hidden, 2, scale=strength), "o": np.array([0.6, 0.0], np.float32),
    }  # fmt: skip
    nodes = [
        node("Unsqueeze", ["observation", "first"], ["x"]),
        node(kind, ["x", "w", "r", "b", "", *states], ["", *made], hidden_size=hidden),
        node("Squeeze", ["h_out", "first"], ["last"]),
        node("Gemm", ["last", "v", "o"], ["raw"]),
        node("Tanh", ["raw"], ["action"]),
    ]
    shapes = {"observation": [batch, SENSED], **{name: [1, batch, hidden] for name in states}}
    inputs = [helper.make_tensor_value_info(name, TensorProto.FLOAT, shape) for name, shape in shapes.items()]
    outputs = [helper.make_tensor_value_info(name, TensorProto.FLOAT, None) for name in ("action", *made)]
    stored = [onnx.numpy_helper.from_array(array, name) for name, array in constants.items()]
    graph = helper.make_graph(nodes, "recurrent", inputs, outputs, stored)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)])
    model.ir_version = 10
    return model


def described(memory: str = "{h: h_out}", channels: str = "") -> str:
    """The YAML of its specification; memory channels as lines of YAML."""
    more = "".join(f"  - {line}\n" for line in channels.splitlines())
    return SPECIFICATION.format(rays=RAYS, memory=memory, more=more)


def written(
    folder: Path, kind: str = "GRU", memory: str | None = None, channels: str = "", **more: Any
) -> tuple[Path, Path]:
    """A policy and its specification as files."""
    told = memory or ("{h: h_out, c: c_out}" if kind == "LSTM" else "{h: h_out}")
    spec = folder / f"{kind}.yaml"
    spec.write_text(described(told, channels), "utf-8")
    return save(recurrent(kind, **more), folder, f"{kind}.onnx"), spec


def specification(folder: Path, text: str) -> PolicySpecification:
    path = folder / "specification.yaml"
    path.write_text(text, "utf-8")
    return load_specification(path)


class Deployed:
    """A model file as a robot runs it: one session, which carries its state itself. It shares no code with viatool."""

    def __init__(self, path: Path, memory: dict[str, str], initial: dict[str, Any] | None = None) -> None:
        import onnxruntime

        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        self.session = onnxruntime.InferenceSession(path.read_bytes(), options)
        self.memory, self.initial = memory, initial or {}
        self.shapes = {
            value.name: [size if isinstance(size, int) else 1 for size in value.shape]
            for value in self.session.get_inputs()
        }
        self.begin()

    def begin(self) -> None:
        """Begin an episode."""
        self.state = {
            name: np.broadcast_to(
                np.float32(self.initial.get(name, 0.0)), (int(np.prod(self.shapes[name])),)
            ).reshape(self.shapes[name])
            for name in self.memory
        }

    def remember(self, numbers: Any) -> None:
        """Take a state from one row of numbers."""
        start = 0
        for name, shape in ((name, self.shapes[name]) for name in self.memory):
            size = int(np.prod(shape))
            self.state[name] = np.asarray(numbers[start : start + size], np.float32).reshape(shape)
            start += size

    @property
    def numbers(self) -> Any:
        """The state in one row."""
        return np.concatenate([self.state[name].ravel() for name in self.memory])

    def step(self, sensed: Any, *, carry: bool = True) -> Any:
        """The first output after one observation; the state goes on."""
        (name,) = [name for name in self.shapes if name not in self.memory]
        feed = {name: np.asarray(sensed, np.float32).reshape(self.shapes[name]), **self.state}
        given = dict(
            zip(
                [value.name for value in self.session.get_outputs()],
                self.session.run(None, feed),
                strict=True,
            )
        )
        if carry:
            self.state = {
                source: given[made].reshape(self.shapes[source]) for source, made in self.memory.items()
            }
        return np.asarray(next(iter(given.values()))).ravel()
