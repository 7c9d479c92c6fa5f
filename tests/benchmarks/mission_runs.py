"""Attack proved missions by driving: every run stays in its tube, arrives in time and keeps its clearance.

    viatool mission via-mission --map lab --eps 0.01 --start-error 0.02,0.02 --output json:m.json --output tube:t.npz
    python tests/benchmarks/mission_runs.py via-mission lab m.json t.npz [--runs 10000] [--seed 0] [--drop 10]

Runs begin at corners and inside the box of starts. Of their sensor errors a quarter each is uniform, at corners drawn
anew in each interval, at corners held over the run, and greedy: each reading is off to the side on which the policy
turns further left, or right, for some intervals on end. Rays come from school formulas (tests/sight/ray_oracle.py),
commands from onnxruntime, arcs from their radius; none shares code with viatool. Printed are the runs that leave the
union of the parts of their interval, that do not arrive in time, or that come too near at the end of an interval, and
how wide tubes are of what is attained (the larger ratio of the extents in x, y and heading; median over intervals).
`--drop N` leaves out every N-th part, and must find runs that leave.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2]))

from tests.loop.noisy_runs import arc
from tests.sight.ray_oracle import outlines, scan
from viatool import load_map, load_policy

ROUNDING = 1e-7


class Adversary:
    """Errors (R, n) of each interval in turn, of four kinds of runs."""

    def __init__(self, policy, radii, runs, generator):
        self.policy, self.radii, self.generator = policy, radii, generator
        self.kind = np.arange(runs) % 4
        self.held = generator.choice([-1.0, 1.0], (runs, len(radii)))
        self.side = generator.choice([-1.0, 1.0], runs)

    def errors(self, seen):
        z = np.where(self.kind[:, None] == 0, self.generator.uniform(-1.0, 1.0, seen.shape), self.held)
        anew = self.kind == 1
        z[anew] = self.generator.choice([-1.0, 1.0], (anew.sum(), seen.shape[1]))
        turned = self.generator.random(len(seen)) < 0.1
        self.side = np.where(turned, -self.side, self.side)
        greedy = np.flatnonzero(self.kind == 3)
        z[greedy] = self.side[greedy, None] * self.slopes(seen[greedy])
        return z * self.radii

    def slopes(self, seen):
        """Signs of what each reading adds to the turn."""
        signs = np.ones_like(seen)
        for place in np.flatnonzero(self.radii):
            step = np.zeros(seen.shape[1])
            step[place] = self.radii[place]
            signs[:, place] = np.sign(self.policy.run(seen + step)[:, 1] - self.policy.run(seen - step)[:, 1])
        return np.where(signs == 0.0, 1.0, signs)


def observe(world, shapes, goal, poses):
    dx, dy = np.array(goal)[:, None] - poses[:, :2].T
    bearing = np.arctan2(dy, dx) - poses[:, 2]
    rest = [np.hypot(dx, dy), np.cos(bearing), np.sin(bearing), np.zeros(len(poses))]
    return np.hstack([scan(poses, world.robot.lidar, shapes), np.stack(rest, axis=1)])


def attack(policy, world, scenario, mission, tube, asked, generator):
    """Drive one mission; returns how many runs leave, are late and come too near, and the ratio of widths."""
    start, theta = asked.start_error
    share = generator.uniform(-1.0, 1.0, (asked.runs, 3))
    share[::2] = np.sign(share[::2])
    poses = np.array(scenario.start) + share * np.array([start, start, theta])
    radii = np.array([asked.eps] * (policy.input_size - 1) + [0.0])
    adversary = Adversary(policy, radii, asked.runs, generator)
    shapes, robot = outlines(world, scenario), world.robot
    low = np.array([robot.min_linear, -robot.max_angular])
    high = np.array([robot.max_linear, robot.max_angular])
    going, left, near, ratios = np.ones(asked.runs, bool), np.zeros(asked.runs, bool), 0, []
    for k in range(1, mission["steps"] + 1):
        rows = np.flatnonzero(going)
        seen = observe(world, shapes, scenario.goal, poses)
        command = np.clip(policy.run(seen + adversary.errors(seen)), low, high).astype(float)
        poses = arc(poses, command, robot.control_interval)
        going &= np.hypot(*(poses[:, :2] - scenario.goal).T) >= asked.goal_radius
        near += int((clearance_of(shapes, poses[rows]) <= asked.clearance).sum())
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
    return int(left.sum()), int(going.sum()), near, float(np.median(ratios)), float(np.max(ratios))


def covered(lower, upper, poses):
    inside = np.zeros(len(poses), bool)
    for first in range(0, len(lower), 64):
        low, high = lower[first : first + 64], upper[first : first + 64]
        rest = np.flatnonzero(~inside)
        if not len(rest):
            break
        over = np.maximum(low - poses[rest, None], poses[rest, None] - high).max(axis=2)
        inside[rest] = (over <= ROUNDING).any(axis=1)
    return inside


def clearance_of(shapes, poses):
    """Metres from places to the nearest outline: of circles and of segments."""
    circles, segments = shapes
    x, y = poses[:, 0], poses[:, 1]
    best = np.full(len(poses), np.inf)
    for cx, cy, radius in circles:
        best = np.minimum(best, np.hypot(x - cx, y - cy) - radius)
    for x1, y1, x2, y2 in segments:
        ex, ey = x2 - x1, y2 - y1
        share = np.clip(((x - x1) * ex + (y - y1) * ey) / (ex**2 + ey**2), 0.0, 1.0)
        best = np.minimum(best, np.hypot(x - x1 - share * ex, y - y1 - share * ey))
    return best


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
    asked = parser.parse_args()
    policy, world = load_policy(asked.policy), load_map(asked.map)
    scenarios = {one.name: one for one in world.scenarios}
    content = json.loads(Path(asked.report).read_text(encoding="utf-8"))
    with np.load(asked.tube) as arrays:
        tubes = {name: arrays[name] for name in arrays}
    bad = total = 0
    print("mission  runs    leave  late  near  tube/attained, median  largest  CPU s")
    for number, mission in enumerate(content["missions"]):
        if mission["verdict"] != "proved":
            continue
        begun, mine = time.process_time(), tubes["scenario"] == mission["scenario"]
        tube = {name: tubes[name][mine] for name in ("step", "lower", "upper")}
        generator = np.random.default_rng((asked.seed, number))
        left, late, near, median, most = attack(
            policy, world, scenarios[mission["scenario"]], mission, tube, asked, generator
        )
        bad, total = bad + left + late + near, total + asked.runs
        seconds = time.process_time() - begun
        print(
            f"{mission['scenario']:<8} {asked.runs:<7,} {left:<6} {late:<5} {near:<5} {median:<22.2f} {most:<8.2f} "
            f"{seconds:.0f}",
            flush=True,
        )
    print(f"{total:,} runs, {bad} violations")


if __name__ == "__main__":
    main()
