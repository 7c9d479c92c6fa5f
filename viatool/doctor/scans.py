"""Other readings of a scan: its rays' order, where they begin and how far they span, and what no return reads."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

from viatool.channels import LidarSpecification
from viatool.doctor.interpretation import Background, Variants, reads, with_observation
from viatool.policy import PolicySpecification
from viatool.policy.specification import ObservationChannel

Sensor = Callable[[LidarSpecification], LidarSpecification]
_OTHER = {"counter_clockwise": "clockwise", "clockwise": "counter_clockwise"}
_OPENINGS = (360, 270, 180)
"""Degrees over which scanners of the field look."""
_SHORT = 1e-4
"""Radians by which the last ray of a full turn misses the first one where that is there twice."""
_QUARTERS = {90: 0.5 * math.pi, 180: math.pi, -90: -0.5 * math.pi}


@reads("order of the rays")
def rays_the_other_way(spec: PolicySpecification, around: Background) -> Variants:
    """Yield the scan's mirror image, and the other way round from the same first ray where that is another one."""
    if _lidars(spec):
        yield "rays in reversed order", _with_scan(spec, _mirrored)
        if any(lidar.start is not None for lidar in _lidars(spec)):
            yield "rays the other way from the same start", _with_scan(spec, _turned_over)


@reads("start of the scan")
def scan_turned(spec: PolicySpecification, around: Background) -> Variants:
    """Yield scans that begin a quarter turn, or half a turn, elsewhere."""
    if _lidars(spec):
        for degrees, angle in _QUARTERS.items():
            side = "right" if degrees < 0 else "left"
            words = (
                "scan begins on the other side" if degrees == 180 else f"scan a quarter turn further {side}"
            )
            yield words, _with_scan(spec, partial(_rotated, angle=angle))


@reads("span of the scan")
def scan_spans(spec: PolicySpecification, around: Background) -> Variants:
    """Yield scans over a full turn, with the first ray once and twice, and over 270 and 180 degrees.

    As far as the rays' number is plausible: they would be whole or half degrees apart, or a whole number to the degree.
    """
    sensors = _lidars(spec)
    if not sensors or min(sensor.rays for sensor in sensors) < 2:
        return
    for degrees in _OPENINGS:
        for gaps, words in (
            (0, ""),
            (-1, ", the last ray where the first is" if degrees == 360 else ", both ends seen"),
        ):
            if all(_is_plausible(degrees, sensor.rays + gaps) for sensor in sensors):
                change = partial(_spread, span=math.radians(degrees), gaps=gaps)
                yield f"scan over {degrees} degrees{words}", _with_scan(spec, change)


@reads("rays without a return")
def rays_without_return(spec: PolicySpecification, around: Background) -> Variants:
    """Yield rays that meet nothing and read the maximum range, 0, or the minimum range."""
    for words, number in (("the maximum range", "maximum"), ("0", 0.0), ("the minimum range", None)):

        def changed(lidar: LidarSpecification, number: str | float | None = number) -> LidarSpecification:
            return lidar.model_copy(update={"no_return": lidar.minimum_range if number is None else number})

        if _lidars(spec):
            yield f"rays without a return read {words}", _with_scan(spec, changed)


@reads("smallest range")
def ranges_from(spec: PolicySpecification, around: Background) -> Variants:
    """Yield ranges that are not cut at their lower end, and such that are cut at the robot's smallest range."""
    for least in dict.fromkeys((0.0, around.robot.lidar.minimum_range)):

        def changed(lidar: LidarSpecification, least: float = least) -> LidarSpecification:
            return lidar.model_copy(update={"minimum_range": least})

        if all(least < lidar.maximum_range for lidar in _lidars(spec)) and _lidars(spec):
            yield f"ranges from {least:g} m on", _with_scan(spec, changed)


