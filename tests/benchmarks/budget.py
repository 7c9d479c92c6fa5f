"""How well budgets in seconds are kept: the time of a search of the lab by its budget, with one worker and with two.

python tests/benchmarks/budget.py policies/via.onnx maps/lab.yaml --seconds 2 5 10
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from viatool import load_map, load_policy
from viatool.places import Campaign, SearchBudget, certify
from viatool.schedule import Deadline, open_scheduler


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("policy", type=Path)
    options.add_argument("map", type=Path)
    options.add_argument("--seconds", type=float, nargs="+", default=[2.0, 5.0, 10.0])
    options.add_argument("--workers", type=int, nargs="+", default=[1, 2])
    options.add_argument("--eps", type=float, default=0.01)
    given = options.parse_args()
    policy, world = load_policy(given.policy), load_map(given.map)
    print("workers  budget s   taken s   ratio   roots", flush=True)
    for workers in given.workers:
        for seconds in given.seconds:
            start, until = time.perf_counter(), Deadline.after(seconds)
            found = certify(
                policy, world, world.scenarios[0], eps=given.eps, budget=SearchBudget(until),
                campaign=Campaign(open_scheduler(workers)),
            )  # fmt: skip
            taken = time.perf_counter() - start
            print(
                f"{workers:7d} {seconds:9.1f} {taken:9.2f} {taken / seconds:7.2f} {found.examined:7d}",
                flush=True,
            )


if __name__ == "__main__":
    main()
