"""Attack what is proved of robots with motors and timing of their own, and time it against today's geometry.

    python tests/benchmarks/motors.py [--intervals 1000000] [--minutes 10] [--seed 0] [--only cost|attack]

Attack: machines with all terms, drawn at random, of every kinematics and footprint, are placed right at the collision
distance on maps; what is proved of a command box is driven once for each state with everything that the model allows
(corners that are kept, that switch, and anything), in steps of 4 ms, and measured by shapely. Counted are poses nearer
than allowed in states that are proved.

Cost: processor seconds of the geometry and judgement of `viatool.verify` with all terms, against those without any.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2]))

from tests.motion.actuated_runs import LIMITS, TERMS, Driver, limits, machine
from tests.safety.brute_force import FOOTPRINTS, clearance, random_world, rim_of
from tests.safety.cases import near_states
from viatool import load_map, load_policy, verify
from viatool.motion.actuated import ActuatedMotion
from viatool.safety.proof import prove_clearance
from viatool.safety.scene_poses import ScenePoses
from viatool.uncertainty import ErrorModel

ROOT = Path(__file__).parents[2]
RUNS, DISTANCE = 400, 0.1
MAPS = ("lab", "clutter", "corridor", "room")
ALL = {
    "actuation": {
        "linear": {"acceleration": 1.0, "lag": [0.0, 0.1], "relative": 0.05, "absolute": 0.01},
        "angular": {"acceleration": 3.0, "lag": [0.0, 0.1], "relative": 0.05, "absolute": 0.02},
        "slip": 0.02,
    },
    "timing": {"interval": [0.09, 0.11], "delay": [0.03, 0.06], "sensing": 0.02},
}


def attack(world, scenario, kinematics, name, seed):
    """Proved states, and those of them that came nearer than allowed."""
    generator, footprint = np.random.default_rng(seed), FOOTPRINTS[name]
    terms = tuple(term for term in TERMS if term == "brake" or generator.random() < 0.8)
    terms = terms if generator.random() < 0.5 else tuple(term for term in terms if term != "brake")
    asked = machine(generator, kinematics, terms, rim_of(footprint))
    runs = Driver(generator, kinematics, asked, RUNS, asked.history).drive(*limits(kinematics))
    starts = near_states(world, scenario, footprint, generator, RUNS, 0.5)
    error = generator.uniform(0.0, 0.05, (RUNS, 3))
    known = (runs.had - error, runs.had + error) if "measured" in terms else None
    motion = ActuatedMotion(asked, (runs.before, runs.before), known)
    radius = generator.choice([0.0, 0.01, 0.1], (RUNS, 1))
    lower, upper = (np.clip(runs.new + side * radius, *limits(kinematics)) for side in (-1.0, 1.0))
    placed = ScenePoses.of(world, [scenario], starts, np.zeros(RUNS, np.int64))
    proved = prove_clearance(placed, lower, upper, DISTANCE, motion, footprint).proved
    turned = np.exp(1j * starts[:, 2])[:, None] * (runs.poses[..., 0] + 1j * runs.poses[..., 1])
    place = starts[:, :1] + 1j * starts[:, 1:2] + turned
    poses = np.stack([place.real, place.imag, starts[:, 2:] + runs.poses[..., 2]], axis=-1)
    nearer = 0
    for run in np.flatnonzero(proved):
        way = poses[run, : runs.counts[run] + 1 : 3]
        nearer += bool(clearance(world, way, footprint, scenario).min() < DISTANCE - 1e-4)
    return int(proved.sum()), nearer


def cost(map_name, criterion):
    """Processor seconds of geometry and judgement without terms and with all."""
    world, policy = load_map(ROOT / "maps" / f"{map_name}.yaml"), load_policy(ROOT / "policies" / "via.onnx")
    seconds = []
    for errors in ({}, ALL):
        model = ErrorModel.model_validate(errors)
        best = np.inf
        for _ in range(3):
            found = verify(policy, world, eps=0.01, criterion=criterion, errors=model, only_contested=True)
            best = min(best, found.seconds["geometry"] + found.seconds["judge"])
        seconds.append(best)
        stake, states = int(found.contested.collision.sum()), len(found.judgement.safe)
        print(f"  {len(errors)} sections: {best:.3f} s, {states} states, {stake} contested, "
              f"{int(found.judgement.safe.sum())} safe")  # fmt: skip
    return seconds


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--intervals", type=int, default=1_000_000)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", choices=("cost", "attack"))
    given = parser.parse_args()
    if given.only != "attack":
        for map_name in ("lab", "office", "clutter"):
            for criterion in ("swept", "braking"):
                print(f"{map_name}, {criterion}")
                without, with_all = cost(map_name, criterion)
                print(f"  ratio {with_all / without:.2f}")
    if given.only == "cost":
        return
    driven = proved = violations = 0
    start, number = time.perf_counter(), given.seed
    cases = [
        (world, kinematics, name)
        for world in (*MAPS, "random")
        for kinematics in LIMITS
        for name in FOOTPRINTS
    ]
    while driven < given.intervals and time.perf_counter() - start < 60.0 * given.minutes:
        map_name, kinematics, name = cases[(number * 7) % len(cases)]
        world = random_world(number) if map_name == "random" else load_map(ROOT / "maps" / f"{map_name}.yaml")
        scenario = world.scenarios[number % len(world.scenarios)] if world.scenarios else None
        world = replace(world.with_clearance(DISTANCE, 2 * DISTANCE), robot=world.robot)
        found, nearer = attack(world, scenario, kinematics, name, number)
        driven, proved, violations, number = driven + RUNS, proved + found, violations + nearer, number + 1
    print(f"{driven:,} intervals driven, {proved:,} in states that are proved, {violations} violations, "
          f"{time.perf_counter() - start:.0f} s")  # fmt: skip
    sys.exit(1 if violations else 0)


if __name__ == "__main__":
    main()
