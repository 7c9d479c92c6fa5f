"""Attack proved missions by driving: every run stays in its tube, arrives in time and keeps its clearance.

    viatool mission via-mission --map lab --eps 0.01 --start-error 0.02,0.02 --output json:m.json --output tube:t.npz
    python tests/benchmarks/mission_runs.py via-mission lab m.json t.npz [--runs 10000] [--seed 0] [--drop 10]

Runs begin at corners and inside the box of starts. Of their sensor errors a quarter each is uniform, at corners drawn
anew in each interval, at corners held over the run, and greedy; half as many runs again branch at the rim of their
bunch, or spread over all that they reach (`tests/loop/adversary.py`). None of that shares code with viatool. Printed
are the runs that leave the union of the parts of their interval, that arrive before or after the stated times, or that
keep less than the stated clearance (at five instants of each interval), and how wide tubes are of what is attained (the
larger ratio of the extents in x, y and heading; median over intervals). `--drop N` leaves out every N-th part, and must
find runs that leave.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2]))

from tests.loop.adversary import Adversary, Course
from viatool import load_map, load_policy

ROUNDING = 1e-7
INSTANTS = np.linspace(0.2, 1.0, 5)


def attack(course, mission, tube, asked, generator):
    """Drive one mission; returns how many runs leave, are early or late and come too near, and the ratios of widths."""
    kinds = np.concatenate([np.arange(asked.runs) % 4, np.arange(asked.runs // 2) // 8 % 2 + 4])
    runs, scenario = len(kinds), course.scenario
    start, theta = asked.start_error
    share = generator.uniform(-1.0, 1.0, (runs, 3))
    corners = np.arange(runs) // 4 % 2 == 0  # of each kind
    share[corners] = np.sign(share[corners])
    poses, before = np.array(scenario.start) + share * np.array([start, start, theta]), np.zeros((runs, 2))
    adversary = Adversary(course, kinds, course.radii(asked.eps), generator)
    first = round(mission["arrival"][0] / course.robot.control_interval)
    least = max(mission["clearance"], asked.clearance) - ROUNDING
    going, left, near, early = (
        np.ones(runs, bool),
        np.zeros(runs, bool),
        np.zeros(runs, bool),
        np.zeros(runs, bool),
    )
    ratios, driven = [], []
    for k in range(1, mission["steps"] + 1):
        rows = np.flatnonzero(going)
        seen = course.observe(poses[rows], before[rows])
        errors = np.zeros((runs, seen.shape[1]))
        whole = np.zeros_like(errors)
        whole[rows] = seen
        errors = adversary.errors(whole, going)
        before[rows] = course.command(seen + errors[rows])
        for instant in INSTANTS:
            there = course.move(poses[rows], before[rows], instant)
            near[rows] |= ~(course.clearance(there) >= least)
        poses[rows] = there
        arrived = rows[~(np.hypot(*(there[:, :2] - scenario.goal).T) >= asked.goal_radius)]
        going[arrived] = False
        driven += [k] * len(arrived)
        early[arrived] = k < first
        rows = np.flatnonzero(going)
        if not len(rows):
            break
        parts = tube["step"] == k
        if asked.drop:
            parts[np.flatnonzero(parts)[:: asked.drop]] = False
        lower, upper = tube["lower"][parts, :3], tube["upper"][parts, :3]
        left[rows] |= ~covered(lower, upper, poses[rows])
        if len(lower) and going.all():
            attained = np.ptp(poses, axis=0)
            ratios.append(float(((upper.max(axis=0) - lower.min(axis=0)) / np.maximum(attained, 1e-9)).max()))
        source = adversary.branched(poses, going)
        poses, before = poses[source], before[source]
        left, near = left | left[source], near | near[source]
    late = int(going.sum() + early.sum())
    seconds = (
        course.robot.control_interval * np.array([min(driven), max(driven)]) if driven else (np.nan,) * 2
    )
    return int(left.sum()), late, int(near.sum()), seconds, float(np.median(ratios)), float(np.max(ratios))


def covered(lower, upper, poses):
    """Tell which poses (R, 3) lie in one of the boxes."""
    inside = np.zeros(len(poses), bool)
    for first in range(0, len(lower), 16):
        low, high = lower[first : first + 16], upper[first : first + 16]
        rest = np.flatnonzero(~inside)
        if not len(rest):
            break
        over = np.full((len(rest), len(low)), -np.inf)
        for axis in range(3):
            one = poses[rest, axis, None]
            over = np.maximum(over, np.maximum(low[:, axis] - one, one - high[:, axis]))
        inside[rest] = (over <= ROUNDING).any(axis=1)
    return inside


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    for name in ("policy", "map", "report", "tube"):
        parser.add_argument(name)
    parser.add_argument("--runs", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--drop", type=int, default=0)
    parser.add_argument("--eps", type=float, default=0.01)
    parser.add_argument("--start-error", type=float, nargs=2, default=(0.02, 0.02))
    parser.add_argument("--goal-radius", type=float, default=0.5)
    parser.add_argument("--clearance", type=float, default=0.4)
    parser.add_argument("--only", help="the mission of this name alone")
    asked = parser.parse_args()
    policy, world = load_policy(asked.policy), load_map(asked.map)
    scenarios = {one.name: one for one in world.scenarios}
    content = json.loads(Path(asked.report).read_text(encoding="utf-8"))
    with np.load(asked.tube) as arrays:
        tubes = {name: arrays[name] for name in arrays}
    bad = total = 0
    print("mission  runs    leave  late  near  driven, s      tube/attained, median  largest  CPU s")
    for number, mission in enumerate(content["missions"]):
        if mission["verdict"] != "proved" or asked.only not in (None, mission["scenario"]):
            continue
        begun, mine = time.process_time(), tubes["scenario"] == mission["scenario"]
        tube = {name: tubes[name][mine] for name in ("step", "lower", "upper")}
        generator = np.random.default_rng((asked.seed, number))
        course = Course(policy, world, scenarios[mission["scenario"]])
        left, late, near, seconds, median, most = attack(course, mission, tube, asked, generator)
        runs = asked.runs + asked.runs // 2
        bad, total = bad + left + late + near, total + runs
        spent = time.process_time() - begun
        print(
            f"{mission['scenario']:<8} {runs:<7,} {left:<6} {late:<5} {near:<5} "
            f"{seconds[0]:<4.1f} to {seconds[1]:<6.1f} {median:<22.2f} {most:<8.2f} {spent:.0f}",
            flush=True,
        )
    print(f"{total:,} runs, {bad} violations")


if __name__ == "__main__":
    main()
