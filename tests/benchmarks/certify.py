"""How much of the contested volume is decided, and at what cost: a random part of the map for each scenario.

    python tests/benchmarks/certify.py policies/via.onnx maps/lab.yaml --sample 0.005

The parts are unbiased samples of the roots; the CPU time of the whole map is extrapolated from them.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from viatool import load_map, load_policy
from viatool.places import Resolution, SearchBudget, certify


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("policy", type=Path)
    options.add_argument("map", type=Path)
    options.add_argument("--sample", type=float, default=0.002)
    options.add_argument("--smallest", type=float, default=0.02)
    options.add_argument("--halvings", type=int, default=1)
    options.add_argument("--eps", type=float, default=0.01)
    options.add_argument("--seed", type=int, default=0)
    options.add_argument("--scenarios", type=int)
    given = options.parse_args()
    policy, world = load_policy(given.policy), load_map(given.map)
    print("scenario    roots  certified  refuted  unknown  decided   free safe   CPU s   whole map, CPU min")
    sums = dict.fromkeys(("certified", "refuted", "unknown", "uncontested"), 0)
    for scenario in world.scenarios[: given.scenarios]:
        start = time.process_time()
        found = certify(
            policy, world, scenario, eps=given.eps, resolution=Resolution(given.smallest, given.halvings),
            budget=SearchBudget(share=given.sample), seed=given.seed,
        )  # fmt: skip
        seconds = time.process_time() - start
        for name in sums:
            sums[name] += found.units[name]
        whole = seconds * found.roots / found.examined / 60.0
        show(scenario.name, found.examined, found.units, f"{seconds:7.1f} {whole:20.1f}")
    show("all", 0, sums, "")


def show(name, roots, units, rest):
    """Print a line of shares."""
    contested = units["certified"] + units["refuted"] + units["unknown"]
    shares = [100.0 * units[kind] / contested for kind in ("certified", "refuted", "unknown")]
    free = 100.0 * (units["certified"] + units["uncontested"]) / (contested + units["uncontested"])
    print(
        f"{name:10s} {roots:6d} {shares[0]:8.1f} % {shares[1]:6.1f} % {shares[2]:6.1f} % "
        f"{shares[0] + shares[1]:6.1f} % {free:9.2f} % {rest}",
        flush=True,
    )


if __name__ == "__main__":
    main()
