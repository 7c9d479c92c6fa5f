from __future__ import annotations

from pathlib import Path

import mpmath
import numpy as np
import pytest

from tests.loop.plant import Plant
from viatool import load_map, load_policy
from viatool.loop.closed_loop import ClosedLoop
from viatool.loop.successor import fold, hull, states_of, step
from viatool.motion import twists
from viatool.motion.kinematics import DIFFERENTIAL
from viatool.places import passages
from viatool.sets.forms import Forms, PoseBoxes
from viatool.sets.states import StateBoxes
from viatool.setting.setting import Setting

ROOM, POLICY = load_map(Path("maps/room.yaml")), load_policy(Path("policies/via.onnx"))
SCENARIO = ROOM.scenarios[0]
ROBOT = Plant(POLICY, ROOM, SCENARIO, 0.01)
QUESTION = ClosedLoop.of(POLICY, Setting.of(POLICY, ROOM, 0.01), SCENARIO)


def cells(generator, count, side, share):
    """StateBoxes where the robot may stand; the previous command within a share of its range."""
    centre = generator.uniform((-1.6, -1.6, -3.2), (1.6, 1.6, 3.2), (6 * count, 3))
    free = QUESTION.geometry.still.clearance(centre[:, :2], np.zeros(len(centre), np.int64)) > 0.4
    centre = centre[free][:count]
    lower = generator.uniform((0.0, -1.0), (0.5 * (1 - share), 1.0 - 2.0 * share), (count, 2))
    radius = np.full((count, 3), 0.5 * side)
    return StateBoxes(PoseBoxes(centre, radius), lower, lower + share * np.array([0.5, 2.0]))


def arc(states, commands, seconds=0.1, pieces=100):
    """Where the arcs of commands end, by Simpson's rule."""
    v, w = commands.T
    at = np.linspace(0.0, seconds, 2 * pieces + 1)
    weight = np.ones(2 * pieces + 1)
    weight[1:-1:2], weight[2:-1:2] = 4.0, 2.0
    weight *= seconds / (6 * pieces)
    heading = states[:, 2, None] + w[:, None] * at
    x = states[:, 0] + v * (np.cos(heading) @ weight)
    y = states[:, 1] + v * (np.sin(heading) @ weight)
    return np.column_stack([x, y, states[:, 2] + w * seconds, v, w])


def sampled(generator, some):
    """States of cells, often at their corners, with z in [-1, 1]^5."""
    z = generator.uniform(-1.0, 1.0, (len(some), 5))
    z = np.where(generator.random(z.shape) < 0.4, np.sign(z), z)
    middle = 0.5 * (some.previous_lower + some.previous_upper)
    half = 0.5 * (some.previous_upper - some.previous_lower)
    return z, np.hstack([some.poses.centre + z[:, :3] * some.poses.radius, middle + z[:, 3:] * half])


def in_the_best_piece(origin, excess):
    """By how much each set's state is beyond the piece that holds it best, (C,)."""
    best = np.full(origin[-1] + 1, np.inf)
    np.minimum.at(best, origin, excess)
    return best


def beyond(generator, some, rounds):
    """How far sampled successors lie beyond the bounds and the rests of the forms of a piece, in the worst case."""
    found = step(QUESTION, states_of(some))
    lower, upper = found.bounds(some.poses.centre - some.poses.radius, some.poses.centre + some.poses.radius)
    own = np.abs(found.states.slope[:, 5:]).sum(axis=1) + found.states.rest
    worst = -np.inf
    for _ in range(rounds):
        z, states = sampled(generator, some)
        after = arc(states, ROBOT.noisy_command(states, generator))[found.origin]
        linear = found.states.centre + np.einsum("cs,csk->ck", z[found.origin], found.states.slope[:, :5])
        outside, left = np.maximum(lower - after, after - upper), np.abs(after - linear) - own
        each = in_the_best_piece(found.origin, np.maximum(outside, left).max(axis=1))
        assert len(each) == len(some)
        worst = max(worst, float(each.max()))
    return worst


@pytest.mark.parametrize(("side", "share"), [(0.005, 0.02), (0.03, 0.25), (0.2, 1.0)])
def test_successors_of_sampled_states_lie_in_the_enclosure(side, share):
    """33,600 successors each, by a simulator that shares no code: other rays, other integration, onnxruntime."""
    generator = np.random.default_rng(0)
    some = cells(generator, 1200, side, share)
    assert (
        beyond(generator, some, 28) <= 1e-13
    )  # the rule of Simpson and the boxes of commands that a clip pins


