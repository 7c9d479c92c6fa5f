"""Speed and truth of the simulators.

    OMP_NUM_THREADS=1 python tests/benchmarks/simulate.py                 # everything, some minutes
    OMP_NUM_THREADS=1 python tests/benchmarks/simulate.py speed --engine kinematic --map lab --robots 64
    OMP_NUM_THREADS=1 python tests/benchmarks/simulate.py agreement --episodes 200 --workers 2

`speed`: robot-steps per second on one thread. A robot-step is one control interval of one robot: motion, noisy rays,
clearance, reward, observation. Robots that are done are reset into freshly drawn scenarios; that is part of the time,
as is the drawing of commands. `unicycle`: where constant commands lead after two seconds. `memory`: over 1,000 resets.
`agreement`: the same policy in the same scenarios in both engines.
"""

from __future__ import annotations

import argparse
import os
import time

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from viatool.policy import load_policy
from viatool.setting.reconcile import with_robot
from viatool.setting.setting import Setting
from viatool.simulate import Conditions, make_simulator, simulate
from viatool.simulate.models import MODELS
from viatool.world import ROBOTS, Obstacles, Scenario, WorldMap, load_map

TARGETS = {
    ("kinematic", "lab"): 120_000,
    ("kinematic", "lab, boxes"): 60_000,
    ("bullet rays", "lab"): 400,
    ("bullet analytic", "lab"): 1_000,
}


def boxed(world_map: WorldMap) -> WorldMap:
    """Return a map with squares in place of its circles, fixed and random ones."""
    from dataclasses import replace

    from viatool.world import box_polygon

    fixed = world_map.obstacles.circles
    squares = tuple(box_polygon((x, y), (1.77 * r, 1.77 * r), 0.3) for x, y, r in fixed)
    generator = world_map.generator
    assert generator is not None
    sizes = tuple((1.77 * radius, 1.77 * radius) for radius in generator.radii)
    obstacles = Obstacles(polygons=squares)
    drawn = replace(generator, obstacles=obstacles, radii=(), boxes=sizes)
    return replace(world_map, name="lab, boxes", obstacles=obstacles, generator=drawn)


