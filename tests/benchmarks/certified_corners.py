"""Attack certificates by driving: robots at the corners of each error term, from poses of certified cells.

    python tests/benchmarks/certified_corners.py policies/via.onnx maps/room.yaml [--states 100000] [--seed 0]

For each term a random part of the map is certified with it, by `braking`. From certified cells poses and commands
before are drawn, half of them at the rim of the cell; sensors err at corners of the model (readings, a bias, a turned
scan, thin obstacles that rays pass, rays that return nothing, a believed pose), and the robot is driven with errors of
its motors and its clock at corners, among things that come straight at it. Counted are robots that come nearer than the
collision distance. Rays come from school formulas (tests/sight/ray_oracle.py), motors and paths from
tests/benchmarks/corners.py; neither shares code with viatool. `--loosen` certifies with eps alone and drives with the
whole errors: that has to find violations.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2]))

from tests.benchmarks import corners
from tests.loop.plant import Plant
from tests.sight.ray_oracle import outlines, ranges
from viatool import load_map, load_policy
from viatool.places import Resolution, SearchBudget, certify
from viatool.uncertainty import ErrorModel
from viatool.world import Obstacles

EPS = 0.01
POSTS = np.array([[x, y, 0.02] for x in (-1.3, 0.0, 1.3) for y in (-1.3, 1.3)])
"""Thin, where a few rays decide whether something is seen."""
IDEAL = {
    "axis": {"acceleration": 1e6, "deceleration": 1e6, "lag": (0.0, 0.0), "relative": 0.0, "absolute": 0.0},
    "turn": {"acceleration": 1e6, "deceleration": 1e6, "lag": (0.0, 0.0), "relative": 0.0, "absolute": 0.0},
    "timing": {"interval": (0.1, 0.1), "delay": (0.0, 0.0), "sensing": 0.0},
    "slip": 0.0,
    "speed": 0.0,
}  # fmt: skip
FOLLOWING = {
    "axis": {"acceleration": 2.0, "deceleration": 2.0, "lag": (0.0, 0.04), "relative": 0.04, "absolute": 0.01},
    "turn": {"acceleration": 6.0, "deceleration": 6.0, "lag": (0.0, 0.04), "relative": 0.06, "absolute": 0.02},
    "timing": {"interval": (0.09, 0.12), "delay": (0.0, 0.04), "sensing": 0.02},
    "slip": 0.03,
}  # fmt: skip
SCAN = {"relative": 0.05, "bias": 0.08, "angle": 0.08, "thin": 0.05, "missing": 2}
POSE = {"x": 0.1, "y": 0.1, "theta": 0.15}
CASES = {
    **{name: {"scan": {name: size}} for name, size in SCAN.items()},
    "pose": {"pose": POSE},
    "sensors, pose": {"scan": {**SCAN, "relative": 0.01, "bias": 0.02, "angle": 0.02, "missing": 1}, "pose": POSE},
    "motors": {"level": {name: FOLLOWING[name] for name in ("axis", "turn", "slip")}},
    "timing": {"level": {"timing": FOLLOWING["timing"]}},
    "moving": {"level": {"speed": 0.3}},
    "all": {
        "scan": {"relative": 0.01, "bias": 0.02, "angle": 0.01, "thin": 0.05, "missing": 1},
        "pose": {"x": 0.03, "y": 0.03, "theta": 0.02},
        "level": {**FOLLOWING, "speed": 0.1},
    },
}  # fmt: skip
AT_ONCE = 2048
TRIES = 12
"""Observations of each state, of which one counts."""


def model_of(case):
    """The error model of a case."""
    model = {"sensor": {"lidar": case.get("scan", {})}, "pose": case.get("pose", {})}
    level = case.get("level", {})
    if "axis" in level:
        model["actuation"] = {"linear": level["axis"], "angular": level["turn"], "slip": level["slip"]}
    if "timing" in level:
        model["timing"] = level["timing"]
    if "speed" in level:
        model["obstacles"] = {"speed": level["speed"]}
    return ErrorModel.model_validate(model)


def observed(rng, plant, bare, states, case):
    """What robots at states (M, 5) may observe, most errors at their ends."""
    terms, pose, count = case.get("scan", {}), case.get("pose", {}), len(states)
    lidar = plant.world.robot.lidar

    def drawn(*shape):
        found = rng.uniform(-1.0, 1.0, shape)
        return np.where(rng.random(shape) < 0.8, np.sign(found), found)

    believed = states.copy()
    believed[:, :3] += drawn(count, 3) * [pose.get(name, 0.0) for name in ("x", "y", "theta")]
    seen = plant.readings(believed)
    turned = states[:, :3] + terms.get("angle", 0.0) * drawn(count, 1) * [0.0, 0.0, 1.0]
    rays = ranges(turned, lidar.angles(), plant.shapes, lidar.maximum_range)
    if "thin" in terms:
        past = ranges(turned, lidar.angles(), bare, lidar.maximum_range)
        passes = np.where(rng.random((count, 1)) < 0.3, True, rng.random(rays.shape) < 0.5)
        rays = np.where(passes, past, rays)
    by_bin = np.sort(np.maximum(rays, lidar.minimum_range).reshape(count, lidar.bins, -1), axis=2)
    lost = np.zeros((count, lidar.bins), dtype=int)
    for _ in range(terms.get("missing", 0)):  # those that change a bin most, as often as any
        left = np.minimum(lost + 1, by_bin.shape[2] - 1)[:, :, None]
        gain = (np.take_along_axis(by_bin, left, axis=2)[:, :, 0] - by_bin[:, :, 0]) * rng.random(lost.shape)
        bins = np.where(rng.random(count) < 0.5, gain.argmax(axis=1), rng.integers(lidar.bins, size=count))
        lost[np.arange(count), bins] += 1
    true = np.take_along_axis(by_bin, np.minimum(lost, by_bin.shape[2] - 1)[:, :, None], axis=2)[:, :, 0]
    short = 1.0 - 1e-6
    scan = true * (1.0 + short * terms.get("relative", 0.0) * drawn(*true.shape))
    scan = scan + short * (EPS * drawn(*true.shape) + terms.get("bias", 0.0) * drawn(count, 1))
    if terms:
        scan = np.clip(scan, lidar.minimum_range, lidar.maximum_range)
    columns = slice(0, lidar.bins)
    rest = short * plant.radii() * drawn(count, seen.shape[1])
    rest[:, columns] = 0.0
    seen = seen + rest
    seen[:, columns] = scan
    return seen


def misled(rng, plant, bare, states, case):
    """Commands (M, 2) of what robots may observe: of some observations the one that leads farthest some way."""
    sent = [plant.command(observed(rng, plant, bare, states, case)) for _ in range(TRIES)]
    way = rng.standard_normal((len(states), 2))
    worst = np.argmax([(commands * way).sum(axis=1) for commands in sent], axis=0)
    return np.stack(sent)[worst, np.arange(len(states))]


def attack(policy, world, scenario, case, cells, states, seed):
    """What is left beyond the collision distance at least in each of M drives from cells (lower, upper)."""
    rng, plant = np.random.default_rng(seed), Plant(policy, world, scenario, EPS)
    bare_world = replace(world, obstacles=world.obstacles.without_thin(case.get("scan", {}).get("thin", 0.0)))
    bare, around = outlines(bare_world, scenario), corners.solids_of(world, scenario)
    corners.LEVELS["certified"] = {**IDEAL, **case.get("level", {})}
    found, (lower, upper), tried = [], cells, 0
    while tried < states and len(lower):
        rows = rng.integers(len(lower), size=AT_ONCE)
        shares = rng.random((AT_ONCE, 5))
        shares = np.where(rng.random(shares.shape) < 0.5, np.round(shares), shares)
        some = lower[rows] + shares * (upper[rows] - lower[rows])
        some = some[plant.free(some[:, :3])][: states - tried]
        tried += len(some)
        command, before = np.zeros((3, len(some))), np.zeros((3, len(some)))
        command[[0, 2]] = misled(rng, plant, bare, some, case).T
        before[[0, 2]] = some[:, 3:].T
        push = np.zeros((3, len(some)))
        push[[0, 2]] = rng.integers(-1, 2, (2, len(some))) * (rng.random(len(some)) < 0.6)
        driven = corners.drive(rng, world.robot, "certified", some[:, :3].T, before, command, push)
        found.append(corners.nearest(world, "certified", *driven, around))
    return np.concatenate(found) if found else np.zeros(0)


def certified(policy, world, scenario, case, share, smallest, seed):
    """The ends of the certified cells of a random part of the map, (C, 5) each."""
    found = certify(
        policy, world, scenario, eps=EPS, errors=model_of(case), resolution=Resolution(smallest, 1),
        budget=SearchBudget(share=share), seed=seed,
    )  # fmt: skip
    table = found.cell_table()
    kept = table["status"] == "certified"
    return table["lower"][kept], table["upper"][kept]


def main():
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("policy", type=Path)
    options.add_argument("map", type=Path)
    options.add_argument("--scenario", type=int, default=0)
    options.add_argument("--states", type=int, default=100_000, help="for each case")
    options.add_argument("--sample", type=float, default=0.02)
    options.add_argument("--smallest", type=float, default=0.05)
    options.add_argument("--seed", type=int, default=0)
    options.add_argument("--loosen", action="store_true")
    options.add_argument("--cases", nargs="+", default=list(CASES), choices=list(CASES))
    given = options.parse_args()
    policy, world = load_policy(given.policy), load_map(given.map)
    world = replace(world, obstacles=world.obstacles + Obstacles(POSTS))
    scenario = world.scenarios[given.scenario]
    print("$ python tests/benchmarks/certified_corners.py", *sys.argv[1:])
    print(
        f"{'errors':14} {'certified cells':>15} {'driven':>9} {'violations':>10} {'left at least':>13} {'CPU s':>6}"
    )
    total, violated = 0, 0
    for name in given.cases:
        begun, case = time.process_time(), CASES[name]
        asked = {} if given.loosen else case
        cells = certified(policy, world, scenario, asked, given.sample, given.smallest, given.seed)
        left = attack(policy, world, scenario, case, cells, given.states, given.seed)
        broken = int((left < -corners.MARGIN).sum())
        total, violated = total + len(left), violated + broken
        least, seconds = 1000.0 * left.min(initial=np.inf), time.process_time() - begun
        print(
            f"{name:14} {len(cells[0]):15,} {len(left):9,} {broken:10,} {least:10.1f} mm {seconds:6.0f}",
            flush=True,
        )
    print(f"{total:,} driven intervals, {violated:,} violations in certified cells")
    sys.exit(1 if violated and not given.loosen else 0)


if __name__ == "__main__":
    main()
