"""Attack a verification by sampling: observations in their boxes, through onnxruntime, along exact paths.

    python tests/benchmarks/soundness.py [--policy FILE] [--map FILE] [--eps 0.01] [--samples 1000000]
    [--poses 2000]

For every state of a run, random points and random corners of its observation box are rounded to float32,
run through onnxruntime, clipped by the robot and driven. Counted are commands outside of the bounds, and
violations in states that are called safe. `--poses` adds states that are drawn right at the collision
distance, of which nearly all are contested; a good policy visits few of them. The bounds and verdicts come
from viatool, the driving and the distances from tests/safety/brute_force.py, which shares no code with it.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import shapely

sys.path.insert(0, str(Path(__file__).parents[2]))

from tests.safety.brute_force import drive_all
from viatool.channels import View
from viatool.policy import load_policy
from viatool.simulate import Observer
from viatool.trajectory import Trajectory
from viatool.verification import verify
from viatool.world import Scenes, load_map

INSTANTS = np.linspace(0.0, 1.0, 9)[None]


def poses_at_the_edge(policy, world_map, count, seed, reach=0.06):
    """States with a clearance just above the collision distance, observed without noise."""
    generator = np.random.default_rng(seed)
    scenarios = world_map.scenarios
    x_min, y_min, x_max, y_max = world_map.bounds
    scenes = Scenes.of(world_map, scenarios)
    poses, scene = np.zeros((0, 3)), np.zeros(0, dtype=np.int64)
    while len(poses) < count:
        drawn = generator.uniform((x_min, y_min, -np.pi), (x_max, y_max, np.pi), (20 * count, 3))
        of = generator.integers(len(scenarios), size=len(drawn))
        left = scenes.clearance(drawn[:, :2], of) - world_map.clearance.collision
        near = (left > 0.0) & (left < reach)
        poses, scene = np.concatenate([poses, drawn[near]]), np.concatenate([scene, of[near]])
    poses, scene = poses[:count], scene[:count]
    robot = world_map.robot
    previous = generator.uniform([0.0, -robot.max_angular], [robot.max_linear, robot.max_angular], (count, 2))
    goals = generator.uniform((x_min, y_min), (x_max, y_max), (count, 2))
    observer = Observer(policy.spec.observation, robot, noise=0.0)
    order = np.argsort(scene, kind="stable")
    view = View(scenes, poses[order], scene[order], goals[order], previous[order])
    return Trajectory(
        poses=view.poses,
        observations=observer.observe(view, generator),
        actions=np.zeros((count, 0)),
        episode=view.scene,
        time=np.arange(count),
        outcomes=np.full(len(scenarios), "unknown"),
        costs=np.full(len(scenarios), np.nan),
        scenarios=scenarios,
    )


def attack(policy, result, samples, seed):
    """Return how many commands were sampled, lay outside of the bounds, and violated in a safe state."""
    generator = np.random.default_rng(seed)
    table, robot = result.state_table(), result.world_map.robot
    states = len(table["verdict"])
    counts = np.zeros(3, dtype=np.int64)
    while counts[0] < samples:
        state = generator.integers(states, size=min(100_000, samples))
        low, high = table["observation"] - table["eps"], table["observation"] + table["eps"]
        share = generator.uniform(0.0, 1.0, (len(state), table["observation"].shape[1]))
        corners = generator.random(len(state)) < 0.5
        share[corners] = np.round(share[corners])
        points = (low[state] + share * (high - low)[state]).astype(np.float32)
        points = np.where(points > high[state], np.nextafter(points, np.float32(-np.inf)), points)
        points = np.where(points < low[state], np.nextafter(points, np.float32(np.inf)), points)
        actions = policy.run(points).astype(np.float64)
        outside = (actions < table["lower"][state]) | (actions > table["upper"][state])
        commands = result.setting.command_map(actions)
        commands = np.clip(
            commands, (robot.min_linear, -robot.max_angular), (robot.max_linear, robot.max_angular)
        )
        safe = table["verdict"][state] == "safe"
        left = least_clearance(result, state[safe], commands[safe])
        collision = result.rules.clearance.collision
        counts += (len(state), int(outside.any(axis=1).sum()), int((left <= collision).sum()))
    return counts.tolist()


def least_clearance(result, state, commands):
    """Return the least distance on the paths of commands, (S,), by formulas of their own."""
    pose = result.poses[state]
    interval = result.world_map.robot.control_interval
    places = drive_all(pose, commands[:, 0], commands[:, 1], INSTANTS * interval, np.float64)
    world = result.world_map
    walls = shapely.Polygon(world.arena).exterior
    solid = shapely.union_all([walls, *(shapely.Polygon(polygon) for polygon in world.obstacles.polygons)])
    shapely.prepare(solid)
    least = shapely.distance(shapely.points(places[..., :2]), solid).min(axis=1)
    for episode, scenario in enumerate(result.trajectory.scenarios):
        rows = np.flatnonzero(result.episode[state] == episode)
        own = [] if scenario is None else list(scenario.obstacles.circles)
        for x, y, radius in [*world.obstacles.circles, *own]:
            away = np.hypot(places[rows, :, 0] - x, places[rows, :, 1] - y).min(axis=1) - radius
            least[rows] = np.minimum(least[rows], away)
    return least


def report(name, policy, result, samples, seed):
    verdict, contested = result.verdict, result.contested.collision
    unknown = int((contested & (verdict == "unknown")).sum())
    print(f"{name}: {len(verdict):,} states, safe: {result.safety_rate}")
    print(f"  contested {contested.sum():,}, safe of these: {result.contested_rate}")
    print(f"  unsafe {len(result.witnesses):,}, contested and unknown {unknown:,}")
    start = time.perf_counter()
    sampled, outside, violations = attack(policy, result, samples, seed)
    print(
        f"  {sampled:,} commands sampled: {outside} outside of their bounds, "
        f"{violations} violations in states called safe ({time.perf_counter() - start:.0f} s)"
    )
    return outside + violations


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--policy", default="policies/via.onnx")
    parser.add_argument("--map", default="maps/lab.yaml")
    parser.add_argument("--eps", type=float, default=0.01)
    parser.add_argument("--samples", type=int, default=1_000_000)
    parser.add_argument("--poses", type=int, default=2000)
    parser.add_argument("--refine", default="monotone")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    policy, world_map = load_policy(given.policy), load_map(given.map)
    options = {"eps": given.eps, "refine": given.refine}
    failures = report("visited", policy, verify(policy, world_map, **options), given.samples, given.seed)
    if given.poses:
        edge = poses_at_the_edge(policy, world_map, given.poses, given.seed)
        result = verify(policy, replace(world_map), trajectory=edge, **options)
        failures += report("at the edge", policy, result, given.samples, given.seed)
    sys.exit(1 if failures else 0)


if __name__ == "__main__":
    main()
