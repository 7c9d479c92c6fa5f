from __future__ import annotations

import numpy as np
import pytest

from tests.safety.brute_force import FOOTPRINTS, clearance, drive, drive_and_stop, random_world, rim_of
from viatool.safety.judgement import Case, prove, sample, settle
from viatool.safety.rules import Rules
from viatool.safety.situations import Situations


def cases(seed, footprint, criterion, count=60, reach=0.12, **rules):
    """States just around the distance that counts, and action boxes as wide as real ones."""
    generator = np.random.default_rng(seed)
    world = random_world(seed, footprint)
    poses = np.column_stack([generator.uniform(-2.8, 2.8, (4000, 2)), generator.uniform(-4, 4, 4000)])
    near = clearance(world, poses, footprint)
    near = np.flatnonzero((near > 0.0) & (near < world.clearance.collision + reach))[:count]
    poses = poses[near]
    situations = Situations.of(world, [None], poses, np.zeros(len(poses), dtype=np.int64))
    previous = generator.uniform([0.0, -2.0], [1.0, 2.0], (len(poses), 2))
    centre = generator.uniform([-0.4, -2.2], [1.1, 2.2], (len(poses), 2))
    radius = generator.choice([0.0, 0.02, 0.3], (len(poses), 2))
    rules = Rules.of(world, criterion, **rules)
    return world, Case(rules, situations, previous), centre - radius, centre + radius


def driven(case, index, v, w):
    """Brute-force poses of one command in one state, over all that the criterion asks."""
    rules, pose = case.rules, case.situations.poses[index]
    poses = []
    if rules.delay:
        poses = [drive(pose, *case.previous[index], np.linspace(0.0, rules.delay, 12))]
        pose = poses[0][-1]
    if rules.criterion == "braking":
        poses.append(
            drive_and_stop(pose, v, w, rules.interval, rules.deceleration, rim_of(rules.footprint), 20)
        )
    else:
        poses.append(drive(pose, v, w, np.linspace(0.0, rules.interval, 25)))
    return np.concatenate(poses)


def worst_found(world, case, lower, upper, commands=7):
    """The least clearance over a grid of clipped commands, (B,), and the number of measured poses."""
    grid = [(v, w) for v in np.linspace(0, 1, commands) for w in np.linspace(0, 1, commands)]
    rules, worst, checks = case.rules, [], 0
    for index in range(len(case)):
        low, high = lower[index], upper[index]
        actions = np.clip(low + np.array(grid) * (high - low), rules.lower, rules.upper)
        poses = np.concatenate([driven(case, index, *action) for action in actions])
        worst.append(clearance(world, poses, rules.footprint).min())
        checks += len(poses)
    return np.array(worst), checks


@pytest.mark.parametrize("delay", [0.0, 0.15])
@pytest.mark.parametrize("criterion", ["swept", "braking"])
@pytest.mark.parametrize("name", FOOTPRINTS)
def test_no_brute_force_violation_in_a_state_that_is_proved(name, criterion, delay):
    world, case, lower, upper = cases(7, FOOTPRINTS[name], criterion, delay=delay)
    limit = world.clearance.collision
    proof = prove(case, lower, upper, limit)
    worst, _ = worst_found(world, case, lower, upper)
    assert not (proof.proved & proof.refuted).any()
    assert (worst[proof.proved] > limit).all()
    assert proof.proved.sum() >= 5
    assert proof.refuted.sum() >= 5
    assert (worst[proof.refuted] < limit + 0.02).all()  # the grid comes near whatever fails
    assert (~proof.proved & ~proof.refuted).sum() <= 1


@pytest.mark.parametrize("name", ["point", "square"])
def test_no_admissible_command_endangers_a_settled_state(name):
    world, case, lower, upper = cases(3, FOOTPRINTS[name], "swept", reach=0.4)
    limit = world.clearance.collision
    settled = settle(case, limit)
    lower, upper = (np.broadcast_to(end, (len(case), 2)) for end in (case.rules.lower, case.rules.upper))
    worst, _ = worst_found(world, case, lower, upper)
    assert (worst[settled] > limit).all()
    assert (worst[~settled] < limit + 0.05).all()
    assert 1 <= settled.sum() < len(case)


def test_what_is_proved_also_passes_the_nine_actions():
    for name, footprint in FOOTPRINTS.items():
        _, case, lower, upper = cases(5, footprint, "swept")
        proved, sampled = (judge(case, lower, upper, 0.1) for judge in (prove, sample))
        assert not (proved.proved & ~sampled).any(), name


def test_a_larger_clearance_is_never_easier():
    _, case, lower, upper = cases(11, FOOTPRINTS["point"], "swept")
    assert not (~prove(case, lower, upper, 0.05).proved & prove(case, lower, upper, 0.1).proved).any()


def test_an_obstacle_within_the_footprint_fails_though_the_outline_is_clear():
    world, _, _, _ = cases(0, FOOTPRINTS["point"], "swept")
    x, y, _ = world.obstacles.circles[0]
    situations = Situations.of(world, [None], np.array([[x, y, 0.0]]), np.zeros(1, dtype=np.int64))
    rules = Rules.of(
        world.with_clearance(0.0, 0.0), footprint=[[-2.9, -2.9], [2.9, -2.9], [2.9, 2.9], [-2.9, 2.9]]
    )
    assert not prove(Case(rules, situations), np.zeros((1, 2)), np.zeros((1, 2)), 0.0).proved[0]
