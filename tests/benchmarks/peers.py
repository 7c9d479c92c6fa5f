"""Time and tightness beside auto_LiRPA: in one process, in turns, on the same states, one thread.

    python tests/benchmarks/peers.py --peer FOLDER [--case NAME ...] [--states N]

FOLDER holds a checkout of auto_LiRPA (https://github.com/Verified-Intelligence/auto_LiRPA), no part of viatool.
For each network and method: milliseconds of CPU a state, all states in one call; the time over that of viatool's effort
`none`; certified over attained width, of all actions together; and of how many actions the bounds are left by what
onnxruntime computes in float32 at points of the box. Every method is warmed up and then runs twice, in turns with the
others, and six times where it takes less than a second; the best counts. auto_LiRPA bounds in float32 and counts no
rounding; viatool's bounds are those of `viatool.reach` with the float32 contract, so that their ratio holds what
rounding adds.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = os.environ["MKL_NUM_THREADS"] = "1"

import numpy as np
import torch

sys.path.insert(0, str(Path(__file__).parents[2]))

from tests.benchmarks.engines import machine
from tests.benchmarks.reach import attacked, box_of, exported, random_actor, states_of
from viatool.policy.network import Activation, Affine, Input, Network
from viatool.policy.weights import dense
from viatool.taylor import reach

EFFORTS = ("none", "monotone", "split")
PEERS = ("IBP", "CROWN", "alpha-CROWN")
CASES: dict[str, tuple[Callable[[], Any], float, int]] = {
    "via.onnx": (exported("via.onnx"), 0.01, 2000),
    "via.onnx, eps 0.05": (exported("via.onnx"), 0.05, 500),
    "26-64-64-2 relu": (lambda: random_actor(26, 64, 64, 2, hidden="Relu"), 0.01, 500),
    "26-256-256-2 relu": (lambda: random_actor(26, 256, 256, 2, hidden="Relu"), 0.01, 50),
    "26-26-26-2 tanh": (lambda: random_actor(26, 26, 26, 2, hidden="Tanh"), 0.01, 500),
}
SLOW = {"alpha-CROWN": 50, "split": 50}
"""States at most of methods that take long, for networks of 64 neurons or more, and of alpha-CROWN always."""
MODULES = {"Relu": torch.nn.ReLU, "Tanh": torch.nn.Tanh}


def module_of(network: Network) -> torch.nn.Sequential:
    """Return a network of layers one behind the other, affine maps that follow each other as one."""
    layers: list[torch.nn.Module] = []
    weight, bias = np.eye(network.input_size), np.zeros(network.input_size)
    for node in network.nodes:
        match node:
            case Input():
                continue
            case Affine():
                weight, bias = dense(node.weights[0]) @ weight, dense(node.weights[0]) @ bias + node.bias
            case Activation():
                layers += [linear(weight, bias), MODULES[node.function.name]()]
                weight, bias = np.eye(node.size), np.zeros(node.size)
    return torch.nn.Sequential(*layers, linear(weight, bias)).eval()


def linear(weight: np.ndarray, bias: np.ndarray) -> torch.nn.Linear:
    layer = torch.nn.Linear(weight.shape[1], weight.shape[0])
    with torch.no_grad():
        layer.weight.copy_(torch.from_numpy(weight))
        layer.bias.copy_(torch.from_numpy(bias))
    return layer


def peer_of(network: Network, lower: np.ndarray, upper: np.ndarray) -> Callable[[str], Callable[[], Any]]:
    """Return what gives, for a method of auto_LiRPA, a call that bounds all boxes."""
    from auto_LiRPA import BoundedModule, BoundedTensor, PerturbationLpNorm

    def bounding(method: str) -> Callable[[], Any]:
        low, high = (
            torch.from_numpy(end[: limit_of(method, lower, network)].astype(np.float32))
            for end in (lower, upper)
        )
        model = BoundedModule(module_of(network), torch.empty_like(low), device="cpu", verbose=False)
        within = PerturbationLpNorm(norm=np.inf, x_L=low, x_U=high)
        boxes = BoundedTensor(0.5 * (low + high), within)

        def bound() -> tuple[np.ndarray, np.ndarray]:
            found = model.compute_bounds(x=(boxes,), method=method)
            return found[0].detach().double().numpy(), found[1].detach().double().numpy()

        return bound

    return bounding


def limit_of(method: str, states: np.ndarray, network: Network) -> int:
    """Return how many states a method is given."""
    wide = max(node.size for node in network.nodes) >= 64
    slow = method in SLOW and (wide or method == "alpha-CROWN")
    return min(len(states), SLOW[method]) if slow else len(states)


def measure(name: str, most: int) -> list[str]:
    """Return the rows of one network."""
    load, eps, count = CASES[name]
    policy = load()
    states = states_of(name, policy, min(count, most))
    lower, upper = box_of(policy, states, eps)
    points, values = attacked(policy, lower, upper)
    attained = values.max(axis=0) - values.min(axis=0)
    program = np.stack([policy.run(some.astype(np.float32)) for some in points])
    peer = peer_of(policy.network, lower, upper)

    def engine(effort: str) -> Callable[[], Any]:
        some = states[: limit_of(effort, states, policy.network)]

        def bound() -> tuple[np.ndarray, np.ndarray]:
            sets = reach(policy, some, eps, refine=effort)  # type: ignore[arg-type]
            return sets.lower, sets.upper

        return bound

    methods = {f"viatool {effort}": engine(effort) for effort in EFFORTS}
    methods |= {method: peer(method) for method in PEERS}
    best, found = dict.fromkeys(methods, np.inf), {}
    for turn in range(7):  # the first warms up
        for method, bound in methods.items():
            if turn > 2 and best[method] * len(found[method][0]) > 1.0:
                continue
            start = time.process_time()
            found[method] = bound()
            if turn:
                best[method] = min(best[method], (time.process_time() - start) / len(found[method][0]))
    rows = []
    for method, (low, high) in found.items():
        size = len(low)
        ratio = (high - low).sum() / attained[:size].sum()
        left = ((program[:, :size] < low) | (program[:, :size] > high)).any(axis=0).sum()
        times = best[method] / best["viatool none"]
        cost = f"{1e3 * best[method]:.4f} | {times:.2f}"
        rows.append(f"| {name} | {method} | {size} | {cost} | {ratio:.4f} | {left} of {low.size} |")
    return rows


def main() -> None:
    options = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    options.add_argument("--peer", type=Path, required=True, metavar="FOLDER")
    options.add_argument("--case", action="append", choices=CASES)
    options.add_argument("--states", type=int, default=10**6)
    given = options.parse_args()
    torch.set_num_threads(1)
    warnings.simplefilter("ignore")
    sys.path.insert(0, str(given.peer))
    import auto_LiRPA

    print(f"{machine()}, torch {torch.__version__}, auto_LiRPA {auto_LiRPA.__version__}")
    print()
    print(
        "| network | method | states | ms a state | over `none` | certified over attained | float32 leaves |"
    )
    print("|---|---|---|---|---|---|---|")
    for name in given.case or CASES:
        print(*measure(name, given.states), sep="\n", flush=True)


if __name__ == "__main__":
    main()
