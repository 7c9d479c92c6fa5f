from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import shapely

from tests.safety.brute_force import drive_all
from tests.world.random_worlds import ARENAS
from viatool.loop import outline_retreat
from viatool.loop.outline_retreat import Placements
from viatool.loop.retreat import keep_away
from viatool.sets.forms import PoseBoxes
from viatool.setting.rules import Rules
from viatool.sight.shapes import Shapes
from viatool.world import Obstacles, WorldMap, box_polygon

DISTANCE = 0.03
THINGS = Obstacles(
    np.array([[-2.0, 1.0, 0.15], [2.0, 2.0, 0.8], [-2.6, -1.0, 0.02]]),
    (box_polygon((1.0, -1.5), (1.2, 0.6), 0.4), np.array([[-1.0, -2.0], [-0.4, -2.1], [-0.9, -1.0]])),
)
WORLD = WorldMap("things", Path("things.yaml"), "", ARENAS["box"], THINGS)
SOLID = shapely.union_all(
    [
        shapely.box(-9, -9, 9, 9).difference(shapely.Polygon(WORLD.arena)),
        *map(shapely.Polygon, THINGS.polygons),
    ]
)
shapely.prepare(SOLID)
OUTLINES = {
    "box": [[-0.2, -0.15], [0.2, -0.15], [0.2, 0.15], [-0.2, 0.15]],
    "angle": [[-0.1, -0.2], [0.4, -0.2], [0.4, -0.1], [0.0, -0.1], [0.0, 0.3], [-0.1, 0.3]],
}
STEPS = np.linspace(0.0, 1.0, 13)


def rules_of(name):
    return Rules.of(WORLD.with_clearance(DISTANCE, None), "braking", footprint=OUTLINES[name])


def clearance(poses, outline):
    """Exact distance of the outline at poses (..., 3) from everything, by shapely."""
    flat = poses.reshape(-1, 3)
    turned = np.exp(1j * flat[:, 2, None]) * (np.array(outline) @ [1.0, 1j])
    places = shapely.polygons(np.stack([flat[:, :1] + turned.real, flat[:, 1:2] + turned.imag], axis=-1))
    least = shapely.distance(places, SOLID)
    for x, y, radius in THINGS.circles:
        least = np.minimum(least, shapely.distance(places, shapely.Point(x, y)) - radius)
    return least.reshape(poses.shape[:-1])


def at_the_rim(generator, name, count):
    """Poses from which about the collision distance is left, and commands that turn much or little, also backwards."""
    centre = generator.uniform((-5.0, -4.0, -math.pi), (5.0, 4.0, math.pi), (12 * count, 3))
    left = clearance(centre, OUTLINES[name])
    centre = centre[(left > DISTANCE - 0.03) & (left < DISTANCE + 0.05)][:count]
    lower = generator.uniform((-0.4, -1.0), (0.4, 0.9), (len(centre), 2))
    widths = generator.choice([0.03, 1.0], (len(centre), 1))
    return centre, lower, lower + generator.uniform(0, 0.3, (len(centre), 2)) * widths


def past_a_corner(generator, name, count, *, pivot):
    """Poses that bring a corner of the outline near one of an obstacle, which it passes, or about which it turns."""
    corners = np.array(OUTLINES[name]) @ [1.0, 1j]
    corner = corners[generator.integers(len(corners), size=count)]
    points = np.concatenate(THINGS.polygons) @ [1.0, 1j]
    way = (DISTANCE + generator.uniform(-0.02, 0.01, count)) * np.exp(1j * generator.uniform(-4, 4, count))
    turning = generator.choice([-1.0, 1.0], count) * (generator.uniform(0.3, 1.0, count) if pivot else 1e-3)
    speed = turning * corner.imag + generator.uniform(-0.02, 0.02, count) if pivot else np.full(count, 0.4)
    moved = speed + 1j * turning * corner
    across = generator.choice([-0.5, 0.5], count) * math.pi + generator.uniform(-0.4, 0.4, count)
    heading = np.angle(way) + across - np.angle(moved)
    place = points[generator.integers(len(points), size=count)] + way - np.exp(1j * heading) * corner
    command = np.stack([speed, turning], axis=1)
    return np.stack([place.real, place.imag, heading], axis=1), command, command + 1e-3


def setting(seed, name, count=700):
    """Boxes of poses and of commands."""
    generator = np.random.default_rng(seed)
    parts = [
        at_the_rim(generator, name, count),
        past_a_corner(generator, name, count, pivot=False),
        past_a_corner(generator, name, count, pivot=True),
    ]
    centre, lower, upper = (np.concatenate(part) for part in zip(*parts, strict=True))
    radius = generator.uniform(0.0, 0.04, (len(centre), 3)) * generator.choice(
        [0.01, 0.3, 1.0], (len(centre), 1)
    )
    return PoseBoxes(centre, radius * [1.0, 1.0, 2.0]), lower, upper, generator


