"""Clips limit as they do in the runtime, whatever the precision of the number that they limit."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import numpy as np
import onnx
import pytest

from tests.policy.models import model_of, node, save
from tests.policy.test_merged_terms import programs
from tests.taylor.containment import Bare
from viatool.policy import load_policy
from viatool.policy.graph import live, read_graph
from viatool.policy.model_file import Port, Ports
from viatool.policy.reader import read_network
from viatool.taylor import reach

FLOAT32_LARGEST = float(np.finfo(np.float32).max)
FLOAT16_LARGEST = 65504.0
TYPES = {
    "float16": onnx.TensorProto.FLOAT16,
    "float32": onnx.TensorProto.FLOAT,
    "float64": onnx.TensorProto.DOUBLE,
}


def clipping(kind: str, up: float, down: float, opset: int, **limits: float) -> onnx.ModelProto:
    """Multiply by a large number, clip, and multiply by a small one."""
    constants: dict[str, Any] = {"up": np.array(up, dtype=kind), "down": np.array(down, dtype=kind)}
    if opset < 11:
        clip = node("Clip", ["u"], ["v"], **limits)
    else:
        constants |= {name: np.array(value, dtype=kind) for name, value in limits.items()}
        clip = node("Clip", ["u", *(name if name in limits else "" for name in ("min", "max"))], ["v"])
    nodes = [node("Mul", ["x", "up"], ["u"]), clip, node("Mul", ["v", "down"], ["y"])]
    return model_of(nodes, constants, shape=(1, 2), dtype=TYPES[kind], opset=opset)


@pytest.mark.parametrize("arithmetic", ["float32", "real"])
@pytest.mark.parametrize(
    ("kind", "up", "down", "opset", "limits"),
    [
        ("float64", 1e40, 1e-40, 13, {"max": FLOAT32_LARGEST}),
        ("float64", -1e40, 1e-40, 13, {"min": -FLOAT32_LARGEST, "max": FLOAT32_LARGEST}),
        ("float64", 1e300, 1e-300, 13, {"max": 1e299}),
        ("float64", 1e40, 1e-40, 13, {"min": -np.inf, "max": np.inf}),
        ("float16", 50.0, 0.5, 13, {"max": FLOAT16_LARGEST}),
        ("float16", 50.0, 0.5, 13, {"min": -np.inf, "max": 20.0}),
        ("float32", 50.0, 0.5, 13, {"min": -FLOAT32_LARGEST, "max": FLOAT32_LARGEST}),
        ("float32", 50.0, 0.5, 10, {}),
        ("float32", 50.0, 0.5, 10, {"min": 0.0}),
    ],
)
def test_bounds_hold_what_a_clip_makes(
    kind: str,
    up: float,
    down: float,
    opset: int,
    limits: dict[str, float],
    arithmetic: Literal["float32", "real"],
    tmp_path: Path,
) -> None:
    path = save(clipping(kind, up, down, opset, **limits), tmp_path)
    loaded = Bare(load_policy(path).network)
    centre = np.array([[1.0, -0.5]])
    sets = reach(loaded, centre, 0.1, arithmetic=arithmetic)
    points = (centre + 0.0999 * np.linspace(-1, 1, 17)[:, None]).astype(kind)
    points = points[(np.abs(points.astype(np.float64) - centre) <= 0.1).all(axis=1)]
    values = programs(path, points, kind) if arithmetic == "float32" else None
    exact = (
        np.clip(points[:, 0].astype(float) * up, limits.get("min", -np.inf), limits.get("max", np.inf)) * down
    )
    slack = 1e-12 * np.abs(exact).max()
    assert sets.lower[0, 0] <= exact.min() + slack
    assert exact.max() - slack <= sets.upper[0, 0]
    if values is not None:
        assert sets.lower[0, 0] <= values.min()
        assert values.max() <= sets.upper[0, 0]
    assert sets.width[0, 0] <= 1.1 * np.ptp(exact) + 0.05 * np.abs(exact).max()


def test_the_default_limits_of_an_old_clip_limit_a_double() -> None:
    """Onnxruntime has no such kernel; the standard gives the largest float32 numbers as defaults."""
    graph = live(read_graph(clipping("float64", 1e40, 1e-40, 10), Path()), "y")
    network = read_network(graph, Ports((Port("x", (1, 2), "float64", False),)), Path()).network
    assert network is not None
    sets = reach(Bare(network), [[1.0, -1.0]], 0.1)
    np.testing.assert_allclose(sets.upper[0], np.array([1.0, -1.0]) * FLOAT32_LARGEST * 1e-40, rtol=1e-12)
