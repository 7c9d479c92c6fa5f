"""Robots that nobody sells, added through the public door; and where any robot goes, by integrating its velocity."""

from __future__ import annotations

from contextlib import contextmanager

import numpy as np

from viatool.motion.kinematics import KINEMATICS
from viatool.motion.law import Axis
from viatool.motion.twists import HeldTwist


class Crab(HeldTwist):
    """It never turns: what a policy commands as a turn slides it to its left, a metre for each radian."""

    name = "crab"
    description = "a robot that slides"
    axes = (Axis("v", "m/s", "linear"), Axis("side", "m/s", "angular"))
    velocity = ("ahead", "left")

    def limits(self, robot):
        return (
            np.array([robot.min_linear, -robot.max_angular]),
            np.array([robot.max_linear, robot.max_angular]),
        )


class Slider(HeldTwist):
    """It goes ahead and to its left, and turns."""

    name = "slider"
    description = "a robot that slides and turns"
    axes = (Axis("v", "m/s", "linear"), Axis("u", "m/s", "lateral"), Axis("omega", "rad/s", "angular"))
    velocity = ("ahead", "left", "turn")

    def limits(self, robot):
        ends = np.array([robot.max_linear, robot.max_linear, robot.max_angular])
        return -ends, ends


@contextmanager
def registered(kinematics):
    """Add a kinematics to those that are known, and take it out again."""
    KINEMATICS[kinematics.name] = kinematics
    try:
        yield kinematics
    finally:
        del KINEMATICS[kinematics.name]


def velocity_of(name, commands):
    """Speed ahead, to the left, and turning speed of commands (..., A), written down once more."""
    if name in ("differential", "ackermann"):
        return commands[..., 0], 0.0 * commands[..., 0], commands[..., 1]
    if name == "crab":
        return commands[..., 0], commands[..., 1], 0.0 * commands[..., 0]
    if name == "holonomic":
        return commands[..., 0], commands[..., 2], commands[..., 1]
    assert name == "slider"
    return commands[..., 0], commands[..., 1], commands[..., 2]


def integrated(name, poses, commands, seconds, pieces=200):
    """Where poses (B, 3) are after seconds (B,) of commands (B, A): Gauss quadrature of the velocity; not wrapped."""
    ahead, left, turn = velocity_of(name, commands)
    nodes, weights = np.polynomial.legendre.leggauss(4)
    at = (np.arange(pieces)[:, None] + 0.5 * (1.0 + nodes)).ravel() / pieces
    share = np.tile(0.5 * weights, pieces) / pieces
    time = np.asarray(seconds)[..., None] * at
    heading = poses[:, 2, None] + turn[:, None] * time
    cosine, sine = np.cos(heading) @ share, np.sin(heading) @ share
    return np.column_stack(
        [
            poses[:, 0] + seconds * (ahead * cosine - left * sine),
            poses[:, 1] + seconds * (ahead * sine + left * cosine),
            poses[:, 2] + turn * seconds,
        ]
    )
