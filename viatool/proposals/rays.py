"""A LiDAR and what commonly follows it, told by the sum of their sizes."""

from __future__ import annotations

import math
from typing import Any

from viatool.proposals.layout import PI, Channel, one, scan
from viatool.proposals.proposal import Guess

_SCANS: dict[int, tuple[dict[str, Any], str]] = {
    1080: (
        {"field_of_view": round(1.5 * PI, 9), "rays": 1080, "maximum_range": 10.0},
        "over 270 degrees, to 10 m",
    ),
    720: (
        {"field_of_view": round(1.5 * PI, 9), "rays": 720, "maximum_range": 10.0},
        "over 270 degrees, to 10 m",
    ),
    512: ({"field_of_view": PI, "rays": 512, "maximum_range": 6.0}, "over 180 degrees, to 6 m"),
    360: (
        {"start": 0.0, "step": round(2.0 * math.pi / 360, 9), "rays": 360, "maximum_range": 3.5},
        "once around from straight ahead, counter-clockwise, to 3.5 m",
    ),
    180: ({"field_of_view": PI, "rays": 180, "maximum_range": 10.0}, "over 180 degrees, to 10 m"),
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
        {"field_of_view": PI, "rays": 180, "bins": 20, "maximum_range": 7.0},
        "each the least of nine over 180 degrees, to 7 m",
    ),
}


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
    }.get(count)


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
                    meaning=True,
                ),
                Guess(f"the {rays} rays are {words}", "angle_min, angle_increment, range_max of the scan"),
            )
            return [scan(rays, lidar, unit="m", **stack), *rest], guesses
    return None
