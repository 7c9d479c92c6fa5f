from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from tests.safety.brute_force import drive_all
from tests.world.random_worlds import ARENAS
from viatool.loop import retreat
from viatool.loop.retreat import keep_away
from viatool.motion.law import Directions
from viatool.motion.manoeuvre import Manoeuvre
from viatool.sets.forms import PoseBoxes
from viatool.setting.rules import Rules
from viatool.sight.shapes import Shapes
from viatool.world import Obstacles, Scenes, WorldMap, box_polygon

DISTANCE = 0.4
THINGS = Obstacles(
    np.array([[-2.0, 1.0, 0.15], [2.0, 2.0, 0.8], [-2.6, -1.0, 0.3]]),
    (box_polygon((1.0, -1.5), (1.2, 0.6), 0.4),),
)
WORLD = WorldMap("things", Path("things.yaml"), "", ARENAS["box"], THINGS)
SCENES = Scenes.of(WORLD, [None])
STEPS = np.linspace(0.0, 1.0, 9)


def clearance(places):
    """Exact distance from everything."""
    flat = places.reshape(-1, 2)
    return SCENES.clearance(flat, np.zeros(len(flat), np.int64)).reshape(places.shape[:-1])


def setting(seed, count=3000, faster=1.0):
    """Boxes at the rim of the free space that head along it, more or less, and boxes of commands."""
    generator = np.random.default_rng(seed)
    centre = generator.uniform((-5.0, -4.0, -math.pi), (5.0, 4.0, math.pi), (60 * count, 3))
    left = clearance(centre[:, :2])
    centre = centre[(left > 0.36) & (left < 0.46)][:count]
    steps = np.array([[1e-6, 0.0], [0.0, 1e-6]])
    slope = np.stack([clearance(centre[:, :2] + step) - clearance(centre[:, :2] - step) for step in steps], 1)
    away = np.arctan2(slope[:, 1], slope[:, 0])
    side = generator.choice([-1.0, 1.0], len(centre))
    centre[:, 2] = away + side * generator.uniform(0.5, 1.8, len(centre))
    radius = generator.uniform(0.0, 0.08, (len(centre), 3)) * generator.choice(
        [0.01, 1.0, 4.0], (len(centre), 1)
    )
    lower = generator.uniform((0.0, -1.0), (0.3, 0.8), (len(centre), 2))
    upper = np.minimum(lower + generator.uniform(0, 0.2, (len(centre), 2)), (0.5, 1.0))
    lower, upper = lower * [1.0, faster], upper * [1.0, faster]
    return PoseBoxes(centre, radius * [1.0, 1.0, 2.0]), lower, upper, generator


def least(seed=0, faster=1.0):
    """The least clearance, less the collision distance, on paths from free poses that are said to keep away."""
    boxes, lower, upper, generator = setting(seed, faster=faster)
    rules = Rules.of(WORLD, "braking")
    holds = np.flatnonzero(keep_away(boxes, Shapes.of(WORLD, None), rules, rules.manoeuvre, lower, upper))
    z = generator.choice([-1.0, 1.0], (len(holds), 12, 3)) * generator.choice([1.0, 0.5], (len(holds), 12, 1))
    poses = boxes.centre[holds][:, None] + z * boxes.radius[holds][:, None]
    share = generator.choice([0.0, 1.0], (len(holds), 12, 2))
    commands = lower[holds][:, None] + share * (upper - lower)[holds][:, None]
    poses, commands = poses.reshape(-1, 3), commands.reshape(-1, 2)
    free = clearance(poses[:, :2]) > DISTANCE
    v, w = commands[free].T
    ways = drive_all(poses[free], v, w, (0.1 + 0.5 * v)[:, None] * STEPS, np.float64)
    return float(clearance(ways[..., :2]).min()) - DISTANCE, len(holds)


def test_free_poses_that_keep_away_stay_clear():
    worst, kept = least()
    assert kept > 300
    assert worst > -1e-9


@pytest.mark.parametrize("faster", [8.0, 16.0])
def test_commands_that_turn_by_more_than_a_circle_are_not_taken_for_a_retreat(faster):
    """The longest paths turn by 4.8 and 9.6 rad; what is left out, a chord that points backwards, is met."""
    worst, kept = least(faster=faster)
    assert kept > 20
    assert worst > -1e-9


def test_ends_that_are_crossed_or_nan_keep_nothing_away():
    boxes, lower, upper, _ = setting(0, 100)
    rules, shapes = Rules.of(WORLD, "braking"), Shapes.of(WORLD, None)
    assert keep_away(boxes, shapes, rules, rules.manoeuvre, lower, upper).any()
    crossed, lost = np.maximum(lower, upper + 1e-3), np.full_like(lower, np.nan)
    still = np.zeros_like(lower)
    for low, high in ((crossed, upper), (lost, upper), (lower, lost), (still, still - [0.0, 0.1])):
        assert not keep_away(boxes, shapes, rules, rules.manoeuvre, low, high).any()


@pytest.mark.parametrize(
    "rule", ["cone", "headings", "commands that turn", "shapes behind", "the way", "places", "radii"]
)
def test_driving_catches_the_argument_without_one_of_its_rules(monkeypatch, rule):
    right = retreat.vectors_from_shapes
    mutants = {
        "cone": (retreat, "cone", lambda reach, distance: 0.0 * distance),
        "headings": (PoseBoxes, "turn", property(lambda boxes: 0.0 * boxes.radius[:, 2])),
        "commands that turn": (
            Manoeuvre,
            "directions",
            lambda manoeuvre, low, high: Directions(0.0 * low[:, 0], 0.0 * low[:, 0], low[:, 0] > 9.0),
        ),
        "the way": (Manoeuvre, "longest", lambda manoeuvre, low, high: 0.0 * low[:, 0]),
        "places": (PoseBoxes, "extent", property(lambda boxes: 0.0 * boxes.radius[:, 2])),
        "radii": (retreat, "vectors_from_shapes", lambda *a: (right(*a)[0], 0.0 * right(*a)[1])),
        "shapes behind": (retreat, "vectors_from_shapes", lambda *a: (right(*a)[0][:, 1:], right(*a)[1][1:])),
    }
    monkeypatch.setattr(*mutants[rule])
    assert least()[0] < -1e-5


def test_a_wall_behind_settles_a_cell_that_straddles_the_rim():
    world = WorldMap("box", Path("box.yaml"), "", ARENAS["box"], Obstacles())
    rules, shapes = Rules.of(world, "braking"), Shapes.of(world, None)
    behind, ahead = [4.6, 0.0, math.pi], [4.6, 0.0, 0.0]  # the wall is at x = 5
    boxes = PoseBoxes(np.array([behind, ahead]), np.full((2, 3), 0.02))
    full = np.tile(rules.lower, (2, 1)), np.tile(rules.upper, (2, 1))
    assert keep_away(boxes, shapes, rules, rules.manoeuvre, *full).tolist() == [True, False]
