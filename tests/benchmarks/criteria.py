"""Check the proofs against brute force: dense commands, instants and footprints, over maps and robots.

    python tests/benchmarks/criteria.py [--checks 10000000] [--maps maps/*.yaml] [--seed 0]

For random maps and the given ones, for known robots and made-up footprints, and for both proofs with and
without a dead time, states are drawn right at the collision distance with command boxes of all sizes. Each
pose that a command of the grid passes is measured with shapely; counted are poses nearer than allowed in
states that are proved.
"""

from __future__ import annotations

import argparse
import itertools
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2]))

from tests.safety.brute_force import FOOTPRINTS, random_world
from tests.safety.cases import make_cases, worst_found
from viatool.errors import ViatoolError
from viatool.safety import prove
from viatool.world import ROBOTS, load_map


def worlds(paths, seed):
    """Yield a name, a world and a scenario, without end."""
    robots = list(ROBOTS.items())
    for number in itertools.count(seed):
        name, footprint = list(FOOTPRINTS.items())[number % len(FOOTPRINTS)]
        yield f"random {number}, {name}", random_world(number, footprint), None
        robot_name, robot = robots[number % len(robots)]
        for path in paths:
            try:
                world = load_map(path)
            except ViatoolError as error:
                print(f"skipped {path}: {error.message.splitlines()[0]}")
                continue
            scenario = world.scenarios[number % len(world.scenarios)] if world.scenarios else None
            world = world.with_robot(robot).with_clearance(0.1, 0.2)
            yield f"{world.name}, {robot_name}", world, scenario


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--checks", type=int, default=10_000_000)
    parser.add_argument("--maps", nargs="*", default=sorted(map(str, Path("maps").glob("*.yaml"))))
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    checks = violations = proved = refuted = open_ = 0
    start = time.perf_counter()
    for name, world, scenario in worlds(given.maps, given.seed):
        for criterion, delay in itertools.product(("swept", "braking"), (0.0, 0.15)):
            seed, options = checks + given.seed, {"scenario": scenario, "delay": delay}
            case, lower, upper = make_cases(world, criterion, seed, **options)
            limit = world.clearance.collision
            proof = prove(case, lower, upper, limit)
            worst, measured = worst_found(world, case, lower, upper, scenario=scenario)
            wrong = int((proof.proved & (worst <= limit)).sum())
            if wrong:
                print(f"{name}, {criterion}, delay {delay}: {wrong} violations in proved states")
            checks, violations = checks + measured, violations + wrong
            proved, refuted = proved + int(proof.proved.sum()), refuted + int(proof.refuted.sum())
            open_ += int((~proof.proved & ~proof.refuted).sum())
        if checks >= given.checks:
            break
    print(
        f"{checks:,} poses measured in {proved + refuted + open_:,} states "
        f"({proved:,} proved, {refuted:,} refuted, {open_} undecided): "
        f"{violations} violations in proved states, {time.perf_counter() - start:.0f} s"
    )
    np.testing.assert_equal(violations, 0)


if __name__ == "__main__":
    main()
