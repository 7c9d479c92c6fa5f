"""Which terms of the error model each job takes into account; every other term it refuses by name."""

from __future__ import annotations

MOTION = frozenset(
    f"actuation.{term}" for term in ("acceleration", "deceleration", "lag", "relative", "absolute", "slip")
) | frozenset(f"timing.{term}" for term in ("interval", "delay", "sensing"))
"""Motors and timing; of robots that are told how to accelerate `viatool.setting.motors` says which."""

_SENSOR = frozenset(f"sensor.{term}" for term in ("absolute", "relative", "bias", "angle", "missing", "thin"))
"""All that may be wrong with readings."""

_DRAWN = frozenset(
    f"{section}.{term}"
    for section, terms in (
        ("sensor", ("absolute", "relative", "bias", "missing")),
        ("pose", ("x", "y", "theta")),
        ("start", ("x", "y", "theta")),
    )
    for term in terms
)
_POSE = frozenset({"pose.x", "pose.y", "pose.theta"})
_START = frozenset({"start.x", "start.y", "start.theta"})

_SHOWN = frozenset({"obstacles.speed", "obstacles.named", "obstacles.roams"})
"""Moving things that the map shows."""
_MOVING = _SHOWN | frozenset(f"obstacles.{term}" for term in ("returns", "people", "hidden", "behind"))

_OVER_SETS = _SENSOR | _POSE
"""What is enclosed wherever the closed loop is followed from sets of states."""

SUPPORTED: dict[str, frozenset[str]] = {
    "verify": _SENSOR | MOTION | _POSE | _MOVING,
    "verify with a horizon": _OVER_SETS | _START | MOTION | _SHOWN,
    "certify": _SENSOR | MOTION | _POSE | _SHOWN,
    "monitor": _SENSOR | _POSE | _START | {"obstacles.roams"},
    "mission": _OVER_SETS | _START | MOTION | _SHOWN,
    "simulate": _DRAWN | MOTION | _SHOWN | _SENSOR | {"obstacles.people"},
    "simulate with bullet": _DRAWN,
    "simulate with bullet and an analytic LiDAR": _DRAWN | _SENSOR,
}
