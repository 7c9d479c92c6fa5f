"""Speed of the kinematic simulator: robot-steps per second on one thread.

    OMP_NUM_THREADS=1 python tests/benchmarks/simulate.py [--map maps/lab.yaml] [--robots 64] [--steps 1000]

A robot-step is one control interval of one robot: motion, noisy rays, clearance, reward, observation. Robots
that are done are reset into freshly drawn scenarios, which is part of the time, as is the drawing of commands.
"""

from __future__ import annotations

import argparse
import os
import time

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from viatool.simulate import NavigationSimulator
from viatool.world import WorldMap, load_map


def measure(world_map: WorldMap, robots: int, steps: int, rounds: int = 10) -> tuple[float, float, float]:
    """Return the best and the median robot-steps per second of the rounds, and the resets per step."""
    simulator = NavigationSimulator(world_map, robots, seed=0)
    rng = np.random.default_rng(0)
    limits = np.array([world_map.robot.max_linear, world_map.robot.max_angular])
    simulator.reset()
    rates, resets = [], 0
    for _ in range(rounds):
        start = time.perf_counter()
        for _ in range(steps // rounds):
            done = simulator.step(rng.uniform([0.0, -1.0], 1.0, (robots, 2)) * limits).done
            if done.any():
                simulator.reset(done)
                resets += int(done.sum())
        rates.append(robots * (steps // rounds) / (time.perf_counter() - start))
    return max(rates), float(np.median(rates)), resets / (robots * (steps // rounds) * rounds)


def main() -> None:
    """Print a line for every number of robots."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--map", default="maps/lab.yaml")
    parser.add_argument("--robots", type=int, nargs="*", default=[1, 16, 64, 256])
    parser.add_argument("--steps", type=int, default=1000)
    given = parser.parse_args()
    world_map = load_map(given.map)
    for robots in given.robots:
        best, median, resets = measure(world_map, robots, given.steps)
        print(
            f"{world_map.name}: {robots:4d} robots, {world_map.robot.lidar.rays} rays: "
            f"{best:8.0f} robot-steps/s at best, {median:8.0f} in the median, "
            f"{100 * resets:.2f} resets in 100 robot-steps"
        )


if __name__ == "__main__":
    main()
