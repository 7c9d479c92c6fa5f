"""Wide curved networks: default bounds fit in memory, are tight, and never wider than those of one pass."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from typing import Any

import pytest

PROGRAM = """
import json, resource, sys
resource.setrlimit(resource.RLIMIT_AS, (2 << 30, 2 << 30))
import numpy as np
from viatool.policy.activations import activation
from viatool.policy.network import Activation, Affine, Input, Network
from viatool.taylor import reach

class Bare:
    spec = None

def peak():
    # of this program alone: ru_maxrss also remembers the process that started it
    with open("/proc/self/status") as status:
        return next(int(line.split()[1]) / 1024 for line in status if line.startswith("VmHWM"))

rows, hidden, *widths = json.loads(sys.argv[1])
rng, nodes = np.random.default_rng(41), [Input(widths[0])]
for before, after in zip(widths[:-1], widths[1:]):
    weight = (rng.normal(size=(after, before)) / np.sqrt(before)).astype(np.float32).astype(np.float64)
    nodes.append(Affine((len(nodes) - 1,), (weight,), 0.1 * rng.normal(size=after)))
    nodes.append(Activation(len(nodes) - 1, activation(hidden if after != widths[-1] else "Tanh"), after))
policy = Bare()
policy.network = Network(tuple(nodes))
states = rng.uniform(-1, 1, (rows, widths[0]))
plain, tight = reach(policy, states, 0.01, refine="none"), reach(policy, states, 0.01)
second = reach(policy, states[:2], 0.01, order=2)
print(json.dumps({
    "wider": float((tight.width / plain.width).max()),
    "second": float((second.width / tight.width[:2]).max()),
    "ratio": float(tight.width.sum() / tight.attained_width.sum()),
    "megabytes": peak(),
}))
"""


def measured(rows: int, hidden: str, *widths: int) -> dict[str, Any]:
    """Bound states of a random network in a process that may hold 2 GiB."""
    one_thread = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    asked = [sys.executable, "-c", PROGRAM, json.dumps([rows, hidden, *widths])]
    done = subprocess.run(asked, capture_output=True, text=True, env={**os.environ, **one_thread}, check=True)
    return dict(json.loads(done.stdout))


@pytest.mark.parametrize("rows", [1, 20])
def test_a_scan_of_360_rays_is_bounded_tightly_in_little_memory(rows: int) -> None:
    found = measured(rows, "Tanh", 364, 64, 64, 2)
    assert found["megabytes"] < 1000
    assert found["wider"] <= 1
    assert found["second"] <= 1 + 1e-9
    assert found["ratio"] <= 1.12


@pytest.mark.parametrize("widths", [(235, 512, 256, 128, 12), (480, 512, 256, 128, 29)])
def test_a_wide_network_is_bounded_in_little_memory(widths: tuple[int, ...]) -> None:
    found = measured(10, "Elu", *widths)
    assert found["megabytes"] < 1000
    assert found["wider"] < 0.95
    assert found["second"] <= 1 + 1e-9
