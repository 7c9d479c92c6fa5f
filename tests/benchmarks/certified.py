"""Try to break certificates: random states of certified cells, by a simulator that shares no code with the proofs.

    python tests/benchmarks/certified.py policies/via.onnx maps/room.yaml cells.npz --states 10000000

Takes the cells of ``viatool certify ... --output cells:cells.npz``, draws poses, previous commands and sensor errors
in them (errors at their ends as often as between), and asks onnxruntime for the command. Ranges come from school
formulas, ray by ray, the motion from quadrature, distances from points to segments and circles. Prints the violations.
As a control, some states of refuted cells are tried; with ``--replay`` every counterexample is run again.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from tests.loop.plant import Plant
from viatool import load_map, load_policy

AT_ONCE = 20_000


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("policy", type=Path)
    options.add_argument("map", type=Path)
    options.add_argument("cells", type=Path)
    options.add_argument("--scenario", type=int, default=0)
    options.add_argument("--eps", type=float, default=0.01)
    options.add_argument("--delay", type=float, default=0.0)
    options.add_argument("--states", type=int, default=1_000_000)
    options.add_argument("--seed", type=int, default=0)
    options.add_argument("--replay", action="store_true", help="run every counterexample again as well")
    given = options.parse_args()
    policy, world = load_policy(given.policy), load_map(given.map)
    robot = Plant(
        policy, world, world.scenarios[given.scenario], given.eps, world.robot.footprint, given.delay
    )
    table = np.load(given.cells)
    lower, upper, status = table["lower"], table["upper"], table["status"]
    generator = np.random.default_rng(given.seed)
    refuted = status == "refuted"
    left = robot.margins(lower[refuted], upper[refuted], generator, AT_ONCE)
    print(
        f"control: {(left < 0.0).sum():,} of {len(left):,} states of {refuted.sum():,} refuted cells violate"
    )
    if given.replay:
        replay(robot, table)
    certified = status == "certified"
    lower, upper = lower[certified], upper[certified]
    start, tried, broken, nearest = time.process_time(), 0, 0, np.inf
    while tried < given.states:
        left = robot.margins(lower, upper, generator, min(AT_ONCE, given.states - tried))
        tried += len(left)
        broken += int((left < 0.0).sum())
        nearest = min(nearest, float(left.min(initial=np.inf)))
    print(f"{certified.sum():,} certified cells, {tried:,} states, {broken} violations")
    print(
        f"least distance beyond the collision distance: {nearest:.2e} m; {time.process_time() - start:.0f} s CPU"
    )


def replay(robot, table):
    """Run every counterexample again, and compare what it observes with what is to be read there."""
    states = np.hstack([table["witness_pose"], table["witness_previous"]])
    seen, left, apart = table["witness_observation"], [], []
    finely = replace(robot, steps=40)
    for start in range(0, len(states), AT_ONCE):
        some, observed = states[start : start + AT_ONCE], seen[start : start + AT_ONCE].astype(float)
        free = robot.free(some[:, :3])
        least = finely.away(finely.paths(some, robot.command(observed))).min(axis=1) - robot.distance
        left.append(np.where(free, least, np.inf))
        apart.append((np.abs(observed - robot.readings(some)) - robot.radii()).max(axis=1))
    left, apart = np.concatenate(left), np.concatenate(apart)
    closely, missed = replace(robot, steps=2000), np.flatnonzero(np.isfinite(left) & (left >= 0.0))
    for row in missed:  # some fail by a micrometre, between two instants
        path = closely.paths(states[row, None], robot.command(seen[row, None].astype(float)))
        left[row] = closely.away(path).min() - robot.distance
    print(
        f"{(left < 0.0).sum():,} of {len(left):,} counterexamples start free and violate again; "
        f"what they observe leaves what sensors may give by {apart.max():.1e} at most"
    )


if __name__ == "__main__":
    main()