def _is_plausible(degrees: float, gaps: int) -> bool:
    """Tell whether so many equal gaps over an opening are a round number of degrees each, or of them to a degree."""
    step = degrees / max(gaps, 1)
    return min(abs(size - round(size)) for size in (2.0 * step, 1.0 / step)) < 1e-9 and step < degrees


def _spread(lidar: LidarSpecification, span: float, gaps: int) -> LidarSpecification:
    """Return the sensor with its rays spread over another angle: a full turn from the same first ray, else about it."""
    rays = lidar.rays
    if lidar.angles is not None:
        first, second = lidar.angles[0], lidar.angles[min(1, rays - 1)]
        order = "clockwise" if second < first else "counter_clockwise"
        was = abs(second - first) * rays
        lidar = lidar.model_copy(update={"angles": None, "start": first, "step": was / rays, "order": order})
    lidar = _stepped(lidar)
    assert lidar.start is not None
    assert lidar.step is not None
    side = -1.0 if lidar.order == "clockwise" else 1.0
    full = 2.0 * math.pi - 1e-9
    was = lidar.step * rays
    if span >= full:
        short = _SHORT if gaps else 0.0
        start = lidar.start if was >= 0.99 * full else -side * math.pi
        return lidar.model_copy(update={"start": start, "step": (span - short) / (rays + gaps)})
    ahead = 0.0 if was >= 0.99 * full else lidar.start + 0.5 * side * lidar.step * (rays - 1)
    step = span / (rays + gaps)
    return lidar.model_copy(update={"start": ahead - 0.5 * side * step * (rays - 1), "step": step})


def _lidars(spec: PolicySpecification) -> list[LidarSpecification]:
    return [c.lidar for c in spec.observation if c.lidar is not None and c.value is None]


def _with_scan(spec: PolicySpecification, change: Sensor) -> PolicySpecification:
    def changed(channel: ObservationChannel) -> ObservationChannel:
        if channel.lidar is None:
            return channel
        return channel.model_copy(update={"lidar": change(channel.lidar)})

    return with_observation(spec, changed)


def _mirrored(lidar: LidarSpecification) -> LidarSpecification:
    """Return the sensor that sees the mirror image: every ray looks to the other side."""
    if lidar.angles is not None:
        return lidar.model_copy(update={"angles": tuple(-angle for angle in lidar.angles)})
    start = None if lidar.start is None else -lidar.start
    return lidar.model_copy(update={"order": _OTHER[lidar.order], "start": start})


def _turned_over(lidar: LidarSpecification) -> LidarSpecification:
    """Return the sensor whose rays go the other way round from the same first ray."""
    if lidar.start is None:
        return _mirrored(lidar)
    return lidar.model_copy(update={"order": _OTHER[lidar.order]})


def _rotated(lidar: LidarSpecification, angle: float) -> LidarSpecification:
    """Return the sensor turned to the left by an angle in radians."""
    if lidar.angles is not None:
        return lidar.model_copy(update={"angles": tuple(_wrapped(each + angle) for each in lidar.angles)})
    lidar = _stepped(lidar)
    assert lidar.start is not None
    return lidar.model_copy(update={"start": _wrapped(lidar.start + angle)})


def _stepped(lidar: LidarSpecification) -> LidarSpecification:
    """Return the sensor with its rays given by start and step."""
    if lidar.field_of_view is None:
        return lidar
    full = lidar.field_of_view > 2.0 * math.pi - 1e-3
    step = lidar.field_of_view / (lidar.rays if full else max(lidar.rays - 1, 1))
    side = -1.0 if lidar.order == "clockwise" else 1.0
    start = -0.5 * side * lidar.field_of_view
    return lidar.model_copy(update={"field_of_view": None, "start": start, "step": step})


def _wrapped(angle: float) -> float:
    """Return an angle in (-pi, pi], without the dust of adding quarter turns."""
    turned = math.pi - (math.pi - angle) % (2.0 * math.pi)
    return 0.0 if abs(turned) < 1e-12 else turned
