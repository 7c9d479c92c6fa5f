"""What each term of the error model costs certify: CPU time against eps alone, and the shares that are decided.

    python tests/benchmarks/certify_terms.py policies/via.onnx maps/lab.yaml --sample 0.001

One random part of the map, the same for every row. Every term comes on top of eps; the last rows have several. Times
are of the processor, of one thread; with `--repeat N` the least of N runs counts.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

from viatool import load_map, load_policy
from viatool.places import Resolution, SearchBudget, certify
from viatool.uncertainty import ErrorModel


def scan(**terms):
    return {"sensor": {"lidar": terms}}


POSE = {"pose": {"x": 0.02, "y": 0.02, "theta": 0.01}}
WHOLE = {"relative": 0.01, "bias": 0.02, "angle": 0.01, "thin": 0.1}
MOTORS = {
    "actuation": {
        "linear": {"acceleration": 1.0, "relative": 0.02},
        "angular": {"acceleration": 3.0},
        "slip": 0.02,
    },
    "timing": {"interval": [0.09, 0.11], "delay": [0.0, 0.05]},
}
TERMS = {
    "eps alone": {},
    "relative": scan(relative=0.01),
    "bias": scan(bias=0.02),
    "angle": scan(angle=0.01),
    "thin": scan(thin=0.1),
    "pose": POSE,
    "missing 1": scan(missing=1),
    "missing 3": scan(missing=3),
    "speed": {"obstacles": {"speed": 0.1}},
    "motors, timing": MOTORS,
    "sensors, pose": {**scan(**WHOLE, missing=1), **POSE},
    "all": {**scan(**WHOLE, missing=1), **POSE, **MOTORS, "obstacles": {"speed": 0.1}},
}  # fmt: skip


def main():
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("policy", type=Path)
    options.add_argument("map", type=Path)
    options.add_argument("--scenario", type=int, default=0)
    options.add_argument("--sample", type=float, default=0.001)
    options.add_argument("--smallest", type=float, default=0.02)
    options.add_argument("--eps", type=float, default=0.01)
    options.add_argument("--seed", type=int, default=0)
    options.add_argument("--repeat", type=int, default=1)
    options.add_argument("--terms", nargs="+", default=list(TERMS), choices=list(TERMS))
    given = options.parse_args()
    policy, world = load_policy(given.policy), load_map(given.map)
    print("$ python tests/benchmarks/certify_terms.py", *sys.argv[1:])
    print(
        f"{'terms':15} {'certified':>10} {'refuted':>8} {'unknown':>8} {'cells':>7} {'CPU s':>7} {'ratio':>6}"
    )
    alone = None
    for name in ["eps alone", *(name for name in given.terms if name != "eps alone")]:
        seconds = float("inf")
        for _ in range(given.repeat):
            start = time.process_time()
            found = certify(
                policy, world, given.scenario, eps=given.eps, errors=ErrorModel.model_validate(TERMS[name]),
                resolution=Resolution(given.smallest), budget=SearchBudget(share=given.sample), seed=given.seed,
            )  # fmt: skip
            seconds = min(seconds, time.process_time() - start)
        alone = alone or seconds
        units = [found.units[kind] for kind in ("certified", "refuted", "unknown")]
        shares = [100.0 * part / max(sum(units), 1) for part in units]
        print(f"{name:15} {shares[0]:8.1f} % {shares[1]:6.1f} % {shares[2]:6.1f} % {len(found.findings):7} "
              f"{seconds:7.1f} {seconds / alone:6.2f}", flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
