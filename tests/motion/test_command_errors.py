"""What acts beside a command, another amount at every instant: where it leads, against small steps of the velocity."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.motion import changing_plant as plant
from viatool.motion import second_order
from viatool.motion.command_errors import CommandErrors, Strayed
from viatool.motion.kinematics import motion_of
from viatool.motion.signals import HeldSignal, IntegratedSignal

NAMES = plant.NAMES[:3]
COUNT, PIECES, SECONDS = 100, 200, 0.5
SLACK = 4e-6
RELATIVE, ABSOLUTE = np.array([0.2, 0.1]), np.array([0.3, 0.2])


def grown(begin, rates, low, high, step):
    """What grows at rates (B, T) and stops at its limits, which move with one that begins beyond: at T + 1 times."""
    least, most = np.minimum(low, begin), np.maximum(high, begin)
    found = [begin]
    for rate in rates.T:
        begin = np.clip(begin + rate * step, least, most)
        found.append(begin)
    return np.stack(found, axis=1)


def driven(name, held, errors):
    """Poses from the origin and states (B, 3 + S) under commands with errors (B, T, 2) beside them, by small steps."""
    step = SECONDS / PIECES
    acting = held[:, None, :2] + errors
    states = {"v": held[:, 2], "omega": held[:, 2 if name == "second_order_angular" else 3 % held.shape[1]]}
    if name == "second_order_angular":
        ahead, ends = np.repeat(acting[..., 0], 1, axis=1), []
    else:
        speeds = grown(states["v"], acting[..., 0], plant.LOW, plant.HIGH, step)
        ahead, ends = 0.5 * (speeds[:, 1:] + speeds[:, :-1]), [speeds[:, -1]]
    if name == "second_order_linear":
        turn = acting[..., 1]
    else:
        turns = grown(states["omega"], acting[..., 1], -plant.TURN, plant.TURN, step)
        turn = 0.5 * (turns[:, 1:] + turns[:, :-1])
        ends.append(turns[:, -1])
    heading = np.cumsum(turn * step, axis=1)
    middle = heading - 0.5 * turn * step
    x, y = (ahead * step * np.cos(middle)).sum(axis=1), (ahead * step * np.sin(middle)).sum(axis=1)
    return np.column_stack([x, y, heading[:, -1], *ends])


def boxes(name):
    """Boxes of commands and states, many of them at the robot's limits, and a member of each."""
    generator = np.random.default_rng(0)
    robot = plant.robot_of(name)
    move = motion_of(robot)
    low, high = (np.concatenate(ends) for ends in zip(move.limits(robot), move.state_range, strict=True))
    share = generator.random((COUNT, len(low)))
    share = np.where(generator.random(share.shape) < 0.4, np.round(share), share)
    middle = low + share * (high - low)
    half = 0.05 * generator.random(middle.shape) * (high - low)
    held = middle + generator.choice([-1.0, 1.0], middle.shape) * half
    return move, middle - half, middle + half, held


def largest_misses(name):
    """How far runs are beyond what `strayed` says: of the place, of the heading, of the state."""
    errors = CommandErrors(RELATIVE, ABSOLUTE)
    move, lower, upper, held = boxes(name)
    said = move.strayed(errors, lower, upper, SECONDS)
    without = driven(name, held, np.zeros((COUNT, PIECES, 2)))
    generator, worst = np.random.default_rng(1), np.full(3, -np.inf)
    most = RELATIVE * np.abs(held[:, :2]) + ABSOLUTE
    for number in range(12):
        signs = generator.choice([-1.0, 1.0], (COUNT, PIECES, 2))
        if number % 3:  # held for the whole interval, or for a part of it
            signs[:] = signs[:, :1]
            since = generator.integers(PIECES, size=COUNT) * (number % 3 - 1)
            signs *= np.where(np.arange(PIECES)[:, None] < since[:, None, None], -1.0, 1.0)
        apart = driven(name, held, signs * most[:, None]) - without
        worst[0] = max(worst[0], (np.hypot(apart[:, 0], apart[:, 1]) - said.away).max())
        worst[1] = max(worst[1], (np.abs(apart[:, 2]) - said.turned).max())
        worst[2] = max(worst[2], (np.abs(apart[:, 3:]) - said.changed).max())
    return worst


@pytest.mark.parametrize("name", NAMES)
def test_errors_of_commands_lead_no_farther_than_is_said(name):
    assert (largest_misses(name) < SLACK).all()


def share_left_out(patch):
    patch.setattr(CommandErrors, "radii", lambda self, lower, upper: self.absolute + 0.0 * lower)


def turns_that_do_not_move_the_place(patch):
    patch.setattr(second_order.Unicycle, "rates", lambda self, lower, upper, time: (0.0 * lower[:, 0],) * 2)


def numbers_that_never_grow(patch):
    for kind in (HeldSignal, IntegratedSignal):
        right = kind.radii
        patch.setattr(kind, "radii", lambda self, half, right=right: (right(self, half)[0], 0.0 * half[:, 0]))


def numbers_that_are_never_told(patch):
    right = HeldSignal.radii
    patch.setattr(HeldSignal, "radii", lambda self, half: (0.0 * half[:, 0], right(self, half)[1]))


@pytest.mark.parametrize(
    ("mutate", "name"),
    [
        (share_left_out, "second_order"),
        (turns_that_do_not_move_the_place, "second_order_linear"),
        (numbers_that_never_grow, "second_order"),
        (numbers_that_are_never_told, "second_order_linear"),
    ],
)
def test_runs_catch_an_error_that_is_left_out(mutate, name, monkeypatch):
    mutate(monkeypatch)
    assert largest_misses(name).max() > 1e-3


def test_ends_widen_where_something_is_added_alone():
    strayed = Strayed(np.array([0.1]), np.array([0.0]), np.array([[0.2]]))
    ends = np.array([[0.0, 0.0, 0.0]]), np.array([[1.0, 1.0, 1.0]])
    lower, upper = strayed.widened(ends, strayed.states[:, :3])
    assert (lower[0, :2] < -0.1).all()
    assert (upper[0, :2] > 1.1).all()
    assert (lower[0, 2], upper[0, 2]) == (0.0, 1.0)
    assert strayed.nearer(2.0) >= 0.1
    assert replace(strayed, turned=np.array([0.3])).nearer(2.0) >= 0.7
