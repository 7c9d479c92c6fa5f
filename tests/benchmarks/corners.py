"""Attack proofs by driving: robots at the corners of an error model, from states that are called safe.

    python tests/benchmarks/corners.py [--intervals 1000000] [--states 300] [--seed 0]

Four maps, three kinematics (differential, holonomic, car), three footprints (point, disc, polygon), three error models:
states near obstacles are verified by `braking` with errors of readings, motors and clock, by a policy that is linear in
what it observes. From those that are called safe and that some command could make fail, robots are driven with errors
at the corners of the model: readings, one ray lost, the slowest and the fastest motors, commands late or early, and
stops that begin late or early, as slow as the model allows or faster, speed and turn each. In half of the drives all
errors push the same way (readings by the weights of the policy, motors by their gain, bias, lag and first velocity);
in the others each is drawn by itself, and gains flip. With the model `moving`, obstacles go straight at the robot.

Counted are robots that come nearer than the collision distance. Motors, clock, paths and distances are written out here
and in tests/safety/brute_force.py, in small steps and with shapely, and share no code with viatool. All corners of the
clock are whole steps; what steps err otherwise is less than `MARGIN`, and nearer than that counts as a violation only
beyond it. `--loosen 0.3` verifies with errors at that share and drives with the whole ones: that has to find
violations.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from unittest import mock

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
from viatool.verification.examination import StateExamination
from viatool.world import Clearance, Footprint, Robot, Scenes, load_map

MAPS = ("lab", "office", "corridor", "warehouse")
MARGIN = 1e-3
STEP, EVERY = 0.01, 4
ROWS = 4096
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
LEVELS = {
    "whole": {
        "axis": {"acceleration": 1.2, "deceleration": 1.5, "lag": (0.03, 0.08), "relative": 0.05, "absolute": 0.01},
        "turn": {"acceleration": 4.0, "deceleration": 4.0, "lag": (0.02, 0.06), "relative": 0.08, "absolute": 0.03},
        "sensor": {"absolute": 0.02, "relative": 0.01, "bias": 0.02, "missing": 1},
        "timing": {"interval": (0.09, 0.12), "delay": (0.02, 0.06), "sensing": 0.03},
        "slip": 0.04,
        "speed": 0.0,
    },
    "mild": {
        "axis": {"acceleration": 4.0, "deceleration": 4.0, "lag": (0.0, 0.02), "relative": 0.02, "absolute": 0.005},
        "turn": {"acceleration": 12.0, "deceleration": 12.0, "lag": (0.0, 0.02), "relative": 0.03, "absolute": 0.01},
        "sensor": {"absolute": 0.01, "relative": 0.005, "bias": 0.01, "missing": 0},
        "timing": {"interval": (0.1, 0.11), "delay": (0.0, 0.02), "sensing": 0.01},
        "slip": 0.02,
        "speed": 0.0,
    },
}  # fmt: skip
LEVELS["moving"] = {**LEVELS["mild"], "speed": 0.15}
STANDS = 0.01  # m/s, of a robot that no longer runs into what comes


def model_of(kinematics, level, share=1.0):
    """The error model, with all errors at a share of what they are."""
    terms = LEVELS[level]

    def axis(terms):
        less = {name: share * terms[name] for name in ("relative", "absolute")}
        faster = {name: terms[name] / share for name in ("acceleration", "deceleration")}
        return {**less, **faster, "lag": [share * end for end in terms["lag"]]}

    around, clock = {"interval": INTERVAL, "delay": 0.0}, terms["timing"]
    timing = {name: [around[name] + share * (end - around[name]) for end in clock[name]] for name in around}
    actuation = {"linear": axis(terms["axis"]), "angular": axis(terms["turn"]), "slip": share * terms["slip"]}
    if kinematics == "holonomic":
        actuation["lateral"] = axis(terms["axis"])
    sensor = {name: share * terms["sensor"][name] for name in ("absolute", "relative", "bias")}
    sensor["missing"] = round(share * terms["sensor"]["missing"])
    model = {
        "sensor": {"lidar": sensor},
        "actuation": actuation,
        "timing": {**timing, "sensing": share * clock["sensing"]},
    }
    if terms["speed"]:
        model["obstacles"] = {"speed": share * terms["speed"]}
    return ErrorModel.model_validate(model)


def policy_of(kinematics, folder, seed):
    """A policy that is linear in its readings and in the command before, and its weights (A, n)."""
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
    return load_policy(path), rows


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


def either(rng, low, high, *shape):
    """One of two ends."""
    return low + (high - low) * rng.integers(0, 2, shape)


def observed(rng, observations, sensor, weights, push):
    """Observations (M, n) with the errors of readings at corners; pushes (A, M) of 0 leave them to chance."""
    seen = observations.copy()
    true = observations[:, :BINS]
    short = 1.0 - 1e-6  # float32 shall not round beyond the model
    pull = push.T @ weights[:, :BINS]  # (M, BINS)
    aimed = np.any(push != 0.0, axis=0)[:, None]
    common = np.where(aimed, np.sign(pull.sum(axis=1, keepdims=True)), side(rng, len(seen), 1))
    by_itself = [np.where(aimed, np.sign(pull), side(rng, *true.shape)) for _ in range(2)]
    error = sensor["absolute"] * by_itself[0] + sensor["relative"] * true * by_itself[1]
    seen[:, :BINS] = np.clip(true + short * (error + sensor["bias"] * common), 0.0, FARTHEST)
    if sensor["missing"]:
        gain = pull * (FARTHEST - seen[:, :BINS])
        lost = np.where(aimed[:, 0], gain.argmax(axis=1), rng.integers(BINS, size=len(seen)))
        some = np.flatnonzero(rng.random(len(seen)) < 0.6)
        seen[some, lost[some]] = FARTHEST
    return seen


def commanded(policy, world, observations):
    """Velocities (3, M) that the policy asks for, clipped to the robot."""
    kinematics, actions = world.robot.kinematics, ROBOTS[world.robot.kinematics][1]
    raw = policy.run(observations).astype(np.float64)
    raw = np.clip(raw, [low for _, low, _ in actions], [high for *_, high in actions])
    return np.ascontiguousarray(velocities(kinematics, raw, world.robot.wheelbase).T)


def velocities(kinematics, raw, wheelbase=0.0):
    if kinematics == "holonomic":
        return raw
    turn = raw[:, 1] if not wheelbase else raw[:, 0] * np.tan(raw[:, 1]) / wheelbase
    return np.stack([raw[:, 0], np.zeros(len(raw)), turn], axis=1)


def reachable(robot, relative, absolute):
    """The least and the largest velocity (3, 1) that the robot can have."""
    top = [robot.max_linear, robot.max_lateral, robot.max_angular]
    if robot.wheelbase:
        top[2] = robot.max_linear * np.tan(robot.max_steering) / robot.wheelbase
    low, high = np.array([[robot.min_linear], [-top[1]], [-top[2]]]), np.array(top)[:, None]
    return low - relative * np.abs(low) - absolute, high + relative * np.abs(high) + absolute


def drive(rng, robot, level, poses, before, command, push):
    """Drive (3, M) poses with commands (3, M) from the observation to the end of the stop.

    Pushes (3, M) of 0 leave the motors to chance. Returns poses (T, 3, M), seconds (T,) and the speed of the fastest
    point (T, M).
    """
    terms, count = LEVELS[level], poses.shape[1]
    tables = (terms["axis"], terms["axis"], terms["turn"])
    use = np.array([[1.0], [float(robot.kinematics == "holonomic")], [1.0]])
    relative, absolute, up, down = (
        np.array([[table[name]] for table in tables])
        for name in ("relative", "absolute", "acceleration", "deceleration")
    )
    relative, absolute = relative * use, absolute * use
    aimed = np.any(push != 0.0, axis=0)
    toward = np.where(aimed, push, side(rng, 3, count))
    low, high = reachable(robot, relative, absolute)
    velocity = np.where(toward > 0.0, high, low)
    soft, slow = (np.array([[table["lag"][end]] for table in tables]) for end in (0, 1))
    lag, faster = either(rng, soft, slow, 3, count), either(rng, 1.0, 6.0, 3, count)
    errors = np.stack([toward, np.where(aimed, push, side(rng, 3, count))])
    slips = terms["slip"] * np.where(aimed, toward[2], side(rng, 2, count))
    flip = rng.uniform(-0.2, 0.4, count)
    (least, most), (soon, late), old = (terms["timing"][name] for name in ("interval", "delay", "sensing"))
    age = either(rng, 0.0, old, count)
    acts = age + either(rng, soon, late, count)
    stops = np.maximum(acts, age + either(rng, least, most, count) + either(rng, soon, late, count))
    rim = robot.footprint.reach if robot.footprint.kind == "polygon" else 0.0
    brake = min(robot.deceleration, terms["axis"]["deceleration"])
    slower = np.where(rng.random((2, count)) < 0.6, 1.0, rng.uniform(0.05, 1.0, (2, count)))
    share, halt, worst = np.ones((2, count)), np.ones(count), float(slow.max())
    pose, began = poses.copy(), np.zeros(count, dtype=bool)
    found, times, speeds = [], [], []
    for number in range(round(-0.4 / STEP), 1000):
        clock = number * STEP
        pace = np.hypot(velocity[0], velocity[1]) + rim * np.abs(velocity[2])
        ended = began.all() and pace.max() < 1e-3
        if number >= 0 and (number % EVERY == 0 or ended):
            found.append(pose.copy())
            times.append(clock)
            speeds.append(pace)
        if ended:
            break
        middle = clock + 0.5 * STEP
        stopping = stops <= middle
        new = stopping & ~began
        if new.any():
            seconds = np.maximum(pace / brake, np.abs(velocity[2]) / tables[2]["deceleration"])
            halt = np.where(new, np.maximum(seconds, 1e-9), halt)
            began |= new
        wanted = np.where(acts <= middle, command, before)
        which = middle > flip
        error, slip = np.where(which, errors[1], errors[0]), np.where(which, slips[1], slips[0])
        target = wanted + error * (relative * np.abs(wanted) + absolute)
        helps = aimed & (push * (target - velocity) > 0.0)
        rate = np.where(aimed, np.where(helps, 1e6, 1.0), faster)
        moved = approach(
            velocity, target, rate * up, rate * down, np.where(aimed, np.where(helps, soft, slow), lag)
        )
        fall = np.minimum(STEP / (slower * halt), share * fading(worst))
        lower = np.where(stopping, np.maximum(share - fall, 0.0), share)
        ratio = lower / np.where(share > 0.0, share, 1.0)
        after = np.where(stopping, velocity * ratio[[0, 0, 1]], moved)
        share = lower
        if number >= 0:
            held = 0.5 * (velocity + after)
            aside = held[1] + slip * np.hypot(held[0], held[1])
            angle = pose[2] + 0.5 * STEP * held[2]
            cosine, sine = np.cos(angle), np.sin(angle)
            pose[0] += STEP * (held[0] * cosine - aside * sine)
            pose[1] += STEP * (held[0] * sine + aside * cosine)
            pose[2] += STEP * held[2]
        velocity = after
    return np.stack(found), np.array(times), np.stack(speeds)


def fading(lag):
    """The share of a gap that closes in one step by a lag."""
    return 1.0 - np.exp(-STEP / np.maximum(lag, 1e-9))


def approach(velocity, target, up, down, lag):
    """One step of v' = sign(w - v) min(a, |w - v| / tau), the limit being that of growing or of falling."""
    gap = target - velocity
    limit = np.where(velocity * gap >= 0.0, up, down)
    moved = velocity + np.sign(gap) * np.minimum(np.abs(gap) * fading(lag), limit * STEP)
    crosses = velocity * moved < 0.0  # it pauses at 0 for the rest of the step
    return np.where(crosses, 0.0, moved)


