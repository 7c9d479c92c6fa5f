"""The policy via in the layouts of other projects, and what is easily said wrong of them.

A map of the inputs stands before the network and a map of its outputs behind it, so that it takes and gives other
numbers and drives as before.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import onnx
from onnx import helper, numpy_helper

from viatool.policy import PolicySpecification

ROOT = Path(__file__).resolve().parents[2]
KNOTS = np.linspace(-math.pi, math.pi, 97)
V = {"name": "v", "kind": "linear", "lower": 0.0, "upper": 0.5}
OMEGA = {"name": "omega", "kind": "angular", "lower": -1.0, "upper": 1.0}
Content = dict[str, Any]


@dataclass(frozen=True)
class Layout:
    """How some policy wants to be told what it observes.

    Parameters
    ----------
    name : str
        For test ids.
    observation, action : list of dict
        Of the right specification.
    bins : list of int
        Which of its ranges are the 20 of via, from right to left.
    """

    name: str
    observation: list[Content]
    action: list[Content]
    bins: list[int]

    @cached_property
    def spec(self) -> PolicySpecification:
        """The right specification."""
        return specification(self.observation, self.action)

    def write(self, folder: Path, spec: PolicySpecification | None = None) -> Path:
        """Write the policy with a specification in its file, the right one by default."""
        path = folder / f"{self.name}.onnx"
        model = onnx.load(ROOT / "policies" / "via.onnx")
        graph = model.graph
        for node in graph.node:
            node.input[:] = ["physical" if name == "observation" else name for name in node.input]
            node.output[:] = ["command" if name == "action" else name for name in node.output]
        before, behind = _Nodes("in"), _Nodes("out")
        before.concat([self._physical(before, channel) for channel in _VIA], "physical")
        outputs = [
            behind.affine("command", column, 1.0 / action.scale, -action.offset / action.scale)
            for action in self.spec.action
            for column in [("linear", "angular").index(action.kind)]
        ]
        behind.concat(outputs, "action")
        inner = list(graph.node)
        del graph.node[:]
        graph.node.extend([*before.nodes, *inner, *behind.nodes])
        graph.initializer.extend([*before.constants, *behind.constants])
        graph.input[0].type.tensor_type.shape.dim[1].dim_value = self.spec.observation_size
        del model.metadata_props[:]
        model.metadata_props.add(key="viatool.spec", value=(spec or self.spec).to_json())
        path.write_bytes(model.SerializeToString())
        return path

    def _physical(self, nodes: _Nodes, kind: str) -> str:
        """Return the node with what via observes of one kind."""
        channels = {channel.kind: channel for channel in self.spec.observation}
        if kind == "budget":
            return nodes.affine("observation", 0, 0.0, 0.0)
        bearing = channels.get("goal_bearing")
        if kind in ("goal_cosine", "goal_sine") and bearing is not None:
            (column,) = self.spec.columns(bearing.name).tolist()
            angle = nodes.affine("observation", column, 1.0 / bearing.scale, 0.0)
            return nodes.function(angle, np.cos if kind == "goal_cosine" else np.sin)
        channel = channels[kind]
        columns = self.spec.columns(channel.name)
        chosen = columns[self.bins] if kind == "lidar" else columns
        return nodes.affine("observation", chosen, 1.0 / channel.scale, -channel.offset / channel.scale)


_VIA = ("lidar", "goal_distance", "goal_cosine", "goal_sine", "previous_linear", "previous_angular", "budget")


class _Nodes:
    """Nodes of a graph and their constants."""

    def __init__(self, prefix: str) -> None:
        self.prefix, self.nodes, self.constants = prefix, [], []

    def affine(self, source: str, columns: Any, scale: float, offset: float) -> str:
        """Some columns, scaled and moved."""
        taken = self._add("Gather", [source, self._constant(np.atleast_1d(columns).astype(np.int64))], axis=1)
        scaled = self._add("Mul", [taken, self._constant(np.float32(scale))])
        return self._add("Add", [scaled, self._constant(np.float32(offset))])

    def function(self, angle: str, of: Callable[[Any], Any]) -> str:
        """A function of an angle, linear from knot to knot."""
        values = of(KNOTS)
        slopes = np.diff(values) / np.diff(KNOTS)
        bends = np.diff(slopes, prepend=0.0)
        apart = self._add("Sub", [angle, self._constant(KNOTS[:-1].astype(np.float32)[None])])
        ramps = self._add("Relu", [apart])
        sums = self._add("MatMul", [ramps, self._constant(bends.astype(np.float32)[:, None])])
        return self._add("Add", [sums, self._constant(np.float32(values[0]))])

    def concat(self, parts: list[str], name: str) -> None:
        """All parts side by side under a name."""
        self.nodes.append(helper.make_node("Concat", parts, [name], axis=1))

    def _add(self, operator: str, inputs: list[str], **attributes: Any) -> str:
        name = f"{self.prefix}_{len(self.nodes)}"
        self.nodes.append(helper.make_node(operator, inputs, [name], **attributes))
        return name

    def _constant(self, value: Any) -> str:
        name = f"{self.prefix}_constant_{len(self.constants)}"
        self.constants.append(numpy_helper.from_array(np.asarray(value), name))
        return name


def specification(observation: list[Content], action: list[Content]) -> PolicySpecification:
    return PolicySpecification.model_validate(
        {"schema_version": 2, "observation": observation, "action": action}
    )


def _lidar(scale: float = 1.0, offset: float = 0.0, **sensor: Any) -> Content:
    limits = {"minimum_range": 0.2, "maximum_range": 7.0}
    return {
        "name": "scan", "kind": "lidar", "scale": scale, "offset": offset, "lidar": {**limits, **sensor},
    }  # fmt: skip


def _number(kind: str, scale: float = 1.0, offset: float = 0.0) -> Content:
    return {"name": kind, "kind": kind, "scale": scale, "offset": offset}


AROUND = Layout(
    "around",
    [
        _lidar(1.0 / 7.0, start=0.0, step=math.radians(1.0), rays=360, bins=40),
        _number("goal_distance", 1.0 / 7.0),
        _number("goal_bearing", 1.0 / math.pi),
        _number("previous_linear", 4.0, -1.0),
        _number("previous_angular"),
    ],
    [{**V, "scale": 0.25, "offset": 0.25}, {**OMEGA}],
    [*range(30, 40), *range(10)],
)
"""Ranges once around from straight ahead and lengths as shares of 7 m, a bearing in half turns, actions in [-1, 1]."""

AHEAD = Layout(
    "ahead",
    [
        _number("goal_bearing"),
        _number("goal_distance"),
        _number("previous_angular"),
        _number("previous_linear"),
        _lidar(2.0 / 7.0, -1.0, start=math.pi / 2, step=math.pi / 179, order="clockwise", rays=180, bins=20),
    ],
    [{**OMEGA, "scale": 1.0}, {**V, "scale": 0.5}],
    list(range(20))[::-1],
)
"""Goal before scan, a bearing in radians, ranges from left to right in [-1, 1], the turn before the speed."""

PLAIN = Layout(
    "plain",
    [
        _lidar(field_of_view=math.pi, rays=180, bins=20),
        *map(_number, ("goal_distance", "goal_cosine", "goal_sine", "previous_linear", "previous_angular")),
    ],
    [V, OMEGA],
    list(range(20)),
)
"""As via itself, in metres, and in the commands of the robot."""

LAYOUTS = (AROUND, AHEAD, PLAIN)


def plants(layout: Layout) -> Iterator[tuple[str, PolicySpecification]]:
    """Yield wrong specifications with what is wrong in them."""
    lidar = next(channel["lidar"] for channel in layout.observation if channel["kind"] == "lidar")
    kinds = {channel["kind"] for channel in layout.observation}
    other = {"clockwise": "counter_clockwise"}.get(lidar.get("order", ""), "clockwise")
    yield "ray order", _changed(layout, "lidar", lidar={**lidar, "order": other, **_opposite(lidar)})
    for turns in (0.25, 0.5, -0.25):
        yield f"ray start {turns:+g}", _changed(layout, "lidar", lidar=_turned(lidar, turns))
    yield "ranges in metres", _changed(layout, "lidar", scale=1.0, offset=0.0)
    yield "ranges normalised twice", _changed(layout, "lidar", scale=1.0 / 7.0, offset=0.0)
    side = "goal_bearing" if "goal_bearing" in kinds else "goal_sine"
    scale = next(channel["scale"] for channel in layout.observation if channel["kind"] == side)
    yield "mirrored bearing", _changed(layout, side, scale=-scale)
    if side == "goal_bearing":
        yield "degrees", _changed(layout, side, scale=180.0 / math.pi)
    yield (
        "flipped turn",
        _acting(layout, lambda a: {**a, "scale": -a.get("scale", 1.0)} if a["kind"] == "angular" else a),
    )
    yield "actions swapped", specification(layout.observation, layout.action[::-1])
    yield "actions not scaled", _acting(layout, lambda a: {**a, "scale": 1.0, "offset": 0.0})


def _opposite(lidar: Content) -> Content:
    return {"start": -lidar["start"]} if "start" in lidar else {}


def _turned(lidar: Content, turns: float) -> Content:
    rest = {key: value for key, value in lidar.items() if key != "field_of_view"}
    start, step = lidar.get("start", -math.pi / 2), lidar.get("step", math.pi / 179)
    return {**rest, "start": start + 2.0 * math.pi * turns, "step": step}


def _changed(layout: Layout, kind: str, **changes: Any) -> PolicySpecification:
    changed = [{**c, **changes} if c["kind"] == kind else c for c in layout.observation]
    return specification(changed, layout.action)


def _acting(layout: Layout, change: Callable[[Content], Content]) -> PolicySpecification:
    return specification(layout.observation, [change(action) for action in layout.action])
