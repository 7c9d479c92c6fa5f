"""What goes into a policy and comes out of it, as a proposal states it: channels by common name."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from viatool.proposals.proposal import Guess

Channel = dict[str, Any]

PI = round(math.pi, 9)
"""With as many digits as people write."""


@dataclass(frozen=True)
class Layout:
    """One project's observation and action.

    Parameters
    ----------
    project : str
        Its name, as people know it.
    observation, action : list of dict
        As they stand in a specification.
    outputs : int
        Of the network.
    guesses : tuple of Guess
        What differs between its versions and settings.
    about_action : tuple of Guess
        The same of its commands.
    """

    project: str
    observation: list[Channel]
    action: list[Channel]
    outputs: int
    guesses: tuple[Guess, ...]
    about_action: tuple[Guess, ...]

    @property
    def inputs(self) -> int:
        """Return the length of its observation."""
        return sum(size_of(channel) for channel in self.observation)


def size_of(channel: Channel) -> int:
    """Return how many inputs a channel takes, all its frames included."""
    return int(channel.get("size", 1)) * int(channel.get("frames", {}).get("count", 1))


def one(name: str, kind: str | None = None, **more: Any) -> Channel:
    """Return a channel of one number; its kind is its name where none is given."""
    return {"name": name, "kind": kind or name, **more}


def scan(rays: int, lidar: dict[str, Any], **more: Any) -> Channel:
    """Return a LiDAR channel that is left with so many numbers."""
    return {"name": "lidar", "kind": "lidar", "size": rays, **more, "lidar": lidar}


def twist(linear: tuple[float, float], angular: float, scaled: bool) -> list[Channel]:
    """Return a speed and a turning speed; scaled from [-1, 1] if asked for."""
    return [
        command("linear", "m/s", linear, scaled),
        command("angular", "rad/s", (-angular, angular), scaled),
    ]


def command(kind: str, unit: str, limits: tuple[float, float], scaled: bool) -> Channel:
    """Return an action within limits; what is scaled comes in [-1, 1]."""
    lower, upper = limits
    stretch = {"scale": (upper - lower) / 2.0, "offset": (upper + lower) / 2.0} if scaled else {}
    return {"name": kind, "unit": unit, "kind": kind, "lower": lower, "upper": upper, **stretch}


VECTORS: dict[str, tuple[Channel, ...]] = {
    "base_lin_vel": (
        one("linear_velocity", unit="m/s"),
        one("lateral_velocity", unit="m/s"),
        one("vertical_velocity", "constant", value=0.0),
    ),
    "base_ang_vel": (
        one("roll_rate", "constant", value=0.0),
        one("pitch_rate", "constant", value=0.0),
        one("angular_velocity", unit="rad/s"),
    ),
    "projected_gravity": (
        one("gravity_x", "constant", value=0.0),
        one("gravity_y", "constant", value=0.0),
        one("gravity_z", "constant", value=-1.0),
    ),
    "pose_command": (
        one("goal_x", unit="m"),
        one("goal_y", unit="m"),
        one("goal_height", "constant", value=0.0),
        one("goal_heading", "other", unit="rad"),
    ),
}
"""Vectors of Isaac Lab and mjlab, in the robot's frame, for a robot that stays upright on flat ground."""
