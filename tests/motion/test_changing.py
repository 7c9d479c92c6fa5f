"""Laws of robots whose velocity changes while a command is held, each with the mutants that it catches."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from tests.motion import changing_plant as plant
from viatool.errors import ConfigurationError
from viatool.motion import signals
from viatool.motion.changing import ChangingTwist
from viatool.motion.manoeuvre import Manoeuvre
from viatool.motion.steered import SlowlySteeredCar
from viatool.sets.forms import PoseBoxes

each = pytest.mark.parametrize("move", plant.MOVES, ids=plant.NAMES)
OFF = 3e-6  # metres and radians by which small steps err


def ends(move):
    lower, upper = move.limits(plant.robot_of(move.name))
    low, high = move.state_range
    return np.concatenate([lower, low]), np.concatenate([upper, high])


def held_of(move, generator, count):
    """Commands with their states, some of these at their limits and beyond."""
    lower, upper = ends(move)
    held = generator.uniform(lower, upper, (count, len(lower)))
    own = slice(len(move.axes), None)
    edge = generator.choice([0.0, 1.0], (count, len(move.state))) * (upper - lower)[own] + lower[own]
    held[:, own] = np.where(generator.random((count, 1)) < 0.2, edge, held[:, own])
    beyond = generator.random((count, 1)) < 0.05
    held[:, own] = np.where(beyond, held[:, own] * 1.3, held[:, own])
    return held


def boxes_of(move, generator, count):
    centre = held_of(move, generator, count)
    lower, upper = ends(move)
    half = generator.uniform(0.0, 0.25, centre.shape) * generator.choice([0.0, 0.1, 1.0], centre.shape)
    return centre - half * (upper - lower), centre + half * (upper - lower)


def within(generator, lower, upper):
    share = generator.uniform(0.0, 1.0, lower.shape)
    share = np.where(generator.random(lower.shape) < 0.6, np.round(share), share)
    return np.clip(lower + share * (upper - lower), lower, upper)


def poses(generator, count):
    return generator.uniform((-3, -3, -np.pi), (3, 3, np.pi), (count, 3))


def turned(first, second):
    return np.abs(np.angle(np.exp(1j * (first - second))))


@pytest.mark.parametrize("deceleration", [0.0, -1.0, float("nan")])
def test_brakes_that_never_stop_are_refused(deceleration: float) -> None:
    """The compiled proof takes 0 for no brakes at all."""
    with pytest.raises(ConfigurationError, match="never stops"):
        Manoeuvre(0.5, deceleration)


@each
def test_robots_go_where_small_steps_of_their_velocity_lead(move):
    generator = np.random.default_rng(0)
    start, held, seconds = poses(generator, 150), held_of(move, generator, 150), generator.uniform(0, 2, 150)
    expected = plant.path(move.name, start, held, seconds, pieces=20_000)[:, -1]
    count = len(move.axes)
    end = move.advance(np.hstack([start, held[:, count:]]), held[:, :count], seconds)
    np.testing.assert_allclose(end[:, :2], expected[:, :2], atol=1e-7)
    assert turned(end[:, 2], expected[:, 2]).max() < 1e-7
    ahead, turn = plant.velocity(move.name, held, seconds[:, None])
    after = np.hstack([held[:, :count], end[:, 3:]])
    np.testing.assert_allclose(move.speed(after, 0.0), ahead[:, 0], atol=1e-12)
    np.testing.assert_allclose(move.turn(after, 0.0), turn[:, 0], atol=1e-12)


@each
def test_fast_turns_are_integrated_as_well(move):
    """The pieces of the quadrature follow how far the robot turns; with one piece alone it would miss."""
    generator = np.random.default_rng(1)
    held = held_of(move, generator, 50)
    fast = replace(
        move, **({"max_angular": 40.0} if "max_angular" in move.parameters else {"min_linear": -9.0})
    )
    held[:, 0] = np.where(move.axes[0].name == "v", 6.0, held[:, 0])
    if move.name in ("second_order_linear", "second_order_angular", "second_order"):
        held[:, -1 if move.name != "second_order_linear" else 1] = 25.0
    seconds, start = np.full(50, 2.0), poses(generator, 50)
    direct = fast.drive(start, held, seconds, np.inf)
    steps = start
    for _ in range(64):
        count = len(move.axes)
        both = fast.advance(np.hstack([steps, held[:, count:]]), held[:, :count], seconds / 64)
        steps, held = both[:, :3], np.hstack([held[:, :count], both[:, 3:]])
    np.testing.assert_allclose(direct[:, :2], steps[:, :2], atol=1e-11)


@each
def test_motion_is_a_flow_and_speeds_stay_within_their_limits(move):
    generator = np.random.default_rng(2)
    held, count = held_of(move, generator, 500), len(move.axes)
    start = np.hstack([poses(generator, 500), np.clip(held[:, count:], *move.state_range)])
    s, t = generator.uniform(0.0, 1.5, (2, 500))
    command = held[:, :count]
    first, once = (
        move.advance(move.advance(start, command, s), command, t),
        move.advance(start, command, s + t),
    )
    np.testing.assert_allclose(first[:, :2], once[:, :2], atol=1e-12)
    np.testing.assert_allclose(first[:, 3:], once[:, 3:], atol=1e-12)
    low, high = move.state_range
    assert ((once[:, 3:] >= low - 1e-15) & (once[:, 3:] <= high + 1e-15)).all()
    np.testing.assert_allclose(move.advance(start, command, 0.0), start, atol=1e-15)


@each
def test_shapes_broadcast(move):
    held = np.broadcast_to(0.5 * sum(ends(move)), (4, 9, 1, len(ends(move)[0])))
    made = Manoeuvre(0.2, 1.0, 0.1, move)
    assert made.path(np.zeros((4, 1, 1, 3)), held, np.linspace(0, 1, 5)).shape == (4, 9, 5, 3)
    assert made.clock(held, np.linspace(0, 1, 5)).shape == (4, 9, 5)
    assert move.drive(np.zeros((0, 3)), held[0, :0, 0], 0.1, 0.1).shape == (0, 3)


def manoeuvres(move):
    return (Manoeuvre(0.8, kinematics=move), Manoeuvre(0.3, 1.5, 0.2, move))


def strays(move, samples=8, count=600):
    """By how much members and instants leave the bounds of their boxes, at most, by name."""
    generator = np.random.default_rng(5)
    names = ("away", "turned", "chord", "outline", "rates", "longest", "direction", "velocity", "displaced")
    worst = dict.fromkeys(names, -np.inf)
    pieces = 400
    for made in manoeuvres(move):
        lower, upper = boxes_of(move, generator, count)
        if move.state[0].kind == "steering":
            lower[:, 1:], upper[:, 1:] = (np.clip(end[:, 1:], -0.9, 0.9) for end in (lower, upper))
        centre = 0.5 * (lower + upper)
        until, start = generator.uniform(0.0, 1.0, count), poses(generator, count)
        deceleration = made.deceleration
        lasting = plant.whole(move.name, centre, made.interval, deceleration, made.rim)
        others = made.deviation(lower, upper, until)
        length, turn = made.extent(centre)
        low = (until * generator.uniform(0, 1, count) * pieces).astype(int)
        high = np.minimum(low + generator.integers(0, pieces, count), pieces)
        rows, span = np.arange(count), (high - low) / pieces
        own = plant.path(move.name, start, centre, lasting, made.interval, pieces)
        sagitta, outline = made.sagitta(centre, span), move.outline_motion(length, turn, span, 0.4)
        fastest, turning = move.rates(lower, upper, made.interval)
        directions, way = made.directions(lower, upper), made.longest(lower, upper)
        hull, spin = move.velocities(lower, upper, made.interval)
        box = PoseBoxes(start, np.zeros_like(start))
        least, most = move.displacement(box, lower, upper, made.interval)
        middle = (low + high) // 2
        for _ in range(samples):
            held = within(generator, lower, upper)
            seconds = plant.whole(move.name, held, made.interval, deceleration, made.rim)
            other = plant.path(move.name, start, held, seconds, made.interval, pieces)
            at = np.minimum((until * generator.choice([1.0, 0.5], count) * pieces).astype(int), pieces)
            gap = other[rows, at] - own[rows, at]
            worst["away"] = max(worst["away"], float((np.hypot(gap[:, 0], gap[:, 1]) - others.away).max()))
            worst["turned"] = max(worst["turned"], float((np.abs(gap[:, 2]) - others.turned).max()))
            inside = low + (generator.random(count) * (high - low)).astype(int)
            share = np.where(high > low, (inside - low) / np.maximum(high - low, 1), 0.0)
            chord = own[rows, low] + share[:, None] * (own[rows, high] - own[rows, low])
            left = np.hypot(*(own[rows, inside] - chord)[:, :2].T) - sagitta
            worst["chord"] = max(worst["chord"], float(left.max()))
            point = 0.4 * np.exp(2j * np.pi * generator.random(count))

            first, second = (own[rows, which] for which in (inside, middle))
            turned_by = np.exp(1j * first[:, 2]) - np.exp(1j * second[:, 2])
            shift = (first - second)[:, 0] + 1j * (first - second)[:, 1]
            step = np.abs(shift + point * turned_by) - outline - 2 * (length + 0.4 * turn) / pieces
            worst["outline"] = max(worst["outline"], float(step.max()))
            time = np.minimum(generator.random((count, 1)) * seconds[:, None], made.interval)
            ahead, spun = (part[:, 0] for part in plant.velocity(move.name, held, time))
            over = np.maximum(np.abs(ahead) - fastest, np.abs(spun) - turning)
            worst["rates"] = max(worst["rates"], float(over.max()))
            a = generator.standard_normal(2)
            beyond = a[0] * ahead + a[1] * spun - (a[0] * hull.real + a[1] * spin).max(axis=1)
            worst["velocity"] = max(worst["velocity"], float(beyond.max()))
            moved = other[rows, at] - start
            gone = moved[:, 0] + 1j * moved[:, 1]
            worst["longest"] = max(worst["longest"], float((np.abs(gone) - way).max()))
            bounded = (directions.left - directions.right < 2 * np.pi) & (np.abs(gone) > 1e-4)
            towards = gone * np.exp(-1j * (start[:, 2] + 0.5 * (directions.left + directions.right)))
            off = np.abs(np.angle(towards)) - 0.5 * (directions.left - directions.right)
            worst["direction"] = max(worst["direction"], float(off[bounded].max(initial=-np.inf)))
            assert not (np.abs(gone) > 1e-12)[directions.still].any()
            full = (
                plant.path(move.name, start, held, np.full(count, made.interval), np.inf, pieces)[:, -1]
                - start
            )
            out = np.maximum(least - full, full - most).max()
            worst["displaced"] = max(worst["displaced"], float(out))
    return worst


@each
def test_members_of_boxes_stay_within_their_bounds(move):
    found = strays(move)
    assert found.pop("direction") < 1e-2  # of a displacement of 0.1 mm
    for name, stray in found.items():
        assert stray < 10 * OFF, name


def constant(right):
    return lambda one, half: (0.0 * right(one, half)[0], right(one, half)[1])


def growing(right):
    return lambda one, half: (right(one, half)[0], 0.0 * right(one, half)[1])


MUTANTS = {
    "states that differ": ("IntegratedSignal", constant),
    "rates that differ": ("IntegratedSignal", growing),
    "commands that differ": ("HeldSignal", constant),
    "angles that differ": ("ApproachingSignal", constant),
}


@pytest.mark.parametrize("name", MUTANTS)
def test_samples_catch_a_deviation_without_one_of_its_radii(monkeypatch, name):
    kind, mutate = MUTANTS[name]
    of = getattr(signals, kind)
    monkeypatch.setattr(of, "radii", mutate(of.radii))
    caught = [
        move.name
        for move in plant.MOVES
        if max(strays(move, 3, 250)[one] for one in ("away", "turned")) > 1e-3
    ]
    expected = {
        "IntegratedSignal": {
            "second_order_linear",
            "second_order_angular",
            "second_order",
            "second_order_ackermann",
        },
        "HeldSignal": {"second_order_linear", "second_order_angular", "second_order_ackermann", "ackermann"},
        "ApproachingSignal": {"ackermann"},
    }[kind]
    assert set(caught) == expected


def test_samples_catch_a_sagitta_without_the_acceleration(monkeypatch):
    for move in plant.MOVES:
        monkeypatch.setattr(type(move), "_faster", lambda move, lower, upper: np.zeros(len(lower)))
    assert strays(plant.MOVES[0], 3, 300)["chord"] > 1e-3


def test_samples_catch_paths_that_are_taken_to_last_as_long_as_that_of_the_centre(monkeypatch):
    """Braking from another speed takes another time."""
    right = ChangingTwist._apart

    def as_long(self, lower, upper, until, timed):
        centre = 0.5 * (lower + upper)
        lasting = timed.seconds(*self.last_rates(centre, centre, timed.interval))
        return right(self, lower, upper, until, Lasting(timed.interval, lasting))

    monkeypatch.setattr(ChangingTwist, "_apart", as_long)
    assert strays(plant.MOVES[2], 3, 300)["away"] > 1e-2


@dataclass(frozen=True)
class Lasting:
    """Every path lasts as long as it is told."""

    interval: float
    lasting: np.ndarray

    def seconds(self, speed, turn):
        return self.lasting


@each
def test_ends_of_boxes_that_are_nan_leave_no_finite_bound(move):
    size = len(ends(move)[0])
    lower = np.full((3, size), np.nan)
    upper, once, made = np.full((3, size), 0.1), np.ones(3), Manoeuvre(0.1, 1.0, 0.1, move)
    for low, high in ((lower, upper), (upper, lower)):
        assert not np.isfinite(made.deviation(low, high, once).away).any()
        assert not np.isfinite(made.longest(low, high)).any()
        assert not made.directions(low, high).still.any()
    held = np.full((3, size), np.nan)
    assert not np.isfinite(made.path(np.zeros((3, 3)), held, once)).any()


def test_a_car_whose_wheels_turn_is_one_whose_wheels_stand_where_they_shall():
    move = next(move for move in plant.MOVES if isinstance(move, SlowlySteeredCar))
    held = np.array([[0.8, 0.3, 0.3]])
    end = move.drive(np.zeros((1, 3)), held, 1.7, np.inf)
    radius = plant.WHEELBASE / np.tan(0.3)
    angle = 0.8 * 1.7 / radius
    np.testing.assert_allclose(
        end[0], [radius * np.sin(angle), radius * (1 - np.cos(angle)), angle], atol=1e-12
    )
