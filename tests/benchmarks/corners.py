"""Attack proofs by driving: robots at the corners of an error model, from states that are called safe.

    python tests/benchmarks/corners.py [--intervals 1000000] [--states 300] [--seed 0]

Four maps, three kinematics (differential, holonomic, car), three footprints (point, disc, polygon): states near
obstacles are verified by `braking` with errors of readings, motors and clock, by a policy that is linear in what it
observes. From those that are called safe and that some command could make fail, robots are driven with errors at the
corners of the model: readings, one ray lost, gains that flip, the slowest and the fastest motors, commands late or
early, and stops that begin late or early, as slow as the model allows or faster. Counted are robots that come nearer
than the collision distance. Motors, clock, paths and distances are written out here and in tests/safety/brute_force.py,
in small steps and with shapely, and share no code with viatool; steps err by less than `MARGIN`, and nearer than that
counts as a violation only beyond it. `--loosen 0.3` verifies with errors at that share and drives with the whole ones:
that has to find violations.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import shapely

sys.path.insert(0, str(Path(__file__).parents[2]))

from tests.safety.brute_force import place
from viatool.channels import LidarSpecification, View
from viatool.policy import (
    ActionChannel,
    Affine,
    Input,
    Network,
    ObservationChannel,
    PolicySpecification,
    load_policy,
    write_onnx,
)
from viatool.simulate import Observer
from viatool.trajectory import Trajectory
from viatool.uncertainty import ErrorModel
from viatool.verification import verify
from viatool.world import Clearance, Footprint, Robot, Scenes, load_map

MAPS = ("lab", "office", "corridor", "warehouse")
MARGIN = 1e-3
STEP, EVERY = 0.005, 6
BINS, FARTHEST = 24, 6.0
INTERVAL = 0.1
FOOTPRINTS = {
    "point": (Footprint(), 0.25),
    "disc": (Footprint("circle", radius=0.2), 0.05),
    "polygon": (Footprint.rectangle(0.5, 0.3), 0.05),
}
ROBOTS = {
    "differential": ({}, (("linear", 0.0, 0.6), ("angular", -1.5, 1.5))),
    "holonomic": (
        {"min_linear": -0.3, "max_lateral": 0.4},
        (("linear", -0.3, 0.6), ("lateral", -0.4, 0.4), ("angular", -1.5, 1.5)),
    ),
    "ackermann": (
        {"min_linear": -0.3, "wheelbase": 0.35, "max_steering": 0.45},
        (("linear", -0.3, 0.6), ("steering", -0.45, 0.45)),
    ),
}
AXIS = {"acceleration": 1.2, "deceleration": 1.5, "lag": (0.03, 0.08), "relative": 0.05, "absolute": 0.01}
TURN = {"acceleration": 4.0, "deceleration": 4.0, "lag": (0.02, 0.06), "relative": 0.08, "absolute": 0.03}
SENSOR = {"absolute": 0.02, "relative": 0.01, "bias": 0.02, "missing": 1}
TIMING = {"interval": (0.09, 0.12), "delay": (0.02, 0.06), "sensing": 0.03}
SLIP = 0.04


def model_of(kinematics, share=1.0):
    """The error model, with all errors at a share of what they are."""

    def axis(terms):
        less = {name: share * terms[name] for name in ("relative", "absolute")}
        faster = {name: terms[name] / share for name in ("acceleration", "deceleration")}
        return {**less, **faster, "lag": [share * end for end in terms["lag"]]}

    around = {"interval": INTERVAL, "delay": 0.0}
    timing = {name: [around[name] + share * (end - around[name]) for end in TIMING[name]] for name in around}
    actuation = {"linear": axis(AXIS), "angular": axis(TURN), "slip": share * SLIP}
    if kinematics == "holonomic":
        actuation["lateral"] = axis(AXIS)
    sensor = {name: share * SENSOR[name] for name in ("absolute", "relative", "bias")}
    sensor["missing"] = round(share * SENSOR["missing"])
    return ErrorModel.model_validate(
        {
            "sensor": {"lidar": sensor},
            "actuation": actuation,
            "timing": {**timing, "sensing": share * TIMING["sensing"]},
        }
    )


def policy_of(kinematics, folder, seed):
    """A policy that is linear in its readings and in the command before."""
    rng = np.random.default_rng(seed)
    scan = LidarSpecification(
        start=0.0, step=2.0 * np.pi / BINS, rays=BINS, bins=BINS, minimum_range=0.0, maximum_range=FARTHEST
    )
    actions = ROBOTS[kinematics][1]
    axes = [kind if kind != "steering" else "angular" for kind, *_ in actions]
    observation = [
        ObservationChannel(name="lidar", size=BINS, unit="m", kind="lidar", lidar=scan),
        *(ObservationChannel(name=f"before_{axis}", kind=f"previous_{axis}") for axis in axes),
    ]
    spec = PolicySpecification(
        schema_version=2,
        observation=observation,
        action=[ActionChannel(name=kind, kind=kind, lower=low, upper=high) for kind, low, high in actions],
        control_interval=INTERVAL,
    )
    size = BINS + len(axes)
    bearing = 2.0 * np.pi * np.arange(BINS) / BINS
    weights = 0.02 * rng.standard_normal((len(actions), size))
    weights[0, :BINS] += 0.04 * np.cos(bearing) * (np.cos(bearing) > 0.5)  # slower where less is ahead
    weights[-1, :BINS] += 0.03 * np.sin(bearing)
    offset = np.zeros(len(actions))
    offset[0] = 0.15
    rows = np.float64(np.float32(weights))
    path = folder / f"{kinematics}.onnx"
    write_onnx(Network((Input(size), Affine((0,), (rows,), np.float64(np.float32(offset))))), spec, path)
    return load_policy(path)


def world_of(name, kinematics, footprint, distance):
    """A map with the robot."""
    world = load_map(name)
    robot = Robot(
        name="attacked", max_linear=0.6, max_angular=1.5, deceleration=1.0, control_interval=INTERVAL,
        footprint=footprint, kinematics=kinematics, **{"min_linear": 0.0, **ROBOTS[kinematics][0]},
    )  # fmt: skip
    return replace(
        world, robot=robot, clearance=Clearance(distance, distance + 0.1), stated=frozenset({"robot"})
    )


def states_near(policy, world, count, seed):
    """States that are a little farther than the collision distance from something."""
    rng = np.random.default_rng(seed)
    scenarios, robot = world.scenarios, world.robot
    scenes = Scenes.of(world, scenarios)
    x_min, y_min, x_max, y_max = world.bounds
    poses, scene = np.zeros((0, 3)), np.zeros(0, dtype=np.int64)
    while len(poses) < count:
        drawn = rng.uniform((x_min, y_min, -np.pi), (x_max, y_max, np.pi), (20 * count, 3))
        of = rng.integers(len(scenarios), size=len(drawn))
        left = scenes.footprint_clearance(drawn, robot.footprint, of) - world.clearance.collision
        near = (left > 0.02) & (left < 0.5)
        poses, scene = np.concatenate([poses, drawn[near]]), np.concatenate([scene, of[near]])
    order = np.argsort(scene[:count], kind="stable")
    poses, scene = poses[:count][order], scene[:count][order]
    lower = [robot.min_linear, *([-0.4] if robot.kinematics == "holonomic" else []), -0.6]
    upper = [robot.max_linear, *([0.4] if robot.kinematics == "holonomic" else []), 0.6]
    before = rng.uniform(lower, upper, (count, len(lower)))
    view = View(scenes, poses, scene, np.zeros((count, 2)), before)
    observer = Observer(policy.spec.observation, robot, noise=0.0)
    return Trajectory(
        poses=poses,
        observations=observer.observe(view, rng),
        actions=np.zeros((count, 0)),
        episode=scene,
        time=np.arange(count),
        outcomes=np.full(len(scenarios), "unknown"),
        costs=np.full(len(scenarios), np.nan),
        scenarios=scenarios,
        connected=False,
    )


def side(rng, *shape):
    return rng.integers(0, 2, shape) * 2.0 - 1.0


def observed(rng, observations):
    """Observations (M, n) with the errors of readings at corners."""
    seen = observations.copy()
    true, rows = observations[:, :BINS], np.arange(len(observations))
    short = 1.0 - 1e-6  # float32 shall not round beyond the model
    common = SENSOR["bias"] * side(rng, len(seen), 1)
    error = SENSOR["absolute"] * side(rng, *true.shape) + SENSOR["relative"] * true * side(rng, *true.shape)
    seen[:, :BINS] = np.clip(true + short * (error + common), 0.0, FARTHEST)
    lost = rows[rng.random(len(seen)) < 0.5]
    seen[lost, rng.integers(BINS, size=len(lost))] = FARTHEST
    return seen


def commanded(policy, world, observations):
    """Velocities (M, 3) that the policy asks for, clipped to the robot."""
    kinematics, actions = world.robot.kinematics, ROBOTS[world.robot.kinematics][1]
    raw = policy.run(observations).astype(np.float64)
    raw = np.clip(raw, [low for _, low, _ in actions], [high for *_, high in actions])
    return velocities(kinematics, raw, world.robot.wheelbase)


def velocities(kinematics, raw, wheelbase=0.0):
    if kinematics == "holonomic":
        return raw
    turn = raw[:, 1] if not wheelbase else raw[:, 0] * np.tan(raw[:, 1]) / wheelbase
    return np.stack([raw[:, 0], np.zeros(len(raw)), turn], axis=1)


def drive(rng, world, result, rows, command):
    """Return poses (M, T, 3) from the observation to the end of the stop."""
    robot, count = world.robot, len(rows)
    slides = robot.kinematics == "holonomic"
    table = (AXIS, AXIS, TURN)
    use = np.array([1.0, float(slides), 1.0])

    def of(name):
        return np.array([terms[name] for terms in table])

    def corner(low, high, *shape):
        return low + (high - low) * rng.integers(0, 2, shape)

    history = result.under_way[rows]
    before = velocities(
        "holonomic" if slides else "plain", history[:, -1]
    )  # all alike, as poses have no past
    relative, absolute = of("relative") * use, of("absolute") * use
    lag = corner(
        np.array([terms["lag"][0] for terms in table]),
        np.array([terms["lag"][1] for terms in table]),
        count,
        3,
    )
    faster = corner(1.0, 6.0, count, 3)
    up, down = of("acceleration") * faster, of("deceleration") * faster
    errors, flip = side(rng, 2, count, 3), rng.uniform(-0.2, 0.4, count)
    slip = SLIP * side(rng, 2, count)
    least, most = TIMING["interval"]
    soon, late = TIMING["delay"]
    age, delay, next_delay = (
        corner(0.0, TIMING["sensing"], count),
        corner(soon, late, count),
        corner(soon, late, count),
    )
    acts = age + delay
    stops = np.maximum(acts, age + corner(least, most, count) + next_delay)
    low, high = np.zeros(3), np.zeros(3)
    top = np.array([robot.max_linear, robot.max_lateral, robot.max_angular])
    if robot.wheelbase:
        top[2] = robot.max_linear * np.tan(robot.max_steering) / robot.wheelbase
    low[0], low[1], low[2], high = robot.min_linear, -top[1], -top[2], top
    reach = (low - (relative * np.abs(low) + absolute), high + relative * np.abs(high) + absolute)
    velocity = corner(*reach, count, 3)
    begins = min(0.0, late + TIMING["sensing"] - history.shape[1] * least)
    brake = np.minimum(robot.deceleration, AXIS["deceleration"])
    rim = robot.footprint.reach if robot.footprint.kind == "polygon" else 0.0
    share, halt, began = np.ones(count), np.ones(count), np.zeros(count, dtype=bool)
    slower = corner(0.4, 1.0, count)
    pose, found, clock = result.poses[rows].copy(), [], begins
    end = float(stops.max()) + (0.6 * 1.1 + 1.7 * rim) / 1.0 + 0.6
    number = 0
    while clock < end:
        if clock >= 0.0 and number % EVERY == 0:
            found.append(pose.copy())
        number += clock >= 0.0
        middle = clock + 0.5 * STEP
        stopping = stops <= middle
        new = stopping & ~began
        if new.any():
            speed, turn = np.hypot(velocity[:, 0], velocity[:, 1]), np.abs(velocity[:, 2])
            seconds = np.maximum((speed + rim * turn) / brake, turn / TURN["deceleration"])
            halt = np.where(new, np.maximum(slower * seconds, 1e-9), halt)
            began |= new
        wanted = np.where((acts <= middle)[:, None], command, before)
        which = (middle > flip).astype(int)
        target = wanted + errors[which, np.arange(count)] * (relative * np.abs(wanted) + absolute)
        moved = approach(velocity, target, up, down, lag)
        worst = lag.max(axis=1)
        fall = np.minimum(STEP / halt, share * (1.0 - np.exp(-STEP / worst)))
        lower = np.where(stopping, np.maximum(share - fall, 0.0), share)
        ratio = np.where(share > 0.0, lower / np.where(share > 0.0, share, 1.0), 0.0)
        after = np.where(stopping[:, None], velocity * ratio[:, None], moved)
        share = lower
        if clock >= 0.0:
            held = 0.5 * (velocity + after)
            aside = held[:, 1] + slip[which, np.arange(count)] * np.hypot(held[:, 0], held[:, 1])
            angle = pose[:, 2] + 0.5 * STEP * held[:, 2]
            pose[:, 0] += STEP * (held[:, 0] * np.cos(angle) - aside * np.sin(angle))
            pose[:, 1] += STEP * (held[:, 0] * np.sin(angle) + aside * np.cos(angle))
            pose[:, 2] += STEP * held[:, 2]
        velocity = after
        clock += min(STEP, -clock) if clock < -1e-12 else STEP
    found.append(pose.copy())
    return np.stack(found, axis=1)


def approach(velocity, target, up, down, lag):
    """One step of v' = sign(w - v) min(a, |w - v| / tau), the limit being that of growing or of falling."""
    gap = target - velocity
    limit = np.where(velocity * gap >= 0.0, up, down)
    soft = np.abs(gap) * (1.0 - np.exp(-STEP / lag))
    moved = velocity + np.sign(gap) * np.minimum(soft, limit * STEP)
    crosses = velocity * moved < 0.0  # it pauses at 0 for the rest of the step
    return np.where(crosses, 0.0, moved)


