"""Time `viatool verify` as a user runs it, from the start of the program to its report.

    python tests/benchmarks/end_to_end.py [--map maps/lab.yaml] [--states 10000] [--limit 10]

Prints the seconds of each kind of run, and fails when one takes longer than the limit.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--policy", default="policies/via.onnx")
    parser.add_argument("--map", default="maps/lab.yaml")
    parser.add_argument("--states", type=int, default=10_000)
    parser.add_argument("--limit", type=float, default=10.0, help="seconds")
    given = parser.parse_args()
    base = ["verify", given.policy, "--map", given.map, "--eps", "0.01"]
    program = "from viatool.cli import main; main()"
    slowest = 0.0
    for more in ([], ["--only-contested"]):
        arguments = [*base, "--poses", f"random:{given.states}", *more]
        start = time.perf_counter()
        run = subprocess.run(
            [sys.executable, "-c", program, *arguments], cwd=ROOT, capture_output=True, text=True, check=True
        )
        seconds = time.perf_counter() - start
        slowest = max(slowest, seconds)
        verdict = next(line for line in run.stdout.splitlines() if "proved safe" in line)
        print(f"{seconds:6.2f} s  viatool {' '.join(arguments)}\n          {verdict}")
    if slowest > given.limit:
        raise SystemExit(f"slower than {given.limit:g} s")


if __name__ == "__main__":
    main()