def test_what_is_only_in_the_rest_of_states_is_followed_as_well():
    """The same sets with no symbol at all: a rest that were left out would leave one state of each."""
    generator = np.random.default_rng(3)
    some = cells(generator, 600, 0.03, 0.25)
    named = states_of(some)
    found = step(QUESTION, Forms(named.centre, np.zeros_like(named.slope), np.abs(named.slope).sum(axis=1)))
    lower, upper = found.states.lower, found.states.upper
    outside = -np.inf
    for _ in range(5):
        _, states = sampled(generator, some)
        after = arc(states, ROBOT.noisy_command(states, generator))[found.origin]
        excess = np.maximum(lower - after, after - upper).max(axis=1)
        outside = max(outside, float(in_the_best_piece(found.origin, excess).max()))
    assert outside <= 1e-13


def test_the_forms_know_that_a_policy_steers_against_an_error():
    generator = np.random.default_rng(1)
    some = cells(generator, 1500, 0.01, 0.01)
    found = step(QUESTION, states_of(some))
    lower, upper = found.bounds(some.poses.centre - some.poses.radius, some.poses.centre + some.poses.radius)
    plain = 0.01 + 0.1 * (found.upper[:, 1] - found.lower[:, 1])
    assert (upper[:, 2] - lower[:, 2] < 0.98 * plain).mean() > 0.1


def forms(generator, count, size):
    """Sets of poses and commands with four symbols and a rest."""
    centre = generator.uniform((-1, -1, -3, 0.0, -1.0), (1, 1, 3, 0.5, 1.0), (count, 5))
    slope = generator.uniform(-size, size, (count, 4, 5))
    return Forms(centre, slope, generator.uniform(0.0, size, (count, 5)))


def misses(seconds=0.1, faster=1.0):
    """How far arcs from the corners of sets end beyond what `Kinematics.successor` says, in the worst case."""
    generator = np.random.default_rng(2)
    sets = forms(generator, 4000, 0.12)
    sets.centre[:, 4] *= faster
    moved = DIFFERENTIAL.successor(sets, seconds, np.zeros(4000))
    worst = -np.inf
    for _ in range(8):
        z = generator.choice([-1.0, 1.0], (4000, 4))
        e = generator.choice([-1.0, 1.0], (4000, 5))
        states = sets.centre + np.einsum("cs,csk->ck", z, sets.slope) + e * sets.rest
        ends = arc(states, states[:, 3:], seconds)[:, :3]
        linear = moved.centre + np.einsum("cs,csk->ck", z, moved.slope)
        worst = max(worst, float((np.abs(ends - linear) - moved.rest).max()))
    return worst


@pytest.mark.parametrize(("seconds", "faster"), [(0.1, 1.0), (2.0, 1.0), (2.0, 9.0)])
def test_arcs_end_where_forms_say(seconds, faster):
    """Also those that turn by more than a circle: up to 18 rad."""
    assert misses(seconds, faster) < 1e-11


def test_the_second_order_of_arcs_is_needed(monkeypatch):
    monkeypatch.setattr(twists, "second_order", lambda speed, a, b, c, seconds: 0.0 * speed)
    assert misses() > 1e-4


def test_rounding_is_counted_and_would_be_missed():
    """A single pose and command: mpmath says how far the end that was computed is off."""
    generator = np.random.default_rng(3)
    centre = generator.uniform((-2, -2, -3, 0.1, -1.0), (2, 2, 3, 0.5, 1.0), (40, 5))
    point = Forms(centre, np.zeros((40, 1, 5)), np.zeros((40, 5)))
    off = []
    with mpmath.workdps(40):
        moved = DIFFERENTIAL.successor(point, 0.1, np.zeros(40))
        for row, (x, y, theta, v, w) in enumerate(centre.tolist()):
            half = mpmath.mpf(w) * mpmath.mpf(0.1) / 2
            chord = mpmath.mpf(v) * mpmath.mpf(0.1) * mpmath.sin(half) / half
            end = x + chord * mpmath.cos(theta + half), y + chord * mpmath.sin(theta + half)
            off += [float(abs(moved.centre[row, axis] - end[axis])) for axis in (0, 1)]
    assert 0.0 < max(off) < 1e-14
    some = cells(generator, 20, 0.01, 0.1)
    assert (step(QUESTION, states_of(some)).states.rest[:, :3] > 100 * max(off)).all()