def solids_of(world, scenario):
    """What stands around: outside of the arena, and obstacles as one shape and circles."""
    x_min, y_min, x_max, y_max = world.bounds
    outside = shapely.box(x_min - 9, y_min - 9, x_max + 9, y_max + 9).difference(shapely.Polygon(world.arena))
    parts = [world.obstacles, *([] if scenario is None else [scenario.obstacles])]
    solid = shapely.union_all([shapely.Polygon(one) for part in parts for one in part.polygons])
    for shape in (outside, solid):
        shapely.prepare(shape)
    return outside, solid, np.array([circle for part in parts for circle in part.circles]).reshape(-1, 3)


def between(shapes, around, moved):
    """Distances of (M,) shapes from what stands, and from obstacles that have moved (M,) towards them."""
    outside, solid, circles = around
    to_solid = shapely.distance(shapes, solid) if not solid.is_empty else np.full(len(shapes), np.inf)
    for x, y, radius in circles:
        to_solid = np.minimum(to_solid, shapely.distance(shapes, shapely.Point(x, y)) - radius)
    return np.minimum(shapely.distance(shapes, outside), to_solid - moved)


def left_over(world, flat, around, moved):
    """The clearance of poses (M, 3) beyond the collision distance; far from everything, that of the middle."""
    footprint, limit = world.robot.footprint, world.clearance.collision
    away = between(shapely.points(flat[:, :2]), around, moved) - footprint.reach - limit
    if footprint.kind == "polygon":
        close = np.flatnonzero(away < 0.03)
        away[close] = between(place(flat[close], footprint), around, moved[close]) - limit
    return away


