"""Which commands of a choice are possible, against what attacks find: random networks, 100 boxes each.

    python tests/benchmarks/possible.py --seeds 1 2 3

Prints, for each network and half-width, in how many boxes the possible commands are those that are attained, and the
processor time. A command that an attack finds and that is not possible stops the benchmark.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import viatool
from tests.taylor.test_choices import attack, boxes, table, write_values
from viatool import load_policy


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--seeds", type=int, nargs="+", default=[1])
    options.add_argument("--eps", type=float, nargs="+", default=[0.03, 0.05])
    options.add_argument("--sizes", type=int, nargs="+", default=[24, 64, 64, 5])
    options.add_argument("--operators", nargs="+", default=["Relu", "Tanh"])
    given = options.parse_args()
    print("network  seed   eps   possible  undecided  boxes that agree   CPU s")
    with TemporaryDirectory() as folder:
        for operator in given.operators:
            for seed in given.seeds:
                for eps in given.eps:
                    path = write_values(Path(folder) / "values.onnx", tuple(given.sizes), seed, operator)
                    policy = load_policy(path, table(given.sizes[0], given.sizes[-1]))
                    print(f"{operator:8s} {seed:4d} {eps:5.2f} {line(policy, eps)}", flush=True)


def line(policy, eps):
    """Return what one network gives."""
    observations, start = boxes(100, policy.input_size), time.process_time()
    sets = viatool.reach(policy, observations, eps)
    seconds = time.process_time() - start
    found = attack(policy, observations, eps, rounds=20)
    if (found & ~sets.possible).any():
        raise SystemExit("a command that is chosen is missing")
    found |= sets.attained
    agree = (found == sets.possible).all(axis=1).sum()
    return f"{sets.possible.sum():9d} {(sets.possible & ~found).sum():10d} {agree:17d} {seconds:7.1f}"


if __name__ == "__main__":
    main()
