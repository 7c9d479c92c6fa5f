"""Rules: what the map and its robot say, what the user says instead, and what neither may say."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from viatool import load_map
from viatool.errors import ConfigurationError, MapError
from viatool.motion.manoeuvre import Manoeuvre
from viatool.setting.criteria import CRITERIA
from viatool.setting.rules import Rules, as_footprint
from viatool.world import Clearance, Footprint, Robot, WorldMap

TRIANGLE = [[-0.1, -0.1], [0.3, 0.0], [-0.1, 0.1]]
ROBOT = Robot(
    min_linear=-0.2, max_linear=0.7, max_angular=1.5, control_interval=0.25, deceleration=0.9,
    footprint=Footprint("circle", radius=0.17),
)  # fmt: skip


def world(**robot):
    arena = np.array([[-3.0, -3.0], [3.0, -3.0], [3.0, 3.0], [-3.0, 3.0]])
    clearance = Clearance(0.11, 0.23)
    return WorldMap("hall", Path("hall.yaml"), "", arena, robot=replace(ROBOT, **robot), clearance=clearance)


def test_the_map_and_its_robot_say_what_nobody_overrides():
    rules = Rules.of(world())
    assert rules.criterion == "swept"
    assert rules.clearance == Clearance(0.11, 0.23)
    assert rules.footprint is ROBOT.footprint
    np.testing.assert_array_equal(rules.lower, [-0.2, -1.5])
    np.testing.assert_array_equal(rules.upper, [0.7, 1.5])
    assert rules.interval == 0.25
    assert rules.deceleration == 0.9
    assert rules.delay == 0.0


def test_the_user_overrides_interval_footprint_and_delay():
    rules = Rules.of(world(), "braking", interval=0.4, footprint=0.3, delay=0.05)
    assert rules.criterion == "braking"
    assert rules.interval == 0.4
    assert (rules.footprint.kind, rules.footprint.radius) == ("circle", 0.3)
    assert rules.delay == 0.05
    np.testing.assert_array_equal(rules.upper, [0.7, 1.5])  # what else the robot says stays


def test_the_distances_are_those_that_the_map_is_given():
    assert Rules.of(world().with_clearance(0.4, 0.5)).clearance == Clearance(0.4, 0.5)


@pytest.mark.parametrize("criterion", CRITERIA)
def test_every_criterion_is_known(criterion):
    assert Rules.of(world(), criterion).criterion == criterion


@pytest.mark.parametrize("criterion", ["", "Swept", "sweep", "nine"])
def test_no_other_criterion_is_known(criterion):
    with pytest.raises(ConfigurationError, match=f"criterion '{criterion}'") as caught:
        Rules.of(world(), criterion)
    assert all(name in caught.value.hint for name in CRITERIA)


@pytest.mark.parametrize("interval", [0.0, -0.1, math.inf, math.nan])
def test_an_interval_is_a_positive_time(interval):
    with pytest.raises(ConfigurationError, match=f"interval is {interval} s"):
        Rules.of(world(), interval=interval)


@pytest.mark.parametrize("delay", [-1e-9, math.inf, math.nan])
def test_a_delay_is_a_time(delay):
    with pytest.raises(ConfigurationError, match=f"delay is {delay} s"):
        Rules.of(world(), delay=delay)


@pytest.mark.parametrize("deceleration", [0.0, -1.0, math.inf, math.nan])
def test_only_a_robot_that_can_brake_is_asked_to(deceleration):
    def rules(criterion):
        own = Rules.of(world(), criterion)
        some = world()
        object.__setattr__(some.robot, "deceleration", deceleration)  # which no map file may say
        return Rules.of(some, criterion) if own else None

    with pytest.raises(ConfigurationError, match="never stops"):
        rules("braking")
    assert rules("swept").manoeuvre == Manoeuvre(0.25)


def test_swept_and_sampled_ask_for_the_interval_and_braking_for_the_stop_as_well():
    for criterion in ("swept", "sampled"):
        assert Rules.of(world(), criterion).manoeuvre == Manoeuvre(0.25)
    assert Rules.of(world(), "braking").manoeuvre == Manoeuvre(0.25, 0.9, 0.0, passive=True)


@pytest.mark.parametrize(
    ("footprint", "rim"), [("point", 0.0), (0.3, 0.0), (TRIANGLE, 0.3), (Footprint.rectangle(0.6, 0.8), 0.5)]
)
def test_only_an_outline_that_turns_brakes_for_its_turning(footprint, rim):
    manoeuvre = Rules.of(world(), "braking", footprint=footprint).manoeuvre
    assert manoeuvre.rim == pytest.approx(rim, abs=1e-12)


def test_commands_are_clipped_to_what_the_robot_carries_out():
    clipped = Rules.of(world()).clip(np.array([[-1.0, -9.0], [0.3, 0.2], [2.0, 9.0], [-0.2, 1.5]]))
    np.testing.assert_array_equal(clipped, [[-0.2, -1.5], [0.3, 0.2], [0.7, 1.5], [-0.2, 1.5]])


def test_clipping_keeps_the_order_so_that_ends_bound_what_is_between():
    generator = np.random.default_rng(0)
    rules, (lower, upper) = Rules.of(world()), np.sort(generator.uniform(-3, 3, (2, 500, 2)), axis=0)
    between = lower + generator.random((500, 2)) * (upper - lower)
    assert (rules.clip(lower) <= rules.clip(between)).all()
    assert (rules.clip(between) <= rules.clip(upper)).all()


def test_a_footprint_is_a_point_a_disc_or_an_outline():
    assert as_footprint("point").kind == "point"
    assert as_footprint(1).radius == 1.0
    assert as_footprint(0.25).kind == "circle"
    outline = as_footprint(TRIANGLE)
    assert outline.kind == "polygon"
    assert {tuple(corner) for corner in outline.polygon.tolist()} == {tuple(c) for c in TRIANGLE}
    given = Footprint.rectangle(0.2, 0.3)
    assert as_footprint(given) is given


@pytest.mark.parametrize(
    ("footprint", "message"),
    [
        ("disc", "footprint 'disc'"),
        (0.0, "radius is 0.0 m"),
        (-0.1, "radius is -0.1 m"),
        (math.nan, "radius is nan m"),
        (math.inf, "radius is inf m"),
        ([0.1, 0.2, 0.3], "corners"),
        ([[0.0, 0.0, 0.0]] * 3, "corners"),
        ([[0.0, 0.0], [1.0, 0.0], [math.nan, 1.0]], "corners"),
        ([[0.0, 0.0], [1.0, 0.0], [0.0, math.inf]], "corners"),
    ],
)
def test_nothing_else_is_a_footprint(footprint, message):
    with pytest.raises(ConfigurationError, match=message):
        Rules.of(world(), footprint=footprint)


@pytest.mark.parametrize(
    "corners",
    [
        [[0.0, 0.0], [1.0, 0.0]],
        [[0.0, 0.0], [1.0, 1.0], [1.0, 0.0], [0.0, 1.0]],
        [[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]],
    ],
)
def test_an_outline_that_is_not_simple_is_refused(corners):
    with pytest.raises(MapError, match="footprint"):
        Rules.of(world(), footprint=corners)


def test_rules_of_robots_that_move_otherwise_are_told_apart():
    """Stored work is told from that of other rules by them: by the kinematics, and by what it knows of the robot."""
    world = load_map("maps/lab.yaml")
    robot = replace(world.robot, max_acceleration=1.0, max_angular_acceleration=1.0)
    told = [
        json.dumps(Rules.of(world.with_robot(replace(robot, kinematics=name, max_linear=fast))).to_json())
        for name in ("differential", "second_order_linear", "second_order_angular", "second_order")
        for fast in (0.5, 0.6)
    ]
    assert len(set(told)) == len(told)


def test_a_speed_without_a_limit_is_refused_where_it_is_a_command() -> None:
    world = load_map("lab")
    fast = world.with_robot(replace(world.robot, max_linear=np.inf))
    with pytest.raises(ConfigurationError, match="commands v reach from 0 to inf m/s"):
        Rules.of(fast)
