"""Wide curved networks: memory at the peak, time a state, width over attained and over `none`.

    python tests/benchmarks/wide_curved.py [--states N] [--eps E]

Each row is a process of its own that may hold 2 GiB of address space, on one thread. Weights are random, of standard
deviation 1 / sqrt(inputs), biases 0, the last layer linear for ELU and tanh else; observations are uniform in [-1, 1].
Widths are summed over states and actions, in the default arithmetic (float32), and once more without its share.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import time
from itertools import pairwise
from typing import Any

import numpy as np

from viatool.policy.activations import activation
from viatool.policy.network import Activation, Affine, Input, Network, Node
from viatool.taylor import reach

NETWORKS: dict[str, tuple[str, tuple[int, ...]]] = {
    "364-64-64-2 tanh": ("Tanh", (364, 64, 64, 2)),
    "235-512-256-128-12 elu": ("Elu", (235, 512, 256, 128, 12)),
    "480-512-256-128-29 elu": ("Elu", (480, 512, 256, 128, 29)),
}


class Bare:
    """A network without a specification."""

    spec: Any = None

    def __init__(self, name: str) -> None:
        hidden, widths = NETWORKS[name]
        rng, nodes = np.random.default_rng([2026, *widths]), list[Node]([Input(widths[0])])
        for before, after in pairwise(widths):
            weight = (rng.normal(size=(after, before)) / np.sqrt(before)).astype(np.float32)
            nodes.append(Affine((len(nodes) - 1,), (weight.astype(np.float64),), np.zeros(after)))
            if len(nodes) < 2 * len(widths) - 2 or hidden == "Tanh":
                nodes.append(Activation(len(nodes) - 1, activation(hidden), after))
        self.network = Network(tuple(nodes))


def measured(name: str, states: int, eps: float) -> dict[str, float]:
    """Bound states of one network with `none` and by default."""
    resource.setrlimit(resource.RLIMIT_AS, (2 << 30, 2 << 30))
    policy = Bare(name)
    observations = np.random.default_rng(7).uniform(-1, 1, (states, policy.network.input_size))
    plain = reach(policy, observations, eps, refine="none")
    reach(policy, observations[:1], eps)  # curves are analysed once
    start = time.process_time()
    sets = reach(policy, observations, eps)
    spent = time.process_time() - start
    real = reach(policy, observations, eps, arithmetic="real")
    return {
        "milliseconds": 1e3 * spent / states,
        "megabytes": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        "ratio": float(sets.width.sum() / sets.attained_width.sum()),
        "real ratio": float(real.width.sum() / sets.attained_width.sum()),
        "none ratio": float(plain.width.sum() / sets.attained_width.sum()),
        "widest": float((sets.width / plain.width).max()),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--states", type=int, nargs="*", default=[1, 20])
    parser.add_argument("--eps", type=float, default=0.01)
    parser.add_argument("--name", help="one network, as JSON")
    arguments = parser.parse_args()
    if arguments.name:
        print(json.dumps(measured(arguments.name, arguments.states[0], arguments.eps)))
        return
    print(
        f"{'network':24}{'states':>7}{'peak MB':>9}{'ms/state':>10}"
        f"{'over attained':>15}{'(real)':>9}{'none':>9}{'widest over none':>18}"
    )
    for name in NETWORKS:
        for states in arguments.states:
            child = [sys.executable, __file__, "--name", name, "--states", str(states)]
            child += ["--eps", str(arguments.eps)]
            one_thread = os.environ | dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
            done = subprocess.run(child, capture_output=True, text=True, check=True, env=one_thread)
            row = json.loads(done.stdout)
            print(
                f"{name:24}{states:7d}{row['megabytes']:9.0f}{row['milliseconds']:10.1f}{row['ratio']:15.3f}"
                f"{row['real ratio']:9.3f}{row['none ratio']:9.3f}{row['widest']:18.3f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
