"""Where sets of states of robots whose velocity changes lead in an interval, against small steps of the velocity."""

from __future__ import annotations

from dataclasses import replace

import mpmath
import numpy as np
import pytest

from tests.motion import changing_plant as plant
from tests.motion.changing_mutants import heading_that_is_frozen, velocity_that_is_not_carried
from viatool.motion import changing, signals, straight
from viatool.motion.kinematics import motion_of
from viatool.motion.signals import ApproachingSignal, IntegratedSignal
from viatool.sets.forms import Forms

STRAIGHT, CARS = plant.NAMES[:3], plant.NAMES[3:]
SECONDS, SETS = 0.4, 800
SLACK = 4e-6
"""Metres, and radians, by which the small steps of the plant may err."""
each = pytest.mark.parametrize("name", plant.NAMES)


def ranges(name):
    """Smallest and largest command, and beside it the state, that a robot of the plant has."""
    move = motion_of(plant.robot_of(name))
    low, high = move.limits(plant.robot_of(name))
    return np.concatenate([low, move.state_range[0]]), np.concatenate([high, move.state_range[1]])


def sets(name, size, seed=0, beyond=0.0):
    """Sets of poses, commands and states with three symbols and rests, many of them at the robot's limits."""
    generator = np.random.default_rng(seed)
    low, high = ranges(name)
    share = generator.random((SETS, len(low)))
    share = np.where(generator.random(share.shape) < 0.3, np.round(share), share)
    held = low + share * (high - low) + beyond * (2.0 * share - 1.0)
    centre = np.hstack([generator.uniform(-2.0, 2.0, (SETS, 3)), held])
    scale = size * np.concatenate([[0.2, 0.2, 1.0], high - low])
    slope = generator.uniform(-0.2, 0.2, (SETS, 3, len(scale))) * scale
    slope *= generator.random((SETS, 1, len(scale))) < 0.8
    return Forms(centre, slope, 0.2 * generator.random((SETS, len(scale))) * scale)


def misses(name, size=0.3, beyond=0.0, rounds=8, seconds=SECONDS):
    """How far states of sets are after an interval beyond what `Kinematics.successor` says: poses, and motion."""
    move, some = motion_of(plant.robot_of(name)), sets(name, size, beyond=beyond)
    moved = move.successor(some, seconds, np.zeros(SETS))
    assert moved.centre.shape == (SETS, 3 + len(move.state))
    generator, worst = np.random.default_rng(1), np.full(2, -np.inf)
    for number in range(rounds):
        z, e = (generator.choice([-1.0, 1.0], (SETS, count)) for count in (3, some.centre.shape[1]))
        if number % 2:
            z, e = z * generator.random(z.shape), e * generator.random(e.shape)
        states = some.centre + np.einsum("cs,csk->ck", z, some.slope) + e * some.rest
        held = states[:, 3:]
        ends = plant.path(name, states[:, :3], held, np.full(SETS, seconds), pieces=600)[:, -1]
        ends = np.hstack([ends, motion(name, held, seconds)])
        linear = moved.centre + np.einsum("cs,csk->ck", z, moved.slope[:, :3])
        own = np.abs(moved.slope[:, 3:]).sum(axis=1) + moved.rest  # symbols of what the motion leaves out
        over = np.abs(ends - linear) - own
        worst = np.maximum(worst, [over[:, :3].max(), over[:, 3:].max()])
    return worst


def motion(name, held, seconds):
    """The state after an interval, (B, S)."""
    ahead, turn = plant.velocity(name, held, np.full((len(held), 1), seconds))
    if name == "ackermann":
        way = held[:, 1] - held[:, 2]
        return (held[:, 2] + np.sign(way) * np.minimum(np.abs(way), plant.RATE * seconds))[:, None]
    return np.hstack([ahead, turn] if name == "second_order" else [turn if "angular" in name else ahead])


@each
@pytest.mark.parametrize(("size", "beyond"), [(0.05, 0.0), (0.6, 0.0), (0.3, 0.4)])
def test_states_end_where_forms_say(name, size, beyond):
    """Also those that reach a limit on the way, or begin beyond it."""
    if name in CARS and beyond:
        beyond = 0.02  # their wheels would turn across
    assert (misses(name, size, beyond) < SLACK).all()


@pytest.mark.parametrize("name", STRAIGHT)
def test_states_end_there_after_more_than_a_turn(name):
    assert (misses(name, seconds=4.0, rounds=3) < 50 * SLACK).all()


@each
def test_bounds_of_the_motion_hold_and_stay_at_limits(name):
    move, some = motion_of(plant.robot_of(name)), sets(name, 0.1, beyond=0.01)
    lower, upper = some.lower[:, 3:], some.upper[:, 3:]
    least, most = move.reached(lower, upper, SECONDS)
    generator = np.random.default_rng(2)
    for _ in range(6):
        share = np.round(2.0 * generator.random(lower.shape)) / 2.0
        held = np.minimum(lower + share * (upper - lower), upper)
        after = motion(name, held, SECONDS)
        assert (after >= least - 1e-15).all()
        assert (after <= most + 1e-15).all()
    low, high = ranges(name)
    within = ((lower >= low) & (upper <= high)).all(axis=1)
    count = len(move.axes)
    assert ((least >= low[count:]) & (most <= high[count:]))[within].all()


