"""How long one verdict takes, and one decision of the monitor: every state by itself, on one thread.

    OMP_NUM_THREADS=1 python tests/benchmarks/online.py [--policy policies/via.onnx] [--map maps/lab.yaml] [--rounds 5]

The states of a drive are asked one by one, all of them `--rounds` times; of each state the least of its times counts as
what it takes without other work on the machine, and all times as what a user sees. Times of the processor stand beside
those of the clock on the wall: where the wall's are much longer the machine was busy with something else.
"""

from __future__ import annotations

import argparse
import platform
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2]))

import viatool
from viatool.uncertainty import ErrorModel

POSE = ErrorModel.model_validate({"pose": {"x": 0.02, "y": 0.02, "theta": 0.02}})
SHARES = (50.0, 99.0, 99.9, 100.0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--policy", default="policies/via.onnx")
    parser.add_argument("--map", default="maps/lab.yaml")
    parser.add_argument("--rounds", type=int, default=5)
    given = parser.parse_args()
    policy, world = viatool.load_policy(given.policy), viatool.load_map(given.map)
    states = viatool.roll_out(policy, world)
    print(
        " ".join(["python", *sys.argv]),
        f"# {len(states)} states, {platform.processor() or platform.machine()}",
    )
    print("milliseconds".ljust(50) + "".join(f"{share:>9g} %" for share in SHARES))
    kinds = {
        "swept, eps 0.01": {"eps": 0.01},
        "swept, eps 0.01, without search": {"eps": 0.01, "search": False},
        "braking, eps 0.01": {"eps": 0.01, "criterion": "braking"},
        "braking, pose within 2 cm": {"eps": 0.01, "criterion": "braking", "errors": POSE, "search": False},
    }
    for name, asked in kinds.items():
        report(name, given.rounds, calls_of_verifier(policy, world, states, asked))
    for name, errors in {"monitor": None, "monitor, pose within 2 cm": POSE}.items():
        report(name, given.rounds, calls_of_monitor(world, states, policy.run(states.observations), errors))
        ahead = np.tile([world.robot.max_linear, 0.0], (len(states), 1))
        report(f"{name}, full speed ahead", given.rounds, calls_of_monitor(world, states, ahead, errors))


def calls_of_verifier(policy, world, states, asked):
    verifier = viatool.Verifier(policy, world, scenario=states.scenarios[0], **asked)
    each = [verifier.within(scenario) for scenario in states.scenarios]
    rows = zip(states.episode, states.poses, states.observations, strict=True)
    return [lambda at=each[one], pose=pose, seen=seen: at(pose, seen) for one, pose, seen in rows]


def calls_of_monitor(world, states, commands, errors):
    each = [viatool.Monitor(None, world, scenario=scenario, errors=errors) for scenario in states.scenarios]
    rows = zip(states.episode, states.poses, commands, strict=True)
    return [lambda at=each[one], pose=pose, asked=asked: at.decide(pose, asked) for one, pose, asked in rows]


def report(name, rounds, calls):
    wall, own = np.empty((rounds + 1, len(calls))), np.empty((rounds + 1, len(calls)))
    for number in range(rounds + 1):  # the first one warms up
        for place, call in enumerate(calls):
            clock, processor = time.perf_counter(), time.thread_time()
            call()
            wall[number, place] = time.perf_counter() - clock
            own[number, place] = time.thread_time() - processor
    each = {"all, wall": wall[1:], "all, processor": own[1:], "least, wall": wall[1:].min(axis=0)}
    for words, found in each.items():
        figures = "".join(f"{1e3 * value:11.2f}" for value in np.percentile(found, SHARES))
        print(f"{name}, {words}".ljust(50) + figures)


if __name__ == "__main__":
    main()
