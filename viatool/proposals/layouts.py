"""Observations and commands that public projects use, told by their sizes.

What is stated of each is what its environment does, as its source says; a policy of the same sizes may well come from
another program, so everything here is a guess and is said to be one.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from viatool.proposals.proposal import Guess

Channel = dict[str, Any]

_PI = round(math.pi, 9)


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


def tail(count: int) -> list[Channel] | None:
    """Return what commonly follows the rays, by how many numbers it has; None where nothing is common."""
    goal = [one("goal_distance", unit="m"), one("goal_bearing", unit="rad")]
    direction = [goal[0], one("goal_cosine"), one("goal_sine")]
    before = [one("previous_linear", unit="m/s"), one("previous_angular", unit="rad/s")]
    return {
        2: goal,
        3: direction,
        4: [*goal, *before],
        5: [*direction, *before],
        6: [*direction, *before, one("budget")],
    }.get(count)


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


def _drlnav() -> Layout:
    diagonal = round(math.hypot(4.2, 4.2), 6)
    lidar = {"start": 0.0, "step": round(6.28 / 39, 9), "rays": 40, "maximum_range": 3.5}
    return Layout(
        "turtlebot3_drlnav",
        [
            scan(40, lidar, unit="m", scale=1.0 / 3.5),
            one("goal_distance", unit="m", scale=1.0 / diagonal, clip=[0.0, 1.0]),
            one("goal_bearing", unit="rad", scale=1.0 / _PI),
            one("previous", "previous_raw", size=2),
        ],
        twist((0.0, 0.22), 2.0, scaled=True),
        2,
        (
            Guess("the arena's diagonal is 5.94 m", "ARENA_LENGTH and ARENA_WIDTH in settings.py"),
            Guess(
                "40 rays once around from straight ahead, ending at 6.28 rad", "the LiDAR in the robot's SDF"
            ),
        ),
        (
            Guess(
                "the robot does not reverse",
                "with ENABLE_BACKWARD, linear is lower -0.22, scale 0.22, offset 0",
            ),
            Guess("the limits are 0.22 m/s and 2 rad/s", "SPEED_LINEAR_MAX and SPEED_ANGULAR_MAX"),
        ),
    )


def _gaps() -> Layout:
    return Layout(
        "DRL-robot-navigation",
        [
            scan(20, {"field_of_view": _PI, "rays": 180, "bins": 20, "maximum_range": 10.0}, unit="m"),
            one("goal_distance", unit="m"),
            one("goal_bearing", unit="rad"),
            one("previous_linear", unit="m/s"),
            one("previous_angular", unit="rad/s"),
        ],
        twist((0.0, 1.0), 1.0, scaled=True),
        2,
        (
            Guess(
                "20 gaps over the 180 degrees ahead, from right to left",
                "velodyne_callback of the environment",
            ),
        ),
        (Guess("the speed is (output + 1) / 2, up to 1 m/s", "a_in where the environment is stepped"),),
    )


def _bins() -> Layout:
    return Layout(
        "DRL-Robot-Navigation-ROS2",
        [
            scan(20, {"field_of_view": _PI, "rays": 180, "bins": 20, "maximum_range": 7.0}, unit="m"),
            one("goal_distance", unit="m"),
            one("goal_cosine"),
            one("goal_sine"),
            one("previous_linear", unit="m/s"),
            one("previous_angular", unit="rad/s"),
        ],
        twist((0.0, 0.5), 1.0, scaled=True),
        2,
        (
            Guess(
                "nothing is divided",
                "prepare_state; the IR-SIM version divides ranges by 7 and the distance by 10, and scales the command "
                "before by 2 and to (omega + 1) / 2: give `scale` and `offset`",
            ),
        ),
        (Guess("the speed is (output + 1) / 4, up to 0.5 m/s", "a_in where the environment is stepped"),),
    )


def _robotis(outputs: int = 5) -> Layout:
    ahead = [*range(12), *range(36, 48)]
    angles = [round(index * 6.28 / 47, 6) for index in ahead]
    return Layout(
        "ROBOTIS turtlebot3_dqn (ROS 2)",
        [
            one("goal_distance", unit="m"),
            one("goal_bearing", unit="rad"),
            scan(24, {"angles": angles, "maximum_range": 3.5}, unit="m"),
        ],
        [
            {
                "name": "command",
                "kind": "choice",
                "axes": ["linear", "angular"],
                "commands": [[0.2, turn] for turn in (1.5, 0.75, 0.0, -0.75, -1.5)],
            }
        ],
        outputs,
        (
            Guess(
                "the goal comes first, then 24 rays in the order 0 to 90, 270 to 360 degrees",
                "calculate_state",
            ),
            Guess(
                "the scan has 48 rays once around from straight ahead, ending at 6.28 rad",
                "angle_min of the scan",
            ),
        ),
        (Guess("the five commands are 0.2 m/s with 1.5, 0.75, 0, -0.75, -1.5 rad/s", "angular_vel"),),
    )


def _robotis_first() -> Layout:
    lidar = {"start": 0.0, "step": round(2.0 * math.pi / 24, 9), "rays": 24, "maximum_range": 3.5}
    second = _robotis()
    turns = [{**second.action[0], "commands": [[0.15, t] for t in (1.5, 0.75, 0.0, -0.75, -1.5)]}]
    return Layout(
        "ROBOTIS turtlebot3_dqn (ROS 1)",
        [
            scan(24, lidar, unit="m"),
            one("goal_bearing", unit="rad"),
            one("goal_distance", unit="m"),
            one("nearest_range", "other", unit="m"),
            one("nearest_direction", "other"),
        ],
        turns,
        5,
        (
            Guess("24 rays once around from straight ahead", "samples of the LiDAR in the robot's xacro"),
            Guess("the least range and its index come last; viatool does not fill them", "getState"),
        ),
        (
            Guess(
                "the five commands are 0.15 m/s with 1.5, 0.75, 0, -0.75, -1.5 rad/s",
                "max_angular_vel in step",
            ),
        ),
    )


def _collision_avoidance() -> Layout:
    lidar = {"field_of_view": _PI, "rays": 512, "maximum_range": 6.0}
    return Layout(
        "rl-collision-avoidance",
        [
            scan(
                512,
                lidar,
                unit="m",
                scale=1.0 / 6.0,
                offset=-0.5,
                frames={"count": 3, "order": "oldest_first"},
            ),
            one("goal_x", unit="m"),
            one("goal_y", unit="m"),
            one("linear_velocity", unit="m/s"),
            one("angular_velocity", unit="rad/s"),
        ],
        twist((0.0, 1.0), 1.0, scaled=False),
        2,
        (
            Guess(
                "three scans of 512 rays over 180 degrees, oldest first, / 6 m - 0.5", "get_laser_observation"
            ),
        ),
        (Guess("the limits are 1 m/s and 1 rad/s", "action_bound"),),
    )


LAYOUTS: tuple[Callable[[], Layout], ...] = (
    _drlnav,
    _gaps,
    _bins,
    _robotis,
    _robotis_first,
    _collision_avoidance,
)


def known_layout(inputs: int, outputs: int) -> Layout | None:
    """Return the project whose policies have these sizes; None where none is known."""
    return next(
        (layout for make in LAYOUTS if ((layout := make()).inputs, layout.outputs) == (inputs, outputs)), None
    )


_SCANS: dict[int, tuple[dict[str, Any], str]] = {
    1080: (
        {"field_of_view": round(1.5 * _PI, 9), "rays": 1080, "maximum_range": 10.0},
        "over 270 degrees, to 10 m",
    ),
    720: (
        {"field_of_view": round(1.5 * _PI, 9), "rays": 720, "maximum_range": 10.0},
        "over 270 degrees, to 10 m",
    ),
    512: ({"field_of_view": _PI, "rays": 512, "maximum_range": 6.0}, "over 180 degrees, to 6 m"),
    360: (
        {"start": 0.0, "step": round(2.0 * math.pi / 360, 9), "rays": 360, "maximum_range": 3.5},
        "once around from straight ahead, counter-clockwise, to 3.5 m",
    ),
    180: ({"field_of_view": _PI, "rays": 180, "maximum_range": 10.0}, "over 180 degrees, to 10 m"),
    40: (
        {"start": 0.0, "step": round(2.0 * math.pi / 40, 9), "rays": 40, "maximum_range": 3.5},
        "once around from straight ahead, counter-clockwise, to 3.5 m",
    ),
    36: (
        {"start": 0.0, "step": round(2.0 * math.pi / 36, 9), "rays": 36, "maximum_range": 3.5},
        "once around from straight ahead, counter-clockwise, to 3.5 m",
    ),
    24: (
        {"start": 0.0, "step": round(2.0 * math.pi / 24, 9), "rays": 24, "maximum_range": 3.5},
        "once around from straight ahead, counter-clockwise, to 3.5 m",
    ),
    20: (
        {"field_of_view": _PI, "rays": 180, "bins": 20, "maximum_range": 7.0},
        "each the least of nine over 180 degrees, to 7 m",
    ),
}


def rays_and_tail(inputs: int) -> tuple[list[Channel], tuple[Guess, ...]] | None:
    """Return a LiDAR and what commonly follows it, told by their sum; None where no sum fits."""
    for frames in (1, 3):
        for rays, (lidar, words) in _SCANS.items():
            rest = tail(inputs - frames * rays)
            if rest is None:
                continue
            stack = {"frames": {"count": frames, "order": "oldest_first"}} if frames > 1 else {}
            names = ", ".join(channel["name"] for channel in rest)
            times = f"{frames} frames of " if frames > 1 else ""
            guesses = (
                Guess(
                    f"{inputs} = {times}{rays} rays + {len(rest)}: first the LiDAR, then {names}",
                    "where the observation is put together; the order and each channel's `scale`, `offset`, `clip`",
                ),
                Guess(f"the {rays} rays are {words}", "angle_min, angle_increment, range_max of the scan"),
            )
            return [scan(rays, lidar, unit="m", **stack), *rest], guesses
    return None
