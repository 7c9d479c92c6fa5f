"""Drive simulated noisy runs within trajectory tubes: how many leave them, and how wide the tubes are beside the runs.

    python tests/benchmarks/tubes.py --picture docs/images/tubes.png

Every visited state of the lab's fixed scenarios. From each, runs with uniform errors, with errors at random corners,
one for each error and sign alone (a central difference of the closed loop), and with all errors at the corners that
these differences speak for, towards x, y and theta at several steps: what an adversary would do. The spread of a state
is the largest minus the smallest value over its runs; once over the uniform ones alone, once over all.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

from tests.loop.noisy_runs import runs
from viatool import load_map, load_policy
from viatool.loop.horizon import Horizon
from viatool.setting.received import commands_observed
from viatool.setting.setting import Setting
from viatool.simulate import roll_out
from viatool.verification.horizon import HorizonExamination
from viatool.world import Scenes, bin_ranges

TARGETS = (0.2, 0.4, 0.6, 0.8, 1.0)  # shares of the horizon at which the adversary aims
ROUNDING = 1e-7
AT_ONCE = 24  # states


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--policy", type=Path, default=Path("policies/via.onnx"))
    options.add_argument("--map", type=Path, default=Path("maps/lab.yaml"))
    options.add_argument("--eps", type=float, default=0.01)
    options.add_argument("--steps", type=int, default=10)
    options.add_argument("--uniform", type=int, default=1000, help="runs of each state with uniform errors")
    options.add_argument("--corners", type=int, default=500, help="runs of each state at random corners")
    options.add_argument("--every", type=int, default=1, help="take every Nth state")
    options.add_argument("--seed", type=int, default=0)
    options.add_argument("--picture", type=Path)
    given = options.parse_args()
    world, policy = load_map(given.map), load_policy(given.policy)
    trajectory = roll_out(policy, world, seed=given.seed)
    setting = Setting.of(policy, world, given.eps)
    examination = HorizonExamination(policy, setting, Horizon(given.steps))
    chosen = np.arange(0, len(trajectory), given.every)
    poses, episode = trajectory.poses[chosen], trajectory.episode[chosen]
    previous = commands_observed(setting, trajectory)[chosen]
    before = np.stack([previous, previous], axis=1)  # lower and upper ends
    start = time.process_time()
    tubes, crashes = examination.examine(
        trajectory.scenarios, poses, before, episode, np.ones(len(chosen), dtype=bool), first=0, seed=0
    )
    tube_seconds = time.process_time() - start
    start = time.process_time()
    driven = Driven(policy, world, setting.radii, given, np.random.default_rng(given.seed + 1))
    for index, scenario in enumerate(trajectory.scenarios):
        rows = np.flatnonzero(episode == index)
        for first in range(0, len(rows), AT_ONCE):
            some = rows[first : first + AT_ONCE]
            driven.examine(scenario, poses[some], previous[some], tubes, some)
    print(
        f"{driven.count:,} runs of {given.steps} intervals from {len(chosen):,} states, eps {given.eps:g}: "
        f"{driven.outside} left their tube; {time.process_time() - start:.0f} s CPU"
    )
    print(
        f"tubes: {1e3 * tube_seconds / len(chosen):.1f} ms CPU for each state, search for runs that fail included; "
        f"safe {int(tubes.safe.sum())}, unsafe {len(crashes)}, "
        f"unknown {len(chosen) - int(tubes.safe.sum()) - len(crashes)}"
    )
    report(tubes, driven)
    if given.picture:
        from tests.benchmarks.tubes_picture import draw

        draw(given.picture, world, trajectory, chosen, tubes, driven.examples)
        print(f"wrote {given.picture}")


class Driven:
    """Runs of the closed loop, compared with the tubes state by state."""

    def __init__(self, policy, world, radii, given, generator):
        self.policy, self.world, self.radii, self.given = policy, world, radii, given
        self.generator = generator
        self.count = self.outside = 0
        self.spreads = {"uniform": [], "all": []}
        self.rows = []
        self.examples = {}

    def examine(self, scenario, poses, previous, tubes, rows):
        scenes = Scenes.of(self.world, [scenario])
        found = [self.drive(scenario, scenes, poses, previous, errors) for errors in self.free(len(poses))]
        shifted = self.drive(scenario, scenes, poses, previous, self.alone(len(poses)))
        found += [shifted, self.drive(scenario, scenes, poses, previous, self.aligned(shifted))]
        every = np.concatenate(found, axis=1)
        going = ~self.ended(every, scenario, scenes)
        over = np.maximum(every - tubes.upper[rows][:, None], tubes.lower[rows][:, None] - every).max(axis=3)
        self.outside += int((going & ~(over <= ROUNDING)).any(axis=2).sum())
        self.count += every.shape[0] * every.shape[1]
        for name, runs_ in (("uniform", found[0]), ("all", every)):
            self.spreads[name].append(spread(runs_, going[:, : runs_.shape[1]]))
        self.rows.append(rows)
        for index, row in enumerate(rows):
            self.examples[int(row)] = np.concatenate([found[0][index, :60], found[-1][index]])

    def drive(self, scenario, scenes, poses, previous, errors):
        """Run errors (B, R, K, n) from states: poses (B, R, K, 3)."""
        count, each = errors.shape[:2]
        lidar = self.world.robot.lidar

        def look(places):
            ranges = scenes.cast(places, np.zeros(len(places), np.int64), lidar)
            return np.clip(bin_ranges(ranges, lidar), lidar.minimum_range, lidar.maximum_range)

        start = (np.repeat(poses, each, axis=0), np.repeat(previous, each, axis=0))
        flat = errors.reshape(count * each, *errors.shape[2:])
        found, _ = runs(self.policy, self.world, scenario, start, flat, look)
        return found.reshape(count, each, *found.shape[1:])

    def free(self, count):
        shape = (count, self.given.uniform, self.given.steps, len(self.radii))
        yield self.generator.uniform(-1.0, 1.0, shape) * self.radii
        shape = (count, self.given.corners, *shape[2:])
        yield self.generator.choice([-1.0, 1.0], shape) * self.radii

    def alone(self, count):
        """Each error by itself, at both ends: (B, 2 K m, K, n) for the m entries that err."""
        entries, steps = np.flatnonzero(self.radii), self.given.steps
        errors = np.zeros((2, steps, len(entries), steps, len(self.radii)))
        for k in range(steps):
            for j, entry in enumerate(entries):
                errors[0, k, j, k, entry], errors[1, k, j, k, entry] = self.radii[entry], -self.radii[entry]
        flat = errors.reshape(-1, steps, len(self.radii))
        return np.broadcast_to(flat, (count, *flat.shape))

    def aligned(self, shifted):
        """All errors at the corners that move x, y or theta most at a step, to either side: (B, 6 T, K, n)."""
        count, steps = len(shifted), self.given.steps
        entries = np.flatnonzero(self.radii)
        both = shifted.reshape(count, 2, steps, len(entries), steps, 3)
        towards = np.sign(both[:, 0] - both[:, 1])  # (B, K, m, K, 3)
        found = []
        for share in TARGETS:
            at = max(round(share * steps) - 1, 0)
            for axis in range(3):
                errors = np.zeros((count, steps, len(self.radii)))
                errors[:, :, entries] = towards[:, :, :, at, axis] * self.radii[entries]
                found += [errors, -errors]
        return np.stack(found, axis=1)

    def ended(self, found, scenario, scenes):
        """Whether a run has arrived or collided before the end of each interval, (B, R, K)."""
        flat = found.reshape(-1, 3)
        near = np.hypot(*(flat[:, :2] - scenario.goal).T) < 0.5
        clearance = scenes.footprint_clearance(
            flat, self.world.robot.footprint, np.zeros(len(flat), np.int64)
        )
        over = (near | (clearance <= self.world.clearance.collision)).reshape(found.shape[:3])
        before = np.concatenate([np.zeros_like(over[..., :1]), over[..., :-1]], axis=2)
        return np.logical_or.accumulate(before, axis=2)


def spread(found, going):
    """Largest minus smallest value over the runs that still drive, (B, K, 3); NaN where fewer than two do."""
    there = np.where(going[..., None], found, np.nan)
    high = np.where(going[..., None], found, -np.inf).max(axis=1)
    low = np.where(going[..., None], found, np.inf).min(axis=1)
    return np.where((np.isfinite(there).sum(axis=1) > 1), high - low, np.nan)


def report(tubes, driven):
    order = np.concatenate(driven.rows)
    widths = (tubes.upper - tubes.lower)[order]
    spreads = {name: np.concatenate(parts) for name, parts in driven.spreads.items()}
    print(
        "                        tube            uniform runs        all runs           ratio of medians   median ratio"
    )
    print(
        "step           median    90 %     median    90 %     median    90 %    uniform   all     uniform   all"
    )
    for k in range(widths.shape[1]):
        for name, size in (("position [m] ", place), ("heading [rad]", lambda w: w[..., 2])):
            tube = size(widths[:, k])
            by = {kind: size(part[:, k]) for kind, part in spreads.items()}
            there = np.isfinite(tube) & np.isfinite(by["uniform"])
            tube, by = tube[there], {kind: part[there] for kind, part in by.items()}
            figures = [tube, by["uniform"], by["all"]]
            text = "".join(f"{np.median(f):10.5f}{np.quantile(f, 0.9):10.5f}" for f in figures)
            medians = [np.median(tube) / np.median(by[kind]) for kind in ("uniform", "all")]
            ratios = [np.median(tube / by[kind]) for kind in ("uniform", "all")]
            print(
                f"{k + 1:3d} {name}{text}{medians[0]:8.2f}{medians[1]:8.2f}{ratios[0]:10.2f}{ratios[1]:8.2f}"
            )


def place(widths):
    return np.hypot(widths[..., 0], widths[..., 1])


if __name__ == "__main__":
    main()
