"""Try to break certificates: random states of certified cells, by a simulator that shares no code with the proofs.

    python tests/benchmarks/certified.py policies/via.onnx maps/room.yaml cells.npz --states 1000000

Takes the cells of ``viatool certify ... --output cells:cells.npz``, draws poses, previous commands and sensor errors
in them (errors at their ends as often as between), and asks onnxruntime for the command. Ranges come from school
formulas, ray by ray, the motion from integrating in 40 steps, distances from shapely. Prints the violations.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
import shapely

from tests.certify.ray_oracle import outlines, scan
from viatool import load_map, load_policy
from viatool.world import Obstacles

STEPS = 40


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("policy", type=Path)
    options.add_argument("map", type=Path)
    options.add_argument("cells", type=Path)
    options.add_argument("--scenario", type=int, default=0)
    options.add_argument("--eps", type=float, default=0.01)
    options.add_argument("--states", type=int, default=1_000_000)
    options.add_argument("--seed", type=int, default=0)
    given = options.parse_args()
    policy, world = load_policy(given.policy), load_map(given.map)
    scenario = world.scenarios[given.scenario]
    table = np.load(given.cells)
    certified = table["status"] == "certified"
    lower, upper = table["lower"][certified], table["upper"][certified]
    generator = np.random.default_rng(given.seed)
    start, tried, broken, nearest = time.process_time(), 0, 0, np.inf
    while tried < given.states:
        count = min(20_000, given.states - tried)
        left = try_states(policy, world, scenario, lower, upper, given.eps, generator, count)
        tried += len(left)
        broken += int((left < 0.0).sum())
        nearest = min(nearest, float(left.min(initial=np.inf)))
    print(f"{certified.sum():,} certified cells, {tried:,} states, {broken} violations")
    print(
        f"least distance beyond the collision distance: {nearest:.2e} m; {time.process_time() - start:.0f} s CPU"
    )


def try_states(policy, world, scenario, lower, upper, eps, generator, count):
    """How much more than the collision distance is left on the paths of random free states of random cells."""
    rows = generator.integers(len(lower), size=count)
    shares = generator.random((count, 5))
    ends = generator.random((count, 5)) < 0.3
    shares = np.where(ends, np.round(shares), shares)
    states = lower[rows] + shares * (upper[rows] - lower[rows])
    solid = solid_of(world, scenario)
    distance = world.clearance.collision
    free = away(states[:, :2], solid) > distance
    states = states[free]
    commands = command(policy, world, scenario, states, eps, generator)
    paths = drive(states[:, :3], commands, world.robot)
    return away(paths.reshape(-1, 2), solid).reshape(len(states), -1).min(axis=1) - distance


def command(policy, world, scenario, states, eps, generator):
    """What the deployed program commands for a sensor error within eps of what a perfect sensor reads."""
    spec, poses = policy.spec, states[:, :3]
    lidar = world.robot.lidar
    ranges = scan(poses, lidar, outlines(world, scenario))
    dx, dy = np.asarray(scenario.goal)[:, None] - poses[:, :2].T
    bearing = np.arctan2(dy, dx) - poses[:, 2]
    values = {
        "lidar": ranges, "goal_distance": np.hypot(dx, dy), "goal_cosine": np.cos(bearing),
        "goal_sine": np.sin(bearing), "previous_linear": states[:, 3], "previous_angular": states[:, 4],
    }  # fmt: skip
    columns, radii = [], []
    for channel in spec.observation:
        fixed = channel.value is not None
        value = np.full(len(states), channel.value) if fixed else values[channel.kind]
        columns.append(value.reshape(len(states), -1))
        radii += [0.0 if fixed else eps] * columns[-1].shape[1]
    error = generator.uniform(-1, 1, (len(states), len(radii)))
    corner = generator.random(len(states)) < 0.5
    error[corner] = np.sign(error[corner])
    raw = policy.run((np.hstack(columns) + error * np.array(radii)).astype(np.float32))
    kinds = [channel.kind for channel in spec.action]
    robot = world.robot
    linear = np.clip(raw[:, kinds.index("linear")], robot.min_linear, robot.max_linear)
    angular = np.clip(raw[:, kinds.index("angular")], -robot.max_angular, robot.max_angular)
    return np.column_stack([linear, angular]).astype(float)


def drive(poses, commands, robot):
    """Places on the way under a command and the braking after it, (B, STEPS + 1, 2), by the midpoint rule."""
    v, w = commands.T
    stop = np.abs(v) / robot.deceleration
    total = robot.control_interval + stop
    step = total / (STEPS * 10)
    x, y, theta = poses.T.copy()
    places = [np.stack([x, y], axis=1)]
    for number in range(STEPS * 10):
        middle = (number + 0.5) * step
        left = np.where(
            middle < robot.control_interval,
            1.0,
            1.0 - (middle - robot.control_interval) / np.maximum(stop, 1e-9),
        )
        left = np.clip(left, 0.0, 1.0)
        half = theta + 0.5 * w * left * step
        x, y, theta = (
            x + v * left * step * np.cos(half),
            y + v * left * step * np.sin(half),
            theta + w * left * step,
        )
        if (number + 1) % 10 == 0:
            places.append(np.stack([x, y], axis=1))
    return np.stack(places, axis=1)


def solid_of(world, scenario):
    """Polygons and the outside of the arena as one geometry, and circles (K, 3)."""
    obstacles = world.obstacles + (scenario.obstacles if scenario else Obstacles())
    x0, y0, x1, y1 = world.bounds
    outside = shapely.box(x0 - 5, y0 - 5, x1 + 5, y1 + 5).difference(shapely.Polygon(world.arena))
    return shapely.union_all(
        [outside, *(shapely.Polygon(ring) for ring in obstacles.polygons)]
    ), obstacles.circles


def away(places, solid):
    """Distances of places (B, 2) from everything solid."""
    geometry, circles = solid
    shapely.prepare(geometry)
    least = shapely.distance(shapely.points(places), geometry)
    for x, y, radius in circles:
        least = np.minimum(least, np.hypot(places[:, 0] - x, places[:, 1] - y) - radius)
    return least


if __name__ == "__main__":
    main()