def solids_of(world, scenario):
    """What stands around: as one shape, and circles."""
    x_min, y_min, x_max, y_max = world.bounds
    outside = shapely.box(x_min - 9, y_min - 9, x_max + 9, y_max + 9).difference(shapely.Polygon(world.arena))
    parts = [world.obstacles, *([] if scenario is None else [scenario.obstacles])]
    solid = shapely.union_all([outside, *(shapely.Polygon(one) for part in parts for one in part.polygons)])
    shapely.prepare(solid)
    return solid, np.array([circle for part in parts for circle in part.circles]).reshape(-1, 3)


def nearest(world, poses, around):
    """The least clearance of each drive (M, T, 3); where the outline is far from everything, the middle is enough."""
    footprint, (solid, circles) = world.robot.footprint, around
    flat = poses.reshape(-1, 3)
    away = shapely.distance(shapely.points(flat[:, :2]), solid)
    for x, y, radius in circles:
        away = np.minimum(away, np.hypot(flat[:, 0] - x, flat[:, 1] - y) - radius)
    away = away - footprint.reach
    if footprint.kind == "polygon":
        close = np.flatnonzero(away < world.clearance.collision + 0.02)
        shapes = place(flat[close], footprint)
        found = shapely.distance(shapes, solid)
        for x, y, radius in circles:
            found = np.minimum(found, shapely.distance(shapes, shapely.Point(x, y)) - radius)
        away[close] = found
    return away.reshape(poses.shape[:2]).min(axis=1)


