"""Other readings of a scan: in which direction its rays follow each other, and where they begin."""

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
