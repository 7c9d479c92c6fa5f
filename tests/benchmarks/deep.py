"""How much the rounding of a float32 program adds to the bounds of deep networks, beside what the program does.

    python tests/benchmarks/deep.py [--case tanh-8 ...] [--states 4] [--eps 0.01] [--seed 21 ...] [--samples 2000]

For networks of width 32 with random weights of the usual initial size: the width of float32 bounds over that of real
bounds (target: at most 1.1), the allowance for rounding, what onnxruntime really strays from the network over random
observations of the boxes, how many of its actions leave the bounds, and the CPU time of a state. Of several draws of
the weights it is the worst. Actions lie in [-1, 1]; what is added to one that varies by less than 1e-4 is compared with
1e-4.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path

os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = os.environ["MKL_NUM_THREADS"] = "1"

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper

sys.path.insert(0, str(Path(__file__).parents[2]))

from viatool.policy import Policy, load_policy
from viatool.taylor import ReachableSet, reach

Floats = NDArray[np.float64]

WIDTH, INPUTS = 32, 26

STILL = 1e-4
"""Width of an action below which it does not matter how many times as wide rounding makes it."""


class Builder:
    """Collects the nodes and the constants of a graph."""

    def __init__(self, seed: int) -> None:
        self.random = np.random.default_rng(seed)
        self.nodes: list[onnx.NodeProto] = []
        self.constants: list[onnx.TensorProto] = []

    def constant(self, value: object, dtype: type = np.float32) -> str:
        """Add a constant."""
        self.constants.append(numpy_helper.from_array(np.asarray(value, dtype), f"c{len(self.constants)}"))
        return self.constants[-1].name

    def node(self, operator: str, *sources: str, **attributes: object) -> str:
        """Add a node with one output."""
        self.nodes.append(helper.make_node(operator, list(sources), [f"v{len(self.nodes)}"], **attributes))
        return str(self.nodes[-1].output[0])

    def dense(self, x: str, before: int = WIDTH, after: int = WIDTH, gain: float = 1.0) -> str:
        """Add a dense layer with random weights."""
        weight = self.random.normal(size=(before, after)) * gain / np.sqrt(before)
        bias = 0.1 * self.random.normal(size=after)
        return self.node("Gemm", x, self.constant(weight), self.constant(bias))

    def layer_norm(self, x: str) -> str:
        """Add a LayerNormalization."""
        ones, zeros = self.constant(np.ones(WIDTH)), self.constant(np.zeros(WIDTH))
        return self.node("LayerNormalization", x, ones, zeros, axis=-1)

    def rms_norm(self, x: str) -> str:
        """Add a root-mean-square normalisation, spelled out."""
        square = self.node("ReduceMean", self.node("Mul", x, x), self.constant([-1], np.int64))
        return self.node("Div", x, self.node("Sqrt", self.node("Add", square, self.constant(1e-6))))

    def swish(self, x: str) -> str:
        """Add ``x * sigmoid(x)``."""
        return self.node("Mul", x, self.node("Sigmoid", x))


def _residual(b: Builder, x: str) -> str:
    return b.node("Add", x, b.dense(b.node("Relu", b.layer_norm(x))))


def _gated(b: Builder, x: str) -> str:
    gate = b.node("Softmax", b.dense(x), axis=-1)
    return b.dense(b.node("Mul", x, gate), gain=8.0)


LAYERS: Mapping[str, Callable[[Builder, str], str]] = {
    "tanh": lambda b, x: b.dense(b.node("Tanh", x), gain=1.2),
    "relu": lambda b, x: b.dense(b.node("Relu", x), gain=1.4),
    "layernorm-relu": lambda b, x: b.dense(b.node("Relu", b.layer_norm(x)), gain=1.4),
    "silu": lambda b, x: b.dense(b.swish(x), gain=1.8),
    "gelu": lambda b, x: b.dense(b.node("Gelu", x), gain=1.8),
    "glu": lambda b, x: b.dense(b.node("Mul", x, b.node("Sigmoid", b.dense(x))), gain=1.8),
    "rms-silu": lambda b, x: b.dense(b.swish(b.rms_norm(x)), gain=1.8),
    "residual-layernorm": _residual,
    "softmax-gate": _gated,
}

CASES = {
    f"{kind}-{depth}": (kind, depth)
    for kind, depths in {
        "tanh": (4, 6, 8, 12),
        "relu": (8, 12),
        "layernorm-relu": (4, 5, 6, 8),
        "silu": (8, 12),
        "gelu": (8, 12),
        "glu": (6, 8),
        "rms-silu": (6, 8),
        "residual-layernorm": (4, 6),
        "softmax-gate": (2, 3),
    }.items()
    for depth in depths
}
"""Kinds of layers and how many there are, the last dense one included."""


def deep_policy(kind: str, depth: int, folder: Path, seed: int = 21) -> Policy:
    """Write a deep network of width 32, 26 observations and 2 actions, and load it."""
    builder = Builder(seed)
    x = builder.dense("x", INPUTS, gain=1.4)
    for _ in range(depth - 1):
        x = LAYERS[kind](builder, x)
    y = builder.node("Tanh", builder.dense(x, WIDTH, 2, gain=0.3))
    ports = [
        [helper.make_tensor_value_info(name, TensorProto.FLOAT, ["N", size])]
        for name, size in (("x", INPUTS), (y, 2))
    ]
    graph = helper.make_graph(builder.nodes, "deep", *ports, builder.constants)
    path = folder / f"{kind}-{depth}.onnx"
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 20)], ir_version=9), path)
    return load_policy(path)


def observations(states: int) -> Floats:
    """Return the centres of the boxes, (B, 26)."""
    return np.random.default_rng(22).uniform(-1, 1, (states, INPUTS))


def samples_within(centre: Floats, eps: float, count: int) -> Floats:
    """Return float32 observations of the boxes, (S, B, 26): random ones and corners."""
    rng = np.random.default_rng(23)
    offset = rng.uniform(-1, 1, (count, *centre.shape))
    offset[::2] = np.sign(offset[::2])
    return (centre + 0.9999 * eps * offset).astype(np.float32).astype(np.float64)


def ratio(bounds: ReachableSet, real: ReachableSet) -> float:
    """Return the largest width of an action over its real one, or what is added over `STILL` where that is larger."""
    return 1 + float(((bounds.width - real.width) / np.maximum(real.width, STILL)).max())


def measured(policy: Policy, arguments: argparse.Namespace) -> list[float]:
    """Return the ratio of widths, the allowance, how far the program strayed, its escapes and the seconds spent."""
    centre = observations(arguments.states)
    reach(policy, centre[:1], arguments.eps)  # compiles the activations
    start = time.process_time()
    bounds = reach(policy, centre, arguments.eps)
    spent = time.process_time() - start
    real = reach(policy, centre, arguments.eps, arithmetic="real")
    points = samples_within(centre, arguments.eps, arguments.samples)
    flat = points.reshape(-1, INPUTS)
    ran = policy.run(flat).reshape(*points.shape[:2], -1)
    exact = policy.network(flat).reshape(ran.shape)
    outside = ((ran < bounds.lower) | (ran > bounds.upper)).sum()
    return [ratio(bounds, real), bounds.deviation.max(), np.abs(ran - exact).max(), outside, spent]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--case", action="append", choices=sorted(CASES), help="only these")
    parser.add_argument("--states", type=int, default=4)
    parser.add_argument("--eps", type=float, default=0.01)
    parser.add_argument("--seed", type=int, nargs="+", default=[21], help="of the weights")
    parser.add_argument("--samples", type=int, default=2000, help="observations of each box that are run")
    arguments = parser.parse_args()
    print(
        f"{'network':22} {'float32/real':>12} {'allowance':>10} {'strayed':>9} {'outside':>8} {'ms a state':>10}"
    )
    for name in arguments.case or CASES:
        with tempfile.TemporaryDirectory() as folder:
            policies = [deep_policy(*CASES[name], Path(folder), seed) for seed in arguments.seed]
        draws = np.array([measured(policy, arguments) for policy in policies])
        (wider, allowance, strayed, _, _), (*_, outside, spent) = draws.max(axis=0), draws.sum(axis=0)
        print(
            f"{name:22} {wider:12.4f} {allowance:10.2g} {strayed:9.2g} {int(outside):8d} "
            f"{1e3 * spent / (len(policies) * arguments.states):10.1f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