def nearest(world, level, poses, seconds, speeds, around):
    """The least that each of M drives leaves; instants at which others show that more is left are not looked at."""
    instants, _, count = poses.shape
    speed, fast = LEVELS[level]["speed"], 0.7 + 2.0 * world.robot.footprint.reach
    counts = (speeds > STANDS) | (speed == 0.0)
    left = np.full((instants, count), np.inf)
    lowest, known = np.full((instants, count), -np.inf), np.zeros(instants, dtype=bool)
    rough = sorted({0, *range(5, instants, 6), instants - 1})
    for batch in (rough, [one for one in range(instants) if one not in rough]):
        apart = np.abs(seconds[:, None] - seconds[known][None]) * (fast + speed) if known.any() else None
        for one in batch:
            rows = counts[one]
            if apart is not None:
                rows = rows & ((lowest[known] - apart[one][:, None]).max(axis=0) < left.min(axis=0))
            rows = np.flatnonzero(rows)
            moved = np.full(len(rows), speed * seconds[one])
            left[one, rows] = left_over(world, poses[one][:, rows].T, around, moved)
        known[batch] = True
        lowest = np.where(np.isfinite(left), left, -np.inf)
    return left.min(axis=0)


def attack(policy, weights, world, level, result, intervals, seed):
    """Return how many intervals were driven, how many violate, the least that was left, and from how many states."""
    rng, robot = np.random.default_rng(seed), world.robot
    chosen = np.flatnonzero((result.verdict == "safe") & result.contested.collision)
    if not len(chosen):
        return 0, 0, np.inf, 0
    around = {
        one: solids_of(world, result.trajectory.scenarios[one])
        for one in set(result.episode[chosen].tolist())
    }
    rows = np.repeat(chosen, -(-intervals // len(chosen)))[:intervals]
    axes = [0, 1, 2] if robot.kinematics == "holonomic" else [0, 2]
    violations, least = 0, np.inf
    for start in range(0, len(rows), ROWS):
        some = rows[start : start + ROWS]
        push = np.zeros((3, len(some)))
        push[axes] = rng.integers(-1, 2, (len(axes), len(some))) * (rng.random(len(some)) < 0.6)
        seen = observed(rng, result.observations[some], LEVELS[level]["sensor"], weights, push[axes])
        before = velocities("holonomic" if len(axes) == 3 else "plain", result.under_way[some, -1]).T
        poses, seconds, speeds = drive(
            rng, robot, level, result.poses[some].T, before, commanded(policy, world, seen), push
        )
        for episode, shapes in around.items():
            here = result.episode[some] == episode
            if here.any():
                left = nearest(world, level, poses[:, :, here], seconds, speeds[:, here], shapes)
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
    parser.add_argument("--levels", nargs="+", default=list(LEVELS))
    given = parser.parse_args()
    print("$ python tests/benchmarks/corners.py", *sys.argv[1:])
    print(f"{'map':10} {'kinematics':13} {'body':8} {'model':7} {'states':>6} {'contested':>9} {'safe':>5} "
          f"{'driven':>9} {'violations':>10} {'left at least':>13}")  # fmt: skip
    settings = [(m, k, f, e) for m in given.maps for k in ROBOTS for f in FOOTPRINTS for e in given.levels]
    begun, total, violated = time.process_time(), 0, 0
    with tempfile.TemporaryDirectory() as folder:
        for number, (name, kinematics, body, level) in enumerate(settings):
            seed = given.seed + number
            policy, weights = policy_of(kinematics, Path(folder), seed)
            world = world_of(name, kinematics, *FOOTPRINTS[body])
            states = states_near(policy, world, given.states, seed)
            model = model_of(kinematics, level, given.loosen)
            with mock.patch(
                "viatool.verification.job.StateExamination", partial(StateExamination, search=False)
            ):
                result = verify(
                    policy, world, errors=model, eps={"": 0.0}, criterion="braking", trajectory=states,
                    refine="none", only_contested=True,
                )  # fmt: skip
            share = (given.intervals - total) // (len(settings) - number)
            driven, violations, least, safe = attack(policy, weights, world, level, result, share, seed)
            total, violated = total + driven, violated + violations
            print(f"{name:10} {kinematics:13} {body:8} {level:7} {len(result.verdict):6} "
                  f"{result.contested.collision.sum():9} {safe:5} {driven:9,} {violations:10} "
                  f"{1000.0 * least:10.1f} mm", flush=True)  # fmt: skip
    print(f"{total:,} driven intervals, {violated} violations in states called safe, "
          f"{time.process_time() - begun:.0f} s of CPU")  # fmt: skip
    sys.exit(1 if violated else 0)


if __name__ == "__main__":
    main()