def least(name, seeds=(0,), faster=1.0):
    """The least clearance, less the collision distance, on paths from free poses that are said to keep away."""
    worst, kept, straddling = math.inf, 0, 0
    rules = rules_of(name)
    for seed in seeds:
        boxes, lower, upper, generator = setting(seed, name)
        lower, upper = lower * [1.0, faster], upper * [1.0, faster]
        holds = np.flatnonzero(keep_away(boxes, Shapes.of(WORLD, None), rules, rules.manoeuvre, lower, upper))
        z = generator.choice([-1.0, 1.0], (len(holds), 12, 3)) * generator.choice(
            [1.0, 0.5], (len(holds), 12, 1)
        )
        poses = boxes.centre[holds][:, None] + z * boxes.radius[holds][:, None]
        share = generator.choice([0.0, 1.0], (len(holds), 12, 2))
        commands = lower[holds][:, None] + share * (upper - lower)[holds][:, None]
        free = clearance(poses, OUTLINES[name]) > DISTANCE
        straddling += int((free.any(axis=1) & ~free.all(axis=1)).sum())
        poses, commands = poses[free], commands[free]
        v, w = commands.T
        seconds = rules.manoeuvre.seconds(np.abs(v), np.abs(w))
        ways = drive_all(poses, v, w, seconds[:, None] * STEPS, np.float64)
        worst = min(worst, float(clearance(ways, OUTLINES[name]).min()) - DISTANCE)
        kept += len(holds)
    return worst, kept, straddling


@pytest.mark.parametrize("name", OUTLINES)
def test_outlines_that_turn_by_more_than_a_circle_keep_away_where_it_is_said(name):
    """Commands of up to 40 rad/s: most paths turn by several circles."""
    worst, kept, _ = least(name, faster=40.0)
    assert kept > 0
    assert worst > -1e-9


@pytest.mark.parametrize("name", OUTLINES)
def test_free_poses_of_an_outline_that_keep_away_stay_clear(name):
    worst, kept, straddling = least(name)
    assert kept > 150
    assert straddling > 20  # of them are free in part
    assert worst > -1e-9


def without(field):
    """Placements as if one of their bounds were 0."""

    def mutate(right):
        def along(*given):
            found = right(*given)
            getattr(found, field)[:] = 0.0
            return found

        return along

    return mutate


def kept_by(pieces, *_):
    return np.ones(len(pieces.place), dtype=bool)


MUTANTS = {
    "cone": (outline_retreat, "cone", lambda right: lambda reach, apart, d: 0.0 * reach),
    "between the ends": (
        outline_retreat, "between_ends", lambda right: lambda along, length, reach: np.ones(along.shape, bool)
    ),
    "places": (Placements, "along", without("shift")),
    "headings": (Placements, "along", without("turn")),
    "corners": (outline_retreat, "_corners_keep", lambda right: kept_by),
    "sides": (outline_retreat, "_points_keep", lambda right: kept_by),
    "commands that turn": (Placements, "along", without("angular")),
}  # fmt: skip


@pytest.mark.parametrize("rule", MUTANTS)
def test_driving_catches_the_argument_without_one_of_its_rules(monkeypatch, rule):
    owner, name, mutate = MUTANTS[rule]
    monkeypatch.setattr(owner, name, mutate(getattr(owner, name)))
    cases = ((outline, (seed,)) for seed in (0, 1) for outline in OUTLINES)
    assert any(least(*case)[0] < -1e-5 for case in cases)  # the first that shows it is enough


def test_ways_and_motions_turn_by_no_more_than_their_bounds():
    """Ways that end within reach and are long enough, and motions that change: their angles, sampled densely."""
    generator = np.random.default_rng(5)
    apart, reach, distance = generator.uniform(0.01, 1.0, (3, 400, 1))
    around = np.exp(1j * np.linspace(-math.pi, math.pi, 721)) * np.linspace(0.05, 1.0, 20)[:, None]
    ends = apart + reach * around.ravel()
    turned = np.where(np.abs(ends) >= distance, np.abs(np.angle(ends)), 0.0).max(axis=1)
    bound = outline_retreat.cone(reach, apart, distance)[:, 0]
    assert (turned <= bound + 1e-12).all()
    assert (turned[bound < 3.0] > 0.8 * bound[bound < 3.0] - 0.1).all()
    swung = np.abs(np.angle(ends)).max(axis=1)
    assert (swung <= outline_retreat.swing(reach, apart)[:, 0] + 1e-12).all()
    assert swung.max() > 0.5


def test_a_box_that_backs_off_a_wall_or_turns_beside_it():
    """The wall is at x = 5: driving away settles a box that straddles the rim, turning a corner towards it does not."""
    world = WorldMap("box", Path("box.yaml"), "", ARENAS["box"], Obstacles()).with_clearance(DISTANCE, None)
    rules = Rules.of(world, "braking", footprint=OUTLINES["box"])
    poses = np.array(
        [[4.77, 0.0, math.pi], [4.77, 0.0, 0.0], [4.82, 0.0, 0.5 * math.pi], [4.77, 0.0, math.pi]]
    )
    boxes = PoseBoxes(poses, np.full((4, 3), 0.01))
    lower = np.array([[0.3, -0.02], [-0.3, -0.02], [0.0, -1.0], [-0.1, 0.0]])
    upper = np.array([[0.5, 0.02], [-0.1, 0.02], [0.0, -0.5], [0.1, 0.0]])
    kept = keep_away(boxes, Shapes.of(world, None), rules, rules.manoeuvre, lower, upper)
    assert kept.tolist() == [True, True, False, False]