def measure_speed(world_map: WorldMap, robots: int, steps: int, engine: str, lidar: str | None) -> None:
    """Print robot-steps per second, of the processor and of the clock, at best and in the median of ten rounds."""
    simulator = make_simulator(engine, world_map, robots, seed=0, lidar=lidar)
    rng = np.random.default_rng(0)
    limits = np.array([world_map.robot.max_linear, world_map.robot.max_angular])
    simulator.reset()
    rates = []
    for _ in range(10):
        start = time.process_time(), time.perf_counter()
        for _ in range(max(steps // 10, 1)):
            done = simulator.step(rng.uniform([0.0, -1.0], 1.0, (robots, 2)) * limits).done
            if done.any():
                simulator.reset(done)
        took = time.process_time() - start[0], time.perf_counter() - start[1]
        rates.append([robots * max(steps // 10, 1) / seconds for seconds in took])
    simulator.close()
    processor, clock = np.array(rates).T
    name = engine if lidar is None else f"{engine} {lidar}"
    target = TARGETS.get((name, world_map.name))
    print(
        f"{name:16s} {world_map.name:12s} {robots:4d} robots: {processor.max():8.0f} at best, "
        f"{np.median(processor):8.0f} in the median per second of the processor; {np.median(clock):8.0f} by the clock"
        + (f"; target {target:,}" if target else "")
    )


def measure_unicycle() -> None:
    """Print the distance between the physics engine and the unicycle after two seconds of constant commands."""
    from dataclasses import replace

    lab = load_map("lab")
    for robot in ("turtlebot3", "turtlebot3_burger", "turtlebot3_waffle", "jackal"):
        empty = replace(with_robot(lab, robot), obstacles=Obstacles())
        limits, model = ROBOTS[robot], MODELS[robot]
        fast, turning = min(limits.max_linear, 1.0), min(limits.max_angular, 2.0)
        grid = [(a * fast, b * turning) for a in (0.0, 0.5, 1.0) for b in (-1.0, -0.5, 0.0, 0.5, 1.0)]
        grid.remove((0.0, 0.0))
        start = Scenario("", (-2.0, -2.0, 0.3), (4.0, 4.0))
        ends = []
        for engine in ("kinematic", "bullet"):
            simulator = make_simulator(
                engine,
                empty,
                len(grid),
                scenarios=[start] * len(grid),
                conditions=Conditions(acceleration=model.acceleration),
            )
            simulator.reset()
            for _ in range(round(2.0 / empty.robot.control_interval)):
                simulator.step(np.array(grid))
            ends.append(simulator.poses)
            simulator.close()
        away = 1e3 * np.hypot(*(ends[0] - ends[1])[:, :2].T)
        turned = np.abs(np.angle(np.exp(1j * (ends[0] - ends[1])[:, 2])))
        print(
            f"{robot:18s} {len(grid)} commands up to {fast:g} m/s and {turning:g} rad/s: {away.max():.1f} mm at most, "
            f"{away.mean():.1f} mm on average, {turned.max():.4f} rad at most; target 20 mm"
        )


def measure_memory() -> None:
    """Print the resident memory over 1,000 resets into drawn scenarios, with cylinders and with boxes."""
    for world_map in (load_map("lab"), boxed(load_map("lab"))):
        simulator = make_simulator("bullet", world_map, 1, lidar="analytic")
        seen = []
        for reset in range(1101):
            simulator.reset()
            if reset >= 100 and reset % 250 == 100:
                with open("/proc/self/statm", encoding="ascii") as stream:
                    seen.append(int(stream.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6)
        simulator.close()
        print(
            f"{world_map.name:12s} MB after 100, 350, 600, 850, 1100 resets:", *(f"{one:.1f}" for one in seen)
        )


def measure_agreement(episodes: int, workers: int, lidar: str) -> None:
    """Print how the same policy ends in the same scenarios in both engines, TurtleBot3 without latency."""
    policy, lab = load_policy("via"), load_map("lab")
    assert lab.generator is not None
    scenarios = lab.generator.draw(episodes, 7)
    rates, setting = [], Setting.of(policy, lab, 0.0, scenarios=scenarios)
    for engine in ("kinematic", "bullet"):
        chosen = lidar if engine == "bullet" else None
        found = simulate(
            policy,
            setting,
            engine=engine,
            seed=7,
            workers=workers,
            lidar=chosen,
        ).statistics
        rates.append(100.0 * found.success.rate)
        counts = [f"{name} {getattr(found, name).count}" for name in ("success", "collision", "timeout")]
        low, high = (100.0 * end for end in found.success.interval)
        print(
            f"{engine:10s} {episodes} scenarios: {', '.join(counts)}; success {rates[-1]:.1f} % "
            f"[{low:.1f}, {high:.1f}], cost {found.average_cost:.2f}, {found.time_to_goal.mean:.2f} s to the goal",
            flush=True,
        )
    print(f"success differs by {abs(rates[0] - rates[1]):.1f} points; target 3")


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", nargs="*", default=["speed", "unicycle", "memory", "agreement"])
    parser.add_argument("--engine", choices=["kinematic", "bullet"])
    parser.add_argument("--map", nargs="*", default=["lab", "boxes", "office", "warehouse"])
    parser.add_argument("--robots", type=int, nargs="*", default=[1, 64])
    parser.add_argument("--steps", type=int, default=500)
    parser.add_argument("--episodes", type=int, default=200)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--lidar", choices=["rays", "analytic"], default="rays")
    given = parser.parse_args()
    if "speed" in given.what:
        for name in given.map:
            world_map = boxed(load_map("lab")) if name == "boxes" else load_map(name)
            for robots in given.robots if given.engine != "bullet" else []:
                measure_speed(world_map, robots, given.steps, "kinematic", None)
            for lidar in ("rays", "analytic") if given.engine != "kinematic" and name == "lab" else ():
                measure_speed(world_map, 8, 200, "bullet", lidar)
    if "unicycle" in given.what:
        measure_unicycle()
    if "memory" in given.what:
        measure_memory()
    if "agreement" in given.what:
        measure_agreement(given.episodes, given.workers, given.lidar)


if __name__ == "__main__":
    main()