@pytest.mark.parametrize("speed", [0.0, 0.3])
def test_displacements_of_boxes_hold_and_a_robot_without_speed_stays(speed):
    generator = np.random.default_rng(4)
    boxes = PoseBoxes(generator.uniform(-3.2, 3.2, (3000, 3)), generator.uniform(0.0, 0.6, (3000, 3)))
    lower = np.column_stack([np.zeros(3000), generator.uniform(-1, 0.5, 3000)])
    upper = np.column_stack([np.full(3000, speed), lower[:, 1] + generator.uniform(0, 0.5, 3000)])
    least, most = DIFFERENTIAL.displacement(boxes, lower, upper, 0.1)
    for _ in range(10):
        states = np.hstack([boxes.centre + generator.choice([-1, 1], (3000, 3)) * boxes.radius, lower])
        commands = lower + generator.choice([0.0, 1.0, 0.5], (3000, 2)) * (upper - lower)
        added = arc(states, commands)[:, :3] - states[:, :3]
        assert (added >= least - 1e-14).all()
        assert (added <= most + 1e-14).all()
    if not speed:
        assert not least[:, :2].any()
        assert not most[:, :2].any()


def displaced_beyond(seconds=2.0):
    """How far arcs of up to two circles, forward and back, displace a robot beyond the bounds, in the worst case."""
    generator = np.random.default_rng(7)
    boxes = PoseBoxes(generator.uniform(-3.2, 3.2, (4000, 3)), generator.uniform(0.0, 0.1, (4000, 3)))
    lower = generator.uniform((-0.3, -6.0), (0.5, 6.0), (4000, 2))
    upper = lower + generator.uniform(0.0, 0.3, (4000, 2)) * generator.choice([0.0, 1.0], (4000, 2))
    least, most = DIFFERENTIAL.displacement(boxes, lower, upper, seconds)
    worst = -np.inf
    for _ in range(10):
        states = np.hstack([boxes.centre + generator.choice([-1, 1], (4000, 3)) * boxes.radius, lower])
        commands = lower + generator.choice([0.0, 1.0, 0.5], (4000, 2)) * (upper - lower)
        added = arc(states, commands, seconds, 1000)[:, :3] - states[:, :3]
        worst = max(worst, float(np.maximum(least - added, added - most).max()))
    return worst


def test_displacements_hold_beyond_a_circle_forward_and_backward():
    assert displaced_beyond() <= 1e-9


def test_a_chord_that_points_backwards_would_be_missed(monkeypatch):
    monkeypatch.setattr(twists, "least_sinc", lambda half: np.maximum(np.sinc(half / np.pi), 0.0))
    assert displaced_beyond() > 0.01


def test_the_largest_chord_that_points_backwards_counts_for_all_larger_turns(monkeypatch):
    monkeypatch.setattr(twists, "least_sinc", lambda half: np.sinc(half / np.pi) - 2.0**-40)
    assert displaced_beyond() > 0.01


def test_folded_symbols_stay_in_the_hull():
    sets = forms(np.random.default_rng(5), 50, 0.1)
    folded = fold(sets, 2)
    assert folded.slope.shape == (50, 2, 5)
    assert (folded.lower <= sets.lower + 1e-15).all()
    assert (folded.upper >= sets.upper - 1e-15).all()
    whole, part = hull(sets), hull(folded)
    np.testing.assert_allclose(whole.poses.radius, part.poses.radius, rtol=1e-12)


def test_two_steps_follow_what_was_commanded_before():
    """Runs of two steps lie in the second enclosure, which knows the first command as the previous one."""
    generator = np.random.default_rng(6)
    some = cells(generator, 400, 0.02, 0.2)
    first = step(QUESTION, states_of(some))
    second = step(QUESTION, fold(first.states, passages._SYMBOLS))
    lower, upper, origin = second.states.lower, second.states.upper, first.origin[second.origin]
    for _ in range(15):
        _, states = sampled(generator, some)
        for _ in range(2):
            states = arc(states, ROBOT.noisy_command(states, generator))
        after = states[origin]
        excess = np.maximum(lower - after, after - upper).max(axis=1)
        assert in_the_best_piece(origin, excess).max() <= 1e-13