def attack(policy, world, result, intervals, seed):
    """Return how many intervals were driven, how many violate, the least that was left, and from how many states."""
    rng = np.random.default_rng(seed)
    chosen = np.flatnonzero((result.verdict == "safe") & result.contested.collision)
    if not len(chosen):
        return 0, 0, np.inf, 0
    around = {
        one: solids_of(world, result.trajectory.scenarios[one])
        for one in set(result.episode[chosen].tolist())
    }
    rows = np.repeat(chosen, max(1, intervals // len(chosen)))
    violations, least = 0, np.inf
    for start in range(0, len(rows), 20_000):
        some = rows[start : start + 20_000]
        command = commanded(policy, world, observed(rng, result.observations[some]))
        poses = drive(rng, world, result, some, command)
        for episode, shapes in around.items():
            here = poses[result.episode[some] == episode]
            if len(here):
                left = nearest(world, here, shapes) - world.clearance.collision
                violations += int((left < -MARGIN).sum())
                least = min(least, float(left.min()))
    return len(rows), violations, least, len(chosen)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--intervals", type=int, default=1_000_000)
    parser.add_argument("--states", type=int, default=300)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--loosen", type=float, default=1.0)
    parser.add_argument("--maps", nargs="+", default=MAPS)
    given = parser.parse_args()
    print("$ python tests/benchmarks/corners.py", *sys.argv[1:])
    print(f"{'map':10} {'kinematics':13} {'body':8} {'states':>6} {'contested':>9} {'safe':>5} {'driven':>9} "
          f"{'violations':>10} {'left at least':>13}")  # fmt: skip
    configurations = [(m, k, f) for m in given.maps for k in ROBOTS for f in FOOTPRINTS]
    begun, total, violated = time.perf_counter(), 0, 0
    with tempfile.TemporaryDirectory() as folder:
        for number, (name, kinematics, body) in enumerate(configurations):
            seed = given.seed + number
            policy = policy_of(kinematics, Path(folder), seed)
            world = world_of(name, kinematics, *FOOTPRINTS[body])
            result = verify(
                policy, world, errors=model_of(kinematics, given.loosen), eps={"": 0.0}, criterion="braking",
                trajectory=states_near(policy, world, given.states, seed), refine="none", only_contested=True,
            )  # fmt: skip
            share = (given.intervals - total) // (len(configurations) - number)
            driven, violations, least, safe = attack(policy, world, result, share, seed)
            total, violated = total + driven, violated + violations
            print(f"{name:10} {kinematics:13} {body:8} {len(result.verdict):6} "
                  f"{result.contested.collision.sum():9} {safe:5} {driven:9,} {violations:10} "
                  f"{1000.0 * least:10.1f} mm", flush=True)  # fmt: skip
    print(f"{total:,} driven intervals, {violated} violations in states called safe, "
          f"{time.perf_counter() - begun:.0f} s")  # fmt: skip
    sys.exit(1 if violated else 0)


if __name__ == "__main__":
    main()
