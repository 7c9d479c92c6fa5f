"""States around the distance that counts, and the least clearance that brute force finds for them."""

from __future__ import annotations

import numpy as np

from tests.safety.brute_force import clearance, drive_all, drive_and_stop, rim_of
from viatool.safety import JudgedStates, ScenePoses
from viatool.setting.rules import Rules


def near_states(world, scenario, footprint, generator, count, reach):
    """Poses with a clearance between 0 and the collision distance plus `reach`."""
    x_min, y_min, x_max, y_max = world.bounds
    low, high = (x_min, y_min, -4.0), (x_max, y_max, 4.0)
    found = np.zeros((0, 3))
    while len(found) < count:
        poses = generator.uniform(low, high, (4000, 3))
        left = clearance(world, poses, footprint, scenario)
        found = np.concatenate([found, poses[(left > 0.0) & (left < world.clearance.collision + reach)]])
    return found[:count]


def make_cases(world, criterion, seed, count=60, reach=0.12, scenario=None, **rules):
    """States just around the distance that counts, and action boxes as wide as real ones and wider."""
    generator = np.random.default_rng(seed)
    rules = Rules.of(world, criterion, **rules)
    poses = near_states(world, scenario, rules.footprint, generator, count, reach)
    placed = ScenePoses.of(world, [scenario], poses, np.zeros(count, dtype=np.int64))
    spread = rules.upper - rules.lower
    centre = generator.uniform(rules.lower - 0.1 * spread, rules.upper + 0.1 * spread, (count, 2))
    radius = generator.choice([0.0, 0.01, 0.15], (count, 2)) * spread
    under_way = generator.uniform(rules.lower, rules.upper, (count, rules.commands_before, 2))
    return JudgedStates(rules, placed, under_way), centre - radius, centre + radius


def driven(case, index, commands):
    """Brute-force poses (A, T, 3) of A commands in one state, over all that the criterion asks."""
    rules, count = case.rules, len(commands)
    start, waiting = np.tile(case.observing.poses[index], (count, 1)), []
    whole = int(rules.delay / rules.interval + 1e-9)
    pieces = [rules.delay - whole * rules.interval] + [rules.interval] * whole
    for seconds, command in zip([s for s in pieces if s > 1e-9], case.under_way[index], strict=True):
        held = np.tile(command, (count, 1))
        waiting.append(drive_all(start, *held.T, np.linspace(0.0, seconds, 12)[None]))
        start = waiting[-1][:, -1]
    if rules.criterion == "braking":
        rim = rim_of(rules.footprint)
        acting = drive_and_stop(start, *commands.T, rules.interval, rules.deceleration, rim, 20)
    else:
        acting = drive_all(start, *commands.T, np.linspace(0.0, rules.interval, 25)[None])
    return np.concatenate([*waiting, acting], axis=1)


def worst_found(world, case, lower, upper, commands=7, scenario=None):
    """The least clearance over a grid of clipped commands, (B,), and the number of measured poses."""
    grid = [(v, w) for v in np.linspace(0, 1, commands) for w in np.linspace(0, 1, commands)]
    rules, worst, checks = case.rules, [], 0
    for index in range(len(case)):
        low, high = lower[index], upper[index]
        actions = np.clip(low + np.array(grid) * (high - low), rules.lower, rules.upper)
        poses = driven(case, index, np.unique(actions, axis=0)).reshape(-1, 3)
        worst.append(clearance(world, poses, rules.footprint, scenario).min())
        checks += len(poses)
    return np.array(worst), checks
