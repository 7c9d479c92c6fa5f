"""Other readings of numbers that are observed: their side, their unit, and how they were normalised."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

from viatool.doctor.interpretation import Background, Variants, reads, with_observation
from viatool.policy import PolicySpecification
from viatool.policy.specification import ObservationChannel

_SIDEWAYS = ("goal_sine", "goal_bearing", "goal_y")
"""Kinds whose sign says on which side the goal is."""
_ANGLES = ("goal_bearing", "heading")
_LENGTHS = ("goal_distance", "goal_x", "goal_y", "goal_x_map", "goal_y_map")
_UNSIGNED = ("lidar", "goal_distance")

Kinds = tuple[str, ...]
Map = tuple[float, float]
"""Scale and offset."""


@reads("side of the goal")
def goal_mirrored(spec: PolicySpecification, around: Background) -> Variants:
    """Yield the goal on the other side."""
    if _has(spec, _SIDEWAYS):

        def mirrored(channel: ObservationChannel) -> Map:
            return -channel.scale, channel.offset

        yield "bearing mirrored", _with(spec, _SIDEWAYS, mirrored, clip=True)


@reads("unit of angles")
def angles_in_another_unit(spec: PolicySpecification, around: Background) -> Variants:
    """Yield angles in radians, in degrees and as shares of half a turn."""
    units = {"radians": 1.0, "degrees": 180.0 / math.pi, "half turns": 1.0 / math.pi}
    for unit, scale in units.items():
        if _has(spec, _ANGLES):

            def converted(channel: ObservationChannel, scale: float = scale) -> Map:
                return math.copysign(scale, channel.scale), 0.0

            yield f"angles in {unit}", _with(spec, _ANGLES, converted)


@reads("scale of the LiDAR")
def ranges_normalised(spec: PolicySpecification, around: Background) -> Variants:
    """Yield ranges in metres, and normalised by the maximum range."""
    limit = _maximum_range(spec, around)
    yield from _normalised(spec, ("lidar",), "ranges", {"the maximum range": limit})


@reads("scale of lengths to the goal")
def lengths_normalised(spec: PolicySpecification, around: Background) -> Variants:
    """Yield lengths in metres, and normalised by the maximum range and by the diagonal of the map."""
    limits = {"the maximum range": _maximum_range(spec, around), "the map's diagonal": around.extent.diagonal}
    yield from _normalised(spec, _LENGTHS, "goal lengths", limits)


@reads("scale of the previous command")
def previous_command_normalised(spec: PolicySpecification, around: Background) -> Variants:
    """Yield the command before in physical units, as the network gave it, and normalised by its limits."""
    actions = {f"previous_{action.kind}": action for action in spec.action}
    kinds = tuple(actions)
    if not _has(spec, kinds):
        return
    maps: Mapping[str, Mapping[str, Map]] = {
        "in physical units": dict.fromkeys(kinds, (1.0, 0.0)),
        "as the network gave it": {
            kind: (1.0 / action.scale, -action.offset / action.scale) for kind, action in actions.items()
        },
        "normalised to [-1, 1]": {
            kind: _onto(action.lower, action.upper)
            for kind, action in actions.items()
            if action.lower < action.upper
        },
    }
    for words, each in maps.items():

        def mapped(channel: ObservationChannel, each: Mapping[str, Map] = each) -> Map:
            return each.get(channel.kind, (channel.scale, channel.offset))

        yield f"previous command {words}", _with(spec, kinds, mapped)


def _normalised(spec: PolicySpecification, kinds: Kinds, what: str, limits: Mapping[str, float]) -> Variants:
    """Yield lengths in metres, as shares of a limit, and from -1 to 1."""
    if not _has(spec, kinds):
        return

    def in_metres(channel: ObservationChannel) -> Map:
        return math.copysign(1.0, channel.scale), 0.0

    yield f"{what} in metres", _with(spec, kinds, in_metres)
    for name, limit in limits.items():

        def shares(channel: ObservationChannel, limit: float = limit) -> Map:
            return math.copysign(1.0 / limit, channel.scale), 0.0

        def from_minus_one(channel: ObservationChannel, limit: float = limit) -> Map:
            return (2.0 / limit, -1.0) if channel.kind in _UNSIGNED else shares(channel, limit)

        yield f"{what} divided by {name}", _with(spec, kinds, shares)
        yield f"{what} by {name} to [-1, 1]", _with(spec, kinds, from_minus_one)


def _maximum_range(spec: PolicySpecification, around: Background) -> float:
    """Return the largest range that a LiDAR of the policy reads, or the robot's."""
    own = [channel.lidar.maximum_range for channel in spec.observation if channel.lidar is not None]
    return max(own, default=around.robot.lidar.maximum_range)


def _has(spec: PolicySpecification, kinds: Kinds) -> bool:
    return any(channel.kind in kinds and channel.value is None for channel in spec.observation)


def _with(
    spec: PolicySpecification,
    kinds: Kinds,
    encoded: Callable[[ObservationChannel], Map],
    *,
    clip: bool = False,
) -> PolicySpecification:
    """Return a specification that encodes the channels of some kinds otherwise; their clip goes, unless it is kept."""

    def changed(channel: ObservationChannel) -> ObservationChannel:
        if channel.kind not in kinds or channel.reciprocal:
            return channel
        scale, offset = encoded(channel)
        kept = channel.clip if clip else None
        return channel.model_copy(update={"scale": scale, "offset": offset + 0.0, "clip": kept})

    return with_observation(spec, changed)


def _onto(lower: float, upper: float) -> Map:
    """Return the map of a range onto [-1, 1]."""
    scale = 2.0 / (upper - lower)
    return scale, -1.0 - scale * lower
