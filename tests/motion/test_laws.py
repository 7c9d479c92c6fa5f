"""Laws that hold for every kinematics: those that are known by name, and two that only the tests have."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.motion.toys import Crab, Slider, integrated
from viatool.motion import twists
from viatool.motion.kinematics import KINEMATICS
from viatool.motion.law import Kinematics
from viatool.motion.manoeuvre import Manoeuvre
from viatool.sets.forms import Forms, PoseBoxes
from viatool.world import Robot

ALL = [*(move for move in KINEMATICS.values() if not move.state), Crab(), Slider()]
each = pytest.mark.parametrize("move", ALL, ids=lambda move: move.name)
FAST = 9.0  # radians and metres per second: with the times below up to 18 rad


def commands(move, generator, count):
    return generator.uniform(-1.0, 1.0, (count, len(move.axes))) * np.where(
        [axis.unit == "rad/s" for axis in move.axes], FAST, 0.6
    )


def poses(generator, count):
    return generator.uniform((-3, -3, -np.pi), (3, 3, np.pi), (count, 3))


def boxes_of(move, generator, count):
    """Boxes of commands: of one command, thin, and wide; some cross 0."""
    centre = commands(move, generator, count)
    half = generator.uniform(0.0, 0.4, centre.shape) * generator.choice([0.0, 0.1, 1.0], centre.shape)
    return centre - half, centre + half


def within(generator, lower, upper):
    """One member of each box, often a corner."""
    share = generator.uniform(0.0, 1.0, lower.shape)
    share = np.where(generator.random(lower.shape) < 0.6, np.round(share), share)
    return np.clip(lower + share * (upper - lower), lower, upper)


def turned(first, second):
    return np.abs(np.angle(np.exp(1j * (first - second))))


@each
def test_robots_go_where_their_velocity_leads(move):
    generator = np.random.default_rng(0)
    start, held, seconds = poses(generator, 300), commands(move, generator, 300), generator.uniform(0, 2, 300)
    end, expected = move.advance(start, held, seconds), integrated(move.name, start, held, seconds)
    np.testing.assert_allclose(end[:, :2], expected[:, :2], atol=1e-11)
    assert turned(end[:, 2], expected[:, 2]).max() < 1e-11
    assert ((end[:, 2] > -np.pi) & (end[:, 2] <= np.pi)).all()


@each
def test_motion_is_a_flow(move):
    """For s and then for t seconds is for s + t, and for none at all is nothing."""
    generator = np.random.default_rng(1)
    start, held = poses(generator, 500), commands(move, generator, 500)
    s, t = generator.uniform(0.0, 1.5, (2, 500))
    first, once = move.advance(move.advance(start, held, s), held, t), move.advance(start, held, s + t)
    np.testing.assert_allclose(first[:, :2], once[:, :2], atol=1e-13)
    assert turned(first[:, 2], once[:, 2]).max() < 1e-13
    np.testing.assert_allclose(move.advance(start, held, 0.0), start, atol=1e-15)


@each
def test_motion_is_the_same_wherever_a_robot_is_and_however_it_is_turned(move):
    generator = np.random.default_rng(2)
    held, (x, y, angle) = commands(move, generator, 200), (1.2, -0.4, 2.0)
    start = poses(generator, 200)
    rotation = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])

    def moved(at):
        return np.column_stack([at[:, :2] @ rotation + [x, y], at[:, 2] + angle])

    first, second = move.advance(moved(start), held, 0.7), moved(move.advance(start, held, 0.7))
    np.testing.assert_allclose(first[:, :2], second[:, :2], atol=1e-12)
    assert turned(first[:, 2], second[:, 2]).max() < 1e-12


@each
def test_shapes_broadcast(move):
    held = np.ones((4, 9, 1, len(move.axes)))
    assert move.advance(np.zeros((4, 1, 1, 3)), held, np.linspace(0, 1, 5)).shape == (4, 9, 5, 3)
    assert [part.shape for part in move.rates(held, held, 0.1)] == [(4, 9, 1)] * 2


@each
def test_limits_clip_commands_and_the_ends_of_boxes_to_ends(move):
    generator = np.random.default_rng(3)
    robot = Robot(
        min_linear=-0.2, max_linear=0.5, max_angular=1.5, max_lateral=0.3, wheelbase=0.3, max_steering=0.4
    )
    low, high = move.limits(robot)
    assert low.shape == high.shape == (len(move.axes),)
    assert (low <= high).all()
    lower, upper = boxes_of(move, generator, 500)
    clipped = move.clip(within(generator, lower, upper), robot)
    assert ((move.clip(lower, robot) <= clipped) & (clipped <= move.clip(upper, robot))).all()
    assert ((low <= clipped) & (clipped <= high)).all()


@each
def test_rates_are_how_fast_a_robot_is_and_bound_those_of_a_box(move):
    generator = np.random.default_rng(4)
    lower, upper = boxes_of(move, generator, 500)
    held, start = within(generator, lower, upper), np.zeros((500, 3))
    speed, turn = move.rates(held, held, 0.1)
    soon = integrated(move.name, start, held, np.full(500, 1e-4), 1)
    np.testing.assert_allclose(np.hypot(soon[:, 0], soon[:, 1]), 1e-4 * speed, atol=1e-11)
    np.testing.assert_allclose(np.abs(soon[:, 2]), 1e-4 * turn, atol=1e-15)
    most = move.rates(lower, upper, 0.1)
    assert (speed <= most[0] * (1 + 1e-15)).all()
    assert (turn <= most[1]).all()


def manoeuvres(move):
    return (Manoeuvre(2.0, kinematics=move), Manoeuvre(0.3, 1.0, 0.2, move))


def strays(move, samples=12):
    """By how much commands, poses and instants leave the bounds, at most, by name: away, turned, chord, outline."""
    generator, worst = (
        np.random.default_rng(5),
        dict.fromkeys(("away", "turned", "chord", "outline"), -np.inf),
    )
    for manoeuvre in manoeuvres(move):
        lower, upper = boxes_of(move, generator, 1500)
        centre, until = 0.5 * (lower + upper), generator.uniform(0.0, 1.0, 1500)
        start, radii = poses(generator, 1500), generator.uniform(0.0, 0.3, (1500, 3))
        length, turn = manoeuvre.extent(centre)
        others, (away, turning) = (
            manoeuvre.deviation(lower, upper, until),
            move.from_elsewhere(radii, until * length, 0.0),
        )
        at = integrated(move.name, start, centre, until * manoeuvre.duration(centre), 30)
        span = until - 0.5 * until
        sagitta, outline = manoeuvre.sagitta(centre, span), move.outline_motion(length, turn, 2 * span, 0.4)
        begin = integrated(move.name, start, centre, 0.5 * until * manoeuvre.duration(centre), 30)
        for _ in range(samples):
            held, share = within(generator, lower, upper), generator.uniform(0.0, 1.0, 1500)
            pose = start + generator.choice([-1.0, 1.0], radii.shape) * radii
            seconds = share * until * manoeuvre.duration(held)
            end = integrated(move.name, pose, held, seconds, 30)
            same = integrated(move.name, start, centre, share * until * manoeuvre.duration(centre), 30)
            gone = np.hypot(*(end - same)[:, :2].T)
            worst["away"] = max(worst["away"], float((gone - others.away - away - turning).max()))
            twisted = np.abs(end[:, 2] - same[:, 2]) - others.turned - radii[:, 2]
            worst["turned"] = max(worst["turned"], float(twisted.max()))
            between = integrated(
                move.name, start, centre, (0.5 + 0.5 * share) * until * manoeuvre.duration(centre), 30
            )
            chord = begin[:, :2] + share[:, None] * (at - begin)[:, :2]
            left = np.hypot(*(between[:, :2] - chord).T) - sagitta
            worst["chord"] = max(worst["chord"], float(left.max()))
            point = 0.4 * np.exp(2j * np.pi * generator.random(1500))
            moved = (same[:, 0] + 1j * same[:, 1] + point * np.exp(1j * same[:, 2])) - (
                begin[:, 0] + 1j * begin[:, 1] + point * np.exp(1j * begin[:, 2])
            )
            worst["outline"] = max(worst["outline"], float((np.abs(moved) - outline).max()))
    return worst


@each
def test_other_commands_poses_and_instants_stay_within_their_bounds(move):
    for name, stray in strays(move).items():
        assert stray < 1e-9, name


MUTANTS = {
    "other speeds ahead": (
        "path_radii",
        lambda right: lambda *a: (0.0 * right(*a)[0], *right(*a)[1:]),
        "away",
    ),
    "other turns": ("path_radii", lambda right: lambda *a: (*right(*a)[:2], 0.0 * right(*a)[2]), "turned"),
    "sideways": ("sideways", lambda right: lambda length, heading: 0.0 * heading, "away"),
}


@pytest.mark.parametrize("name", MUTANTS)
def test_samples_catch_a_deviation_without_one_of_its_terms(monkeypatch, name):
    function, mutate, found = MUTANTS[name]
    monkeypatch.setattr(twists, function, mutate(getattr(twists, function)))
    assert strays(KINEMATICS["differential"], 3)[found] > 1e-3


def test_samples_catch_a_robot_that_forgets_how_far_it_slides(monkeypatch):
    right = twists.path_radii
    monkeypatch.setattr(twists, "path_radii", lambda *a: (right(*a)[0], 0.0 * right(*a)[1], right(*a)[2]))
    assert strays(Slider(), 3)["away"] > 1e-3


@pytest.mark.parametrize(
    ("rule", "found"), [("sagitta", "chord"), ("outline_motion", "outline"), ("from_elsewhere", "away")]
)
def test_samples_catch_bounds_of_instants_and_poses_that_are_nothing(monkeypatch, rule, found):
    move = KINEMATICS["differential"]
    right = getattr(type(move), rule)
    monkeypatch.setattr(type(move), rule, lambda *given: 0.0 * np.array(right(*given)))
    assert strays(move, 3)[found] > 1e-3


def leaves(move, seconds=2.0, speed=1.0, samples=10):
    """How far sampled successors leave the forms and the plain bounds of displacements, at most."""
    generator, count, axes = np.random.default_rng(6), 2000, len(move.axes)
    centre = np.column_stack([poses(generator, count), speed * commands(move, generator, count)])
    slope = generator.uniform(-0.08, 0.08, (count, 4, 3 + axes))
    sets = Forms(centre, slope, generator.uniform(0.0, 0.08, (count, 3 + axes)))
    after = move.successor(sets, seconds, np.zeros(count))
    radius = np.abs(slope).sum(axis=1) + sets.rest
    lower, upper = (centre[:, 3:] + side * radius[:, 3:] for side in (-1.0, 1.0))
    least, most = move.displacement(PoseBoxes(centre[:, :3], radius[:, :3]), lower, upper, seconds)
    off, out = -np.inf, -np.inf
    for _ in range(samples):
        z, e = generator.choice([-1.0, 1.0], (count, 4)), generator.uniform(-1.0, 1.0, (count, 3 + axes))
        e = np.where(generator.random(e.shape) < 0.6, np.sign(e), e)
        state = centre + np.einsum("cs,csk->ck", z, slope) + e * sets.rest
        end = integrated(move.name, state[:, :3], state[:, 3:], np.full(count, seconds))
        linear = after.centre + np.einsum("cs,csk->ck", z, after.slope)
        off = max(off, float((np.abs(end - linear) - after.rest).max()))
        added = end - state[:, :3]
        out = max(out, float(np.maximum(least - added, added - most).max()))
    return off, out


@each
@pytest.mark.parametrize("seconds", [0.1, 2.0])
def test_successors_lie_in_their_forms_and_displacements_in_their_bounds(move, seconds):
    off, out = leaves(move, seconds)
    assert off < 1e-9
    assert out < 1e-9


@each
def test_a_robot_without_speed_stays_exactly_where_it_is(move):
    generator = np.random.default_rng(7)
    boxes = PoseBoxes(poses(generator, 50), generator.uniform(0.0, 0.5, (50, 3)))
    still = 0.0 * commands(move, generator, 50)
    least, most = move.displacement(boxes, still, still, 2.0)
    assert not least[:, :2].any()
    assert not most[:, :2].any()


def test_samples_catch_a_successor_without_its_second_order(monkeypatch):
    monkeypatch.setattr(twists, "second_order", lambda speed, *rest: 0.0 * speed)
    for move in ALL:
        assert leaves(move, samples=3)[0] > 1e-4, move.name


def test_samples_catch_a_successor_that_forgets_the_rest_of_states(monkeypatch):
    right = twists.HeldTwist.successor
    for move in ALL:

        def without(self, states, *given):
            return right(self, replace(states, rest=0.0 * states.rest), *given)

        monkeypatch.setattr(type(move), "successor", without)
        assert leaves(move, samples=3)[0] > 1e-4, move.name


@pytest.mark.parametrize(
    "least", [lambda half: np.maximum(np.sinc(half / np.pi), 0.0), lambda half: 1.0 + 0.0 * half]
)
def test_samples_catch_chords_that_never_point_backwards_or_are_as_long_as_their_arcs(monkeypatch, least):
    monkeypatch.setattr(twists, "least_sinc", least)
    for move in (KINEMATICS["differential"], Slider()):
        assert leaves(move, speed=0.6, samples=5)[1] > 1e-3, move.name


def misled(move):
    """By how much displacements of boxes point beyond their directions, in radians, and how many boxes have some."""
    generator, count, manoeuvre = np.random.default_rng(8), 4000, Manoeuvre(1.0, 1.0, 0.0, move)
    lower, upper = boxes_of(move, generator, count)
    lower, upper = (
        lower * generator.choice([0.05, 1.0], (count, 1)),
        upper * generator.choice([0.05, 1.0], (count, 1)),
    )
    lower, upper = np.minimum(lower, upper), np.maximum(lower, upper)
    found, worst = manoeuvre.directions(lower, upper), -np.inf
    bounded = found.left - found.right < 2.0 * np.pi
    for _ in range(12):
        held = within(generator, lower, upper)
        seconds = manoeuvre.duration(held) * generator.uniform(0.0, 1.0, count)
        end = integrated(move.name, np.zeros((count, 3)), held, seconds, 30)
        way = end[:, 0] + 1j * end[:, 1]
        assert not (np.abs(way) > 1e-15)[found.still].any()
        chosen = bounded & (np.abs(way) > 1e-9)
        middle, half = 0.5 * (found.left + found.right), 0.5 * (found.left - found.right)
        off = np.abs(np.angle(way * np.exp(-1j * middle))) - half
        worst = max(worst, float(off[chosen].max(initial=-np.inf)))
    return worst, int(bounded.sum())


@each
def test_displacements_point_where_directions_say(move):
    assert misled(move)[0] < 1e-9


def test_directions_of_a_differential_drive_are_known_unless_it_backs_up_or_goes_round():
    assert misled(KINEMATICS["differential"])[1] > 300


def test_samples_catch_directions_of_a_robot_that_slides(monkeypatch):
    monkeypatch.setattr(Slider, "slides", property(lambda move: False))
    assert misled(Slider())[0] > 0.01


@each
def test_every_velocity_of_a_box_lies_between_those_that_are_told(move):
    """The corners' extremes in every direction bound those of the members."""
    generator = np.random.default_rng(9)
    lower, upper = boxes_of(move, generator, 500)
    ahead, turning = move.velocities(lower, upper, 0.1)
    for _ in range(20):
        held, a = within(generator, lower, upper), generator.standard_normal(3)
        soon = integrated(move.name, np.zeros((500, 3)), held, np.full(500, 1e-6), 1) / 1e-6
        most = (a[0] * ahead.real + a[1] * ahead.imag + a[2] * turning).max(axis=1)
        assert (soon @ a <= most + 1e-4).all()


@each
def test_ends_of_boxes_that_are_nan_leave_no_finite_bound(move):
    lower = np.full((3, len(move.axes)), np.nan)
    upper, once, boxes = np.ones_like(lower), np.ones(3), PoseBoxes(np.zeros((3, 3)), np.zeros((3, 3)))
    for low, high in ((lower, upper), (upper, lower)):
        found = Manoeuvre(0.1, kinematics=move).deviation(low, high, once)
        assert not np.isfinite(found.away).any()
        assert not np.isfinite(Manoeuvre(0.1, kinematics=move).longest(low, high)).any()
        least, most = move.displacement(boxes, low, high, 0.1)
        assert not (np.isfinite(least[:, :2]) & np.isfinite(most[:, :2])).any()
        assert not Manoeuvre(0.1, kinematics=move).directions(low, high).still.any()


def test_every_kinematics_declares_what_the_door_asks_for():
    for name, move in KINEMATICS.items():
        assert isinstance(move, Kinematics)
        assert move.name == name
        assert len({axis.kind for axis in move.axes}) == len(move.axes) > 0