def half_of_what_is_left_out(patch):
    right = straight.left_out

    def wrong(*given):
        (least, most), aside = right(*given)
        return (0.5 * least, 0.5 * most), 0.5 * aside

    patch.setattr(straight, "left_out", wrong)


def part_left_out(which):
    def mutate(patch):
        right = straight.left_out

        def wrong(*given):
            (least, most), aside = right(*given)
            return ((0.0 * least, most), aside) if which == "along" else ((least, most), 0.0 * aside)

        patch.setattr(straight, "left_out", wrong)

    return mutate


def no_limits_on_the_way(patch):
    patch.setattr(
        signals, "clip_line", lambda lower, upper, low, high: (1.0 + 0.0 * lower, 0.0 * lower, 0.0 * lower)
    )


def limits_without_a_radius(patch):
    right = signals.clip_line
    patch.setattr(signals, "clip_line", lambda *given: (*right(*given)[:2], 0.0 * right(*given)[2]))


def limits_where_all_begin_within(patch):
    """As if what begins beyond a limit were at it."""
    right = IntegratedSignal._between

    def wrong(self, lower, upper, since, until):
        ends = [np.array(end) for end in (lower, upper)]
        for end in ends:
            end[:, self.state] = np.clip(end[:, self.state], self.low, self.high)
        found = right(self, *ends, since, until)
        return replace(found, radius=0.0 * found.radius)

    patch.setattr(IntegratedSignal, "_between", wrong)


def turn_that_is_held(patch):
    """As if the place did not answer to how the turn accelerates."""
    right = straight._Centre.gradient

    def wrong(self, ahead, turning):
        return right(self, ahead, replace(turning, rate=None))

    patch.setattr(straight._Centre, "gradient", wrong)


def rests_of_what_is_held(patch):
    right = straight.accelerated

    def wrong(states, *given):
        rest = states.rest.copy()
        rest[:, 2:] = 0.0
        return right(replace(states, rest=rest), *given)

    patch.setattr("viatool.motion.second_order.accelerated", wrong)


@pytest.mark.parametrize(
    ("mutate", "name", "beyond"),
    [
        (half_of_what_is_left_out, "second_order", 0.0),
        (part_left_out("along"), "second_order_angular", 0.0),
        (part_left_out("aside"), "second_order_linear", 0.0),
        (no_limits_on_the_way, "second_order_linear", 0.0),
        (limits_without_a_radius, "second_order_angular", 0.0),
        (limits_where_all_begin_within, "second_order", 0.4),
        (velocity_that_is_not_carried, "second_order", 0.0),
        (heading_that_is_frozen, "second_order_linear", 0.0),
        (turn_that_is_held, "second_order", 0.0),
        (rests_of_what_is_held, "second_order", 0.0),
    ],
)
def test_what_is_left_out_would_be_missed(mutate, name, beyond, monkeypatch):
    mutate(monkeypatch)
    assert misses(name, beyond=beyond).max() > 20 * SLACK


@pytest.mark.parametrize("name", CARS)
@pytest.mark.parametrize("part", [0, 1])
def test_half_of_how_far_cars_are_apart_would_be_missed(name, part, monkeypatch):
    right = changing.ChangingTwist._apart

    def wrong(*given):
        found = list(right(*given))
        found[part] = 0.4 * found[part]
        return tuple(found)

    monkeypatch.setattr(changing.ChangingTwist, "_apart", wrong)
    assert misses(name, size=0.05)[0] > 20 * SLACK


def test_wheels_that_turn_at_once_would_be_missed(monkeypatch):
    right = ApproachingSignal.form
    monkeypatch.setattr(
        ApproachingSignal, "form", lambda self, *given: right(replace(self, rate=1e3), *given)
    )
    assert misses("ackermann")[1] > 0.01


def test_the_rounding_of_a_path_is_covered_by_the_slack_of_a_step():
    """A single state and command: mpmath says how far the end that was computed is off."""
    name, generator = "second_order", np.random.default_rng(3)
    move = motion_of(plant.robot_of(name))
    low, high = np.array([-2.0, -3.0, 0.2, -1.0]), np.array([2.0, 3.0, 0.5, 1.0])
    held = generator.uniform(low, high, (10, 4)) * [0.5, 0.5, 1.0, 1.0]
    centre = np.hstack([generator.uniform(-2.0, 2.0, (10, 3)), held])
    point = Forms(centre, np.zeros((10, 1, 7)), np.zeros((10, 7)))
    moved, off = move.successor(point, 0.1, np.zeros(10)), []
    with mpmath.workdps(30):
        for row, (x, y, theta, a, alpha, v, w) in enumerate(centre.tolist()):

            def along(t, theta=theta, a=a, alpha=alpha, v=v, w=w):
                angle = theta + mpmath.mpf(w) * t + mpmath.mpf(alpha) * t * t / 2
                return (mpmath.mpf(v) + mpmath.mpf(a) * t) * mpmath.expj(angle)

            end = mpmath.mpc(x, y) + mpmath.quad(along, [0, mpmath.mpf(0.1)])
            off += [
                float(abs(moved.centre[row, 0] - end.real)),
                float(abs(moved.centre[row, 1] - end.imag)),
                float(abs(moved.centre[row, 3] - (v + mpmath.mpf(a) * mpmath.mpf(0.1)))),
            ]
    assert 0.0 < max(off) < 1e-14
    assert (moved.rest[:, 3:] > 1e-14).all()
