"""Time and tightness of the compiled engine beside the numpy one, in one run on one thread.

    python tests/benchmarks/engines.py [--case NAME ...] [--states N]

For each network and effort: microseconds of CPU a state with either engine, in one call for all states and with a call
for each; how often the compiled one is as fast; and the compiled engine's mean width over numpy's, of all actions
together, where a ratio above 1 is wider. Calls take turns, the better of two counts.
"""

from __future__ import annotations

import argparse
import os
import platform
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = os.environ["MKL_NUM_THREADS"] = "1"

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2]))

from tests.benchmarks.reach import exported, random_actor, states_of
from viatool.taylor import ReachableSet, engine_of, reach
from viatool.versions import result_versions

ENGINES = ("numpy", "compiled")
EFFORTS = ("none", "monotone", "split")
SINGLE = 24
"""States that are asked for one by one."""

CASES: dict[str, tuple[Callable[[], Any], float, int]] = {
    "via.onnx": (exported("via.onnx"), 0.01, 1024),
    "via.onnx, eps 0.05": (exported("via.onnx"), 0.05, 256),
    "via-mission.onnx": (exported("via-mission.onnx"), 0.01, 512),
    "via-tanh.onnx": (exported("via-tanh.onnx"), 0.01, 256),
    "26-64-64-2 relu": (lambda: random_actor(26, 64, 64, 2, hidden="Relu"), 0.01, 128),
    "26-256-256-2 relu": (lambda: random_actor(26, 256, 256, 2, hidden="Relu"), 0.01, 32),
    "26-64-64-2 elu": (lambda: random_actor(26, 64, 64, 2, hidden="Elu"), 0.01, 64),
}


def timed(engine: str, work: Callable[[], Any]) -> tuple[float, Any]:
    os.environ["VIATOOL_ENGINE"] = engine
    start = time.process_time()
    result = work()
    return time.process_time() - start, result


def measure(name: str, effort: str, most: int) -> str:
    load, eps, count = CASES[name]
    policy = load()
    states = states_of(name, policy, min(count, most))
    if effort == "split" and "256" in name:
        states = states[:4]
    together, alone = dict.fromkeys(ENGINES, np.inf), dict.fromkeys(ENGINES, np.inf)
    width: dict[str, float] = {}

    def batch() -> ReachableSet:
        return reach(policy, states, eps, refine=effort)  # type: ignore[arg-type]

    def singly() -> None:
        for row in range(min(SINGLE, len(states))):
            reach(policy, states[row : row + 1], eps, refine=effort)  # type: ignore[arg-type]

    for turn in range(3):  # the first warms up
        for engine in ENGINES:
            seconds, sets = timed(engine, batch)
            width[engine] = float(sets.width.mean())
            if turn:
                together[engine] = min(together[engine], 1e6 * seconds / len(states))
                seconds, _ = timed(engine, singly)
                alone[engine] = min(alone[engine], 1e6 * seconds / min(SINGLE, len(states)))
        if turn and seconds > 5:
            break
    os.environ["VIATOOL_ENGINE"] = "compiled"
    assert engine_of(policy.network) == "compiled"
    return (
        f"| {name} | {eps} | {effort} | {len(states)} "
        f"| {together['numpy']:.1f} | {together['compiled']:.1f} | {together['numpy'] / together['compiled']:.1f} "
        f"| {alone['numpy']:.0f} | {alone['compiled']:.0f} | {alone['numpy'] / alone['compiled']:.1f} "
        f"| {width['compiled'] / width['numpy']:.5f} |"
    )


def machine() -> str:
    """Return the versions of what takes part, and the machine."""
    versions = {**result_versions(), "machine": f"{platform.machine()}, {os.cpu_count()} cores"}
    return ", ".join(f"{name} {text}" for name, text in versions.items())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--case", action="append", help="only cases whose name contains this")
    parser.add_argument("--states", type=int, default=10**6, help="at most so many states for each case")
    arguments = parser.parse_args()
    print(machine())
    print()
    print(
        "| network | eps | refine | states | numpy | compiled | times | numpy, singly | compiled | times | width |"
    )
    print("|---|---|---|---|---|---|---|---|---|---|---|")
    for name in CASES:
        if any(part in name for part in arguments.case or [""]):
            for effort in EFFORTS:
                print(measure(name, effort, arguments.states), flush=True)


if __name__ == "__main__":
    main()
