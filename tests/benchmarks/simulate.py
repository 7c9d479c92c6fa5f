"""Speed of the kinematic simulator: robot-steps per second on one thread.

    OMP_NUM_THREADS=1 python tests/benchmarks/simulate.py [--map maps/lab.yaml] [--robots 64] [--steps 1000]

A robot-step is one control interval of one robot: motion, noisy rays, clearance, reward, observation. Robots
that are done are reset into freshly drawn scenarios; that is part of the time, as is the drawing of commands.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from viatool.simulate import NavigationSimulator
from viatool.world import WorldMap, load_map


def measure(world_map: WorldMap, robots: int, steps: int, clock: Callable[[], float]) -> tuple[float, float]:
    """Return the best and the median robot-steps per second of ten rounds."""
    simulator = NavigationSimulator(world_map, robots, seed=0)
    rng = np.random.default_rng(0)
    limits = np.array([world_map.robot.max_linear, world_map.robot.max_angular])
    simulator.reset()
    rates = []
    for _ in range(10):
        start = clock()
        for _ in range(steps // 10):
            done = simulator.step(rng.uniform([0.0, -1.0], 1.0, (robots, 2)) * limits).done
            if done.any():
                simulator.reset(done)
        rates.append(robots * (steps // 10) / (clock() - start))
    return max(rates), float(np.median(rates))


def main() -> None:
    """Print a line for every number of robots."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--map", default="maps/lab.yaml")
    parser.add_argument("--robots", type=int, nargs="*", default=[1, 16, 64, 256])
    parser.add_argument("--steps", type=int, default=1000)
    parser.add_argument("--processor-time", action="store_true", help="on a machine that is busy otherwise")
    given = parser.parse_args()
    world_map = load_map(given.map)
    clock = time.thread_time if given.processor_time else time.perf_counter
    for robots in given.robots:
        best, median = measure(world_map, robots, given.steps, clock)
        print(
            f"{world_map.name}: {robots:4d} robots, {world_map.robot.lidar.rays} rays: "
            f"{best:8.0f} robot-steps/s at best, {median:8.0f} in the median"
        )


if __name__ == "__main__":
    main()
