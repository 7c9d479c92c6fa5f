"""Robots whose velocity changes, once more: their velocity at an instant, and their path by many small steps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from viatool.motion.kinematics import motion_of
from viatool.world import Robot

LOW, HIGH, TURN = -0.4, 1.0, 1.5
WHEELBASE, STEERING, RATE = 0.33, 0.6, 1.3
ROBOT = Robot(
    min_linear=LOW, max_linear=HIGH, max_angular=TURN, wheelbase=WHEELBASE, max_steering=STEERING,
    min_acceleration=-3.0, max_acceleration=2.0, max_angular_acceleration=4.0,
)  # fmt: skip
NAMES = ("second_order_linear", "second_order_angular", "second_order", "second_order_ackermann", "ackermann")


def robot_of(name):
    return replace(ROBOT, kinematics=name, max_steering_rate=RATE if name == "ackermann" else 0.0)


MOVES = [motion_of(robot_of(name)) for name in NAMES]


def grown(begin, rate, time, low, high):
    """What grows until it is at its limit; one that began beyond stays there, or comes back."""
    return np.maximum(np.minimum(begin + rate * time, np.maximum(begin, high)), np.minimum(begin, low))


def velocity(name, held, time):
    """Speed ahead and turning speed after times (B, T) of what is held (B, H), (B, T) each."""
    first, second, state = held[:, 0, None], held[:, 1, None], held[:, 2, None]
    still = 0.0 * time
    if name == "second_order_linear":
        return grown(state, first, time, LOW, HIGH), second + still
    if name == "second_order_angular":
        return first + still, grown(state, second, time, -TURN, TURN)
    if name == "second_order":
        return grown(state, first, time, LOW, HIGH), grown(held[:, 3, None], second, time, -TURN, TURN)
    if name == "second_order_ackermann":
        ahead = grown(state, first, time, LOW, HIGH)
        return ahead, ahead * np.tan(second) / WHEELBASE
    assert name == "ackermann"
    way = second - state
    angle = state + np.sign(way) * np.minimum(np.abs(way), RATE * time)
    return first + still, first * np.tan(angle) / WHEELBASE


def path(name, poses, held, seconds, interval=np.inf, pieces=2000):
    """Poses (B, pieces + 1, 3) at equal times until seconds (B,): small arcs of the velocity in their middle."""
    middle = (np.arange(pieces) + 0.5) / pieces * seconds[:, None]
    ahead, turn = velocity(name, held, np.minimum(middle, interval))
    fine = seconds[:, None] / pieces
    heading = np.cumsum(np.column_stack([poses[:, 2], turn * fine]), axis=1)
    mean = 0.5 * (heading[:, :-1] + heading[:, 1:])
    x = np.cumsum(np.column_stack([poses[:, 0], ahead * fine * np.cos(mean)]), axis=1)
    y = np.cumsum(np.column_stack([poses[:, 1], ahead * fine * np.sin(mean)]), axis=1)
    return np.stack([x, y, heading], axis=2)


def whole(name, held, interval, deceleration, rim):
    """How long the path of what is held lasts, (B,), with braking from the velocity at the end of the interval."""
    ahead, turn = velocity(name, held, np.full((len(held), 1), interval))
    stop = 0.0 if deceleration is None else 0.5 / deceleration
    return interval + stop * (np.abs(ahead) + rim * np.abs(turn))[:, 0]
