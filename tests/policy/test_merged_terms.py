"""Terms that are merged when a model is read count as they were before they cancelled.

The exact value of each graph is written down as fractions of its stored numbers; onnxruntime is the program.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import onnxruntime
import pytest
from numpy.typing import NDArray

from tests.oracles import MP
from tests.policy.models import model_of, node, save
from tests.taylor.containment import Bare
from viatool.policy import assembly, load_policy
from viatool.policy.graph import live, read_graph
from viatool.policy.model_file import Port, Ports
from viatool.policy.network import Affine
from viatool.policy.reader import read_network
from viatool.taylor import reach

Floats = NDArray[np.float64]
Exact = Callable[[list[Fraction]], Fraction]
KINDS = {"float32": onnx.TensorProto.FLOAT, "float64": onnx.TensorProto.DOUBLE}
LEVELS = (
    onnxruntime.GraphOptimizationLevel.ORT_DISABLE_ALL,
    onnxruntime.GraphOptimizationLevel.ORT_ENABLE_ALL,
)


@dataclass(frozen=True)
class Graph:
    """A graph from x of two entries to one action, and what its first action is exactly."""

    nodes: list[onnx.NodeProto]
    exact: Exact
    constants: dict[str, Any] = field(default_factory=dict)


def numbers(*values: float) -> Floats:
    return np.array([values], dtype=np.float64)


BIG = 2.0**60
GRAPHS = {
    "Sum": Graph(
        [node("Sum", ["x", "a", "b"], ["y"])], lambda x: x[0], {"a": numbers(1e6, 3), "b": numbers(-1e6, -3)}
    ),
    "Sum of constants that float64 cannot add": Graph(
        [node("Sum", ["x", "a", "c", "b"], ["y"])],
        lambda x: x[0] + 1,
        {"a": numbers(BIG, 1), "b": numbers(-BIG, 1), "c": numbers(1.0, 1)},
    ),
    "Mean": Graph(
        [node("Mean", ["x", "a", "b"], ["y"])],
        lambda x: x[0] / 3,
        {"a": numbers(1e6, 1), "b": numbers(-1e6, 1)},
    ),
    "Mean of what float64 cannot add": Graph(
        [node("Mean", ["x", "a", "b", "c"], ["y"])],
        lambda x: (x[0] + 1) / 4,
        {"a": numbers(BIG, 1), "b": numbers(-BIG, 1), "c": numbers(1.0, 1)},
    ),
    "Gemm whose addend is its own input": Graph(
        [node("Gemm", ["x", "w", "x"], ["y"], beta=-1048576.0)],
        lambda x: x[0] + x[1],
        {"w": np.array([[1048577.0, 0.0], [1.0, 1048576.0]])},
    ),
    "Gemm with weights that float64 cannot add": Graph(
        [node("Gemm", ["x", "w", "x"], ["y"], beta=-float(BIG))],
        lambda x: x[0] * (Fraction(np.nextafter(BIG, np.inf)) - Fraction(BIG)) + x[1] / 4,
        {"w": np.array([[np.nextafter(BIG, np.inf), 0.0], [0.25, BIG]])},
    ),
    "Gemm of constants": Graph(
        [node("Gemm", ["v", "w", "x"], ["y"])],
        lambda x: x[0] + Fraction(1, 4),
        {"v": np.array([[1.0, 1.0, 1.0]]), "w": np.array([[BIG, 1.0], [0.25, 0.0], [-BIG, 2.0]])},
    ),
    "a difference of the same": Graph([node("Sub", ["x", "x"], ["y"])], lambda x: Fraction(0)),
    "a chain of additions": Graph(
        [node("Add", ["x", "a"], ["s"]), node("Sub", ["s", "a"], ["y"])],
        lambda x: x[0],
        {"a": numbers(1e6, 3.0)},
    ),
    "a convolution and an addition": Graph(
        [
            node("Reshape", ["x", "image"], ["i"]),
            node("Conv", ["i", "w", "b"], ["c"]),
            node("Reshape", ["c", "row"], ["r"]),
            node("Add", ["r", "a"], ["y"]),
        ],
        lambda x: x[0] + x[1],
        {
            "image": np.array([1, 1, 2]),
            "row": np.array([1, 1]),
            "w": np.ones((1, 1, 2)),
            "b": np.array([1e6]),
            "a": np.array([[-1e6]]),
        },
    ),
}  # fmt: skip
WITHOUT_DOUBLE = ("Mean", "Mean of what float64 cannot add", "a convolution and an addition")
"""Onnxruntime has no kernel for these in double precision."""

HARMLESS = (
    "Sum",
    "Mean",
    "a difference of the same",
    "a chain of additions",
    "a convolution and an addition",
)


def stored(graph: Graph, kind: str) -> onnx.ModelProto:
    arrays = {name: v if v.dtype == np.int64 else v.astype(kind) for name, v in graph.constants.items()}
    return model_of(graph.nodes, arrays, shape=(1, 2), dtype=KINDS[kind], opset=13)


def programs(path: Path, points: Floats, kind: str) -> Floats:
    """Return what onnxruntime gives for the first action, without and with optimisation, (2, P)."""
    found = []
    for level in LEVELS:
        options = onnxruntime.SessionOptions()
        options.graph_optimization_level, options.log_severity_level = level, 3
        session = onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
        rows = [session.run(None, {"x": row[None].astype(kind)})[0].ravel()[0] for row in points]
        found.append(np.array(rows, dtype=np.float64))
    return np.array(found)


def escape(graph: Graph, kind: str, folder: Path, centre: Floats, eps: float) -> float:
    """Return how far exact values or onnxruntime leave the bounds of their arithmetic."""
    path = save(stored(graph, kind), folder)
    loaded = Bare(load_policy(path, self_check=False).network)
    moved = (centre + eps * np.linspace(-0.999, 0.999, 9)[:, None]).astype(np.float32).astype(np.float64)
    worst = 0.0
    for refine in ("none", "monotone"):
        real = reach(loaded, centre[None], eps, arithmetic="real", refine=refine)
        for row in moved:
            value = graph.exact([Fraction(entry) for entry in row])
            for excess in (value - Fraction(real.upper[0, 0]), Fraction(real.lower[0, 0]) - value):
                worst = max(worst, float(excess))
        deployed = reach(loaded, centre[None], eps, refine=refine)
        values = programs(path, moved, kind)
        worst = max(worst, (values - deployed.upper[0, 0]).max(), (deployed.lower[0, 0] - values).max())
    return worst


@pytest.mark.filterwarnings("ignore:.*could explain nearly any difference:viatool.errors.PolicyWarning")
@pytest.mark.parametrize(
    ("name", "kind"), [(n, k) for n in GRAPHS for k in KINDS if k == "float32" or n not in WITHOUT_DOUBLE]
)
def test_exact_values_and_programs_keep_to_the_bounds(name: str, kind: str, tmp_path: Path) -> None:
    for centre in ([1e-3, 0.25], [0.7, -2.0]):
        assert escape(GRAPHS[name], kind, tmp_path, np.array(centre), 1e-4) <= 0


@pytest.mark.parametrize("name", HARMLESS)
def test_what_cancels_harmlessly_costs_its_own_rounding_and_no_more(name: str, tmp_path: Path) -> None:
    sets = reach(load_policy(save(stored(GRAPHS[name], "float32"), tmp_path)), [[0.7, -2.0]], 0.01)
    assert sets.deviation[0, 0] < 16 * 2.0**-24 * 3e6


def test_what_cancels_is_no_fault_of_the_reading(tmp_path: Path) -> None:
    graph = Graph(
        [node("Sum", ["x", "a", "b"], ["y"])], lambda x: x[0], {"a": numbers(3, 3), "b": numbers(-3, -3)}
    )
    loaded = load_policy(save(stored(graph, "float32"), tmp_path))
    assert loaded.self_check is not None
    assert loaded.self_check.points > 0


def test_a_small_sum_is_as_tight_as_its_rounding(tmp_path: Path) -> None:
    graph = Graph(
        [node("Sum", ["x", "a", "b"], ["y"])], lambda x: x[0], {"a": numbers(3, 3), "b": numbers(-3, -3)}
    )
    sets = reach(load_policy(save(stored(graph, "float32"), tmp_path)), [[0.7, -2.0]], 0.01)
    assert 2.0**-24 < sets.deviation[0, 0] < 1e-5


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("Sum", "float32"),
        ("Mean", "float32"),
        ("Gemm whose addend is its own input", "float32"),
        ("Sum of constants that float64 cannot add", "float64"),
        ("Gemm with weights that float64 cannot add", "float64"),
        ("Gemm of constants", "float64"),
    ],
)
def test_without_the_magnitudes_of_what_was_merged_something_escapes(
    name: str, kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(assembly, "_beyond", lambda magnitudes, values: None)
    assert escape(GRAPHS[name], kind, tmp_path, np.array([1e-3, 0.25]), 1e-4) > 0


def test_the_factors_of_a_gate_are_merged_without_losing_their_rounding(tmp_path: Path) -> None:
    """0.1 x (0.3 + 0.3 erf(x)) in double precision: 0.1 times 0.3 is no double."""
    nodes = [
        node("Erf", ["x"], ["e"]),
        node("Gemm", ["e", "w", "c"], ["g"]),
        node("Mul", ["x", "f"], ["s"]),
        node("Mul", ["s", "g"], ["y"]),
    ]
    constants = {"w": 0.3 * np.eye(2), "c": np.full(2, 0.3), "f": np.array(0.1)}
    graph = live(read_graph(model_of(nodes, constants, shape=(1, 2), dtype=KINDS["float64"]), Path()), "y")
    network = read_network(graph, Ports((Port("x", (1, 2), "float64", False),)), Path()).network
    assert network is not None
    point = 1.375
    exact = MP.mpf(0.1) * point * MP.mpf(0.3) * (1 + MP.erf(MP.mpf(point)))
    sets = reach(Bare(network), [[point, 0.5]], 0.0, arithmetic="real")
    assert sets.lower[0, 0] <= exact <= sets.upper[0, 0]
    (scaled,) = (part for part in network.nodes if isinstance(part, Affine))
    assert scaled.roundings > 0
