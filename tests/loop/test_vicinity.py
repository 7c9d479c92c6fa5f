"""Cells among obstacles that move or roam: against things that go straight at the robot, and readings of moved maps."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import shapely

import viatool
from tests.safety.brute_force import FOOTPRINTS, drive_and_stop, place, rim_of
from viatool.channels import Quantities
from viatool.errors import ConfigurationError
from viatool.loop.closed_loop import ClosedLoop
from viatool.loop.vicinity import check_roaming
from viatool.places import SearchBudget, certify
from viatool.places.job import Resolution
from viatool.places.lasting import Lookahead
from viatool.policy import PolicySpecification
from viatool.report.places.run import PlacesRun
from viatool.sets.forms import PoseBoxes
from viatool.sets.states import StateBoxes
from viatool.setting.setting import Setting
from viatool.setting.wishes import Wishes
from viatool.uncertainty import ErrorModel
from viatool.world import Obstacles

LAB = viatool.load_map("lab")
TABLE = np.array([[-1.0, 1.0], [0.4, 1.1], [0.2, 1.9], [-0.3, 1.5], [-1.1, 2.0]])  # not convex
HALL = replace(LAB, obstacles=LAB.obstacles + Obstacles(polygons=(TABLE,), names=("table",)))
SCENARIO = replace(LAB.scenarios[0], obstacles=Obstacles())
POLICY = viatool.load_policy("via")
SPEEDS, ROAMS = {"fixed-1": 0.6, "fixed-2": 0.3}, {"fixed-3": 0.35, "table": 0.25}
PLACES = np.array([[-2.93, 3.17], [2.86, -3.0], [-2.77, -0.96], [-0.4, 1.5]])
MOVES = {"named": SPEEDS, "roams": ROAMS}
COUNT = 240


@cache
def asked(footprint="point", **terms):
    wishes = Wishes(
        "braking",
        footprint=FOOTPRINTS[footprint],
        errors=ErrorModel.model_validate({"obstacles": terms}),
        clearance=0.3,
    )
    return ClosedLoop.of(POLICY, Setting.of(POLICY, HALL, 0.005, wishes, [SCENARIO], job="certify"), SCENARIO)


def moving_loop(footprint="point"):
    return asked(footprint, **{name: _Frozen(each) for name, each in MOVES.items()})


class _Frozen(dict):
    def __hash__(self):
        return hash(tuple(self.items()))


def cells_around(seed=0, side=0.02, nearest=0.1, farthest=1.6):
    """Cells around what moves."""
    generator = np.random.default_rng(seed)
    which = generator.integers(0, len(PLACES), COUNT)
    way = generator.uniform(nearest, farthest, COUNT) * np.exp(1j * generator.uniform(-4.0, 4.0, COUNT))
    poses = np.column_stack(
        [PLACES[which] + np.column_stack([way.real, way.imag]), generator.uniform(-3, 3, COUNT)]
    )
    lower = generator.uniform((0.0, -1.0), (0.4, 0.6), (COUNT, 2))
    return StateBoxes(PoseBoxes(poses, generator.uniform(0.2, 1.0, (COUNT, 3)) * side), lower, lower + 0.05)


def unit(generator, *shape):
    drawn = generator.uniform(-1.0, 1.0, shape)
    return np.where(generator.random(shape) < 0.6, np.sign(drawn), drawn)


def displaced(generator):
    """The map with everything that roams somewhere else."""

    def moved(name):
        way = (
            ROAMS.get(name, 0.0)
            * generator.choice([1.0, generator.random()])
            * np.exp(1j * generator.uniform(-4, 4))
        )
        return np.array([way.real, way.imag])

    known = HALL.obstacles
    circles = known.circles.copy()
    for row, name in enumerate(known.names[: len(circles)]):
        circles[row, :2] += moved(name)
    return replace(HALL, obstacles=Obstacles(circles, (TABLE + moved("table"),), names=known.names))


def escapes(loop, cells, tries=30):
    """By how much readings of displaced maps leave what is enclosed, and commands what is bounded, at most."""
    generator, worst = np.random.default_rng(1), np.array([-np.inf, -np.inf])
    sightings = loop.sensors.enclose(cells).forms
    commands = loop.commands(cells)
    for _ in range(tries):
        poses = cells.poses.centre + unit(generator, len(cells), 3) * cells.poses.radius
        previous = cells.previous_lower + 0.05 * generator.random((len(cells), 2))
        world = displaced(generator)
        other = ClosedLoop.of(
            POLICY, Setting.of(POLICY, world, 0.005, None, [SCENARIO], job="certify"), SCENARIO
        )
        seen = other.sensors.read(poses, previous)
        out = other.geometry.still.clearance(poses[:, :2], np.zeros(len(poses), int)) <= 0.0
        beyond = np.maximum(seen - sightings.upper[: len(seen)], sightings.lower[: len(seen)] - seen)[:, :20]
        actions = loop.rules.clip(POLICY.run(seen.astype(np.float32).astype(float)))
        left = np.maximum(actions - commands.upper, commands.lower - actions)
        worst = np.maximum(worst, [beyond[~out].max(), left[~out].max()])
    return worst


def test_readings_of_what_roams_are_enclosed():
    worst = escapes(moving_loop(), cells_around())
    assert (worst <= 1e-9).all()


@pytest.mark.parametrize("left_out", ["near", "far"])
def test_both_ends_of_what_roams_are_needed(left_out):
    loop = moving_loop()
    shapes = loop.sensors.shapes
    shapes = shapes.without if left_out == "near" else replace(shapes, without=None)
    sensors = replace(loop.sensors, shapes=shapes)
    assert (escapes(replace(loop, sensors=sensors), cells_around(), 10) > 0.01).all()


def violations(loop, cells, proved, bounds, seed=3, tries=24):
    """Runs in cells that are called safe in which something comes too near that moves straight at the robot."""
    generator, rules = np.random.default_rng(seed), loop.rules
    shapes = [
        *(shapely.Point(x, y).buffer(r, quad_segs=64) for x, y, r in HALL.obstacles.circles),
        shapely.Polygon(TABLE),
    ]
    speeds = np.array([SPEEDS.get(name, 0.0) for name in HALL.obstacles.names])
    roams = np.array([ROAMS.get(name, 0.0) for name in HALL.obstacles.names])
    rim, found = rim_of(rules.footprint), 0
    for row in np.flatnonzero(proved)[::2]:
        poses = cells.poses.centre[row] + unit(generator, tries, 3) * cells.poses.radius[row]
        share = 0.5 + 0.5 * unit(generator, tries, 2)
        commands = np.clip(
            bounds[0][row] + share * (bounds[1][row] - bounds[0][row]), rules.lower, rules.upper
        )
        path = drive_and_stop(poses, *commands.T, rules.interval, rules.deceleration, rim, 12)
        stop = (np.abs(commands[:, 0]) + rim * np.abs(commands[:, 1])) / rules.deceleration
        held = np.tile(np.linspace(0.0, rules.interval, 12), (tries, 1))
        time = np.hstack([held, rules.interval + stop[:, None] * np.arange(13) / 12])
        time = np.where((commands[:, 0] == 0.0) & (rim * commands[:, 1] == 0.0), 0.0, time.T).T
        at = place(path.reshape(-1, 3), rules.footprint)
        radius = rules.footprint.radius if rules.footprint.kind == "circle" else 0.0
        left = np.stack([shapely.distance(at, shape).reshape(time.shape) for shape in shapes])
        left = left - radius - speeds[:, None, None] * time - roams[:, None, None]
        moves = (speeds > 0.0) | (roams > 0.0)
        found += int((left[moves] <= rules.clearance.collision - 1e-9).any(axis=(0, 2)).sum())
    return found


@pytest.mark.parametrize("footprint", ["point", pytest.param("square", marks=pytest.mark.slow)])
def test_nothing_comes_too_near_in_a_cell_that_is_proved(footprint):
    loop, cells = moving_loop(footprint), cells_around(nearest=0.5)
    bounds = loop.commands(cells)
    held = loop.all_hold(cells, bounds.pieces)
    settled = loop.settled(cells.poses)
    any_ = (np.broadcast_to(end, (COUNT, 2)) for end in (loop.rules.lower, loop.rules.upper))
    assert 20 < held.sum() < COUNT - 20
    assert settled.sum() < held.sum()
    assert violations(loop, cells, held, (bounds.lower, bounds.upper)) == 0
    assert violations(loop, cells, settled, tuple(any_)) == 0
    blind = replace(loop, around=replace(loop.around, moving=None))
    assert violations(loop, cells, blind.all_hold(cells, bounds.pieces), (bounds.lower, bounds.upper)) > 0


def test_places_inside_of_what_roams_are_not_proved():
    loop = moving_loop()
    inside = StateBoxes(PoseBoxes(np.array([[-0.4, 1.45, 0.0]]), np.full((1, 3), 1e-3)), *np.zeros((2, 1, 2)))
    assert not loop.holds(inside, np.zeros((1, 2)), np.zeros((1, 2))).any()
    assert not loop.blocked(inside.poses).any()
    assert asked().blocked(inside.poses).all()


def test_terms_of_nothing_change_nothing_and_more_proves_no_more():
    cells, plain = cells_around(nearest=0.5), asked()
    commands = plain.commands(cells)
    none = asked(named=_Frozen({"fixed-1": 0.0}), roams=_Frozen({"table": 0.0}), speed=0.0)
    nothing = none.commands(cells)
    np.testing.assert_array_equal(commands.lower, nothing.lower)
    np.testing.assert_array_equal(commands.upper, nothing.upper)
    before = plain.all_hold(cells, commands.pieces), plain.settled(cells.poses)
    np.testing.assert_array_equal(before[0], none.all_hold(cells, nothing.pieces))
    np.testing.assert_array_equal(before[1], none.settled(cells.poses))
    for share in (0.2, 0.6, 1.0):
        roams = _Frozen({name: share * radius for name, radius in ROAMS.items()})
        loop = asked(speed=share, roams=roams)
        found = loop.commands(cells)
        assert (found.upper - found.lower).mean() > (commands.upper - commands.lower).mean() - 1e-6
        now = loop.all_hold(cells, found.pieces), loop.settled(cells.poses)
        assert not any((one & ~other).any() for one, other in zip(now, before, strict=True))
        commands, before = found, now
    assert before[0].any()


def test_certify_takes_what_moves_and_says_so():
    errors = ErrorModel.model_validate({"obstacles": {"speed": 0.5}})
    coarse = {"budget": SearchBudget(share=0.0003), "resolution": Resolution(0.06)}
    found, plain = (certify(POLICY, LAB, eps=0.01, errors=model, **coarse) for model in (errors, None))
    assert {premise.name: premise.value for premise in found.premises}["obstacles.speed"] == "0.5 m/s"
    shares = [one.to_json()["free_rate"] for one in (found, plain)]
    assert shares[0]["rate"] < shares[1]["rate"]
    run = PlacesRun(found)
    assert (
        run.assumptions["map"]
        == "correct; obstacles.speed 0.5 m/s may move as that says, unless it roams from where the map shows it when "
        "the policy observes, and nothing else does"
    )
    witnesses = json.loads(json.dumps(run.witness_file()))["witnesses"]
    moved = [one for one in witnesses if "moved" in one["closest"]]
    assert len(moved) > 0.3 * len(witnesses)
    for one in moved[:50]:  # a thing that goes straight at the robot is there when it comes nearest
        closest, thing = one["closest"], one["closest"]["moved"]
        end = np.array(thing["from"]) + np.array(thing["velocity"]) * closest["seconds"]
        away = np.hypot(*(end - closest["pose"][:2]))
        assert away == pytest.approx(closest["clearance"], abs=1e-6)
        assert np.hypot(*thing["velocity"]) == pytest.approx(0.5)


def test_what_certify_does_not_take_is_refused_by_name():
    errors = ErrorModel.model_validate({"obstacles": {"speed": 0.5}})
    with pytest.raises(ConfigurationError, match="for how long cells stay certified"):
        certify(POLICY, LAB, eps=0.01, errors=errors, lookahead=Lookahead(steps=2))
    for term in ("returns", "hidden", "people"):
        with pytest.raises(ConfigurationError, match=f"obstacles.{term}: certify does not take this"):
            certify(POLICY, LAB, errors=ErrorModel.model_validate({"obstacles": {term: 1.0}}))
    nothing = POLICY.spec.model_dump(mode="json")
    nothing["observation"][0]["lidar"]["no_return"] = 0.0
    spec = PolicySpecification.model_validate(nothing)
    roams = ErrorModel.model_validate({"obstacles": {"roams": {"fixed-1": 0.1}}})
    with pytest.raises(
        ConfigurationError, match=r"obstacles\.roams: 'lidar' reads 0 m where nothing returns"
    ):
        check_roaming([lidar for lidar, _ in Quantities.of(spec.observation, LAB.robot).lidars], roams)
