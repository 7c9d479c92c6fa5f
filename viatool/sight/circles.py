"""Circles in the fan of a LiDAR, anywhere in boxes of poses; see `sight` for the derivation."""

from __future__ import annotations

import numpy as np

from viatool.arrays import Floats
from viatool.sets.forms import PoseBoxes
from viatool.sight.glimpses import Glimpses, Rays, half_angle, turning_error
from viatool.sight.shapes import Shapes
from viatool.world import Lidar

_STEEPEST = 32.0
"""Largest slope of the linear forms, so that no rounding is amplified."""


def see_circles(boxes: PoseBoxes, shapes: Shapes, lidar: Lidar, slack: float) -> Glimpses:
    """Return what every ray that may meet a circle reads of it. **Sound:** yes."""
    away = shapes.centres - boxes.places[:, None]  # (C, K)
    distance = np.abs(away)
    grown = shapes.radii + boxes.extent[:, None] + slack
    heading = np.angle(away) - boxes.centre[:, 2, None]
    half = half_angle(grown, distance) + boxes.turn[:, None] + slack
    near = ~(distance - grown >= lidar.maximum_range)
    rays = Rays.between(boxes, lidar, heading - half, heading + half, near)
    w, far = np.conj(rays.along) * away[rays.box, rays.shape], distance[rays.box, rays.shape]
    error, radius = turning_error(far, rays), shapes.radii[rays.shape]
    a, b = w.real, w.imag
    b_spread = rays.spread(1j * rays.along) + np.abs(a) * rays.turn + error + slack
    a_spread = rays.spread(rays.along) + np.abs(b) * rays.turn + error + slack
    missed = (np.abs(b) - b_spread > radius) | (a + a_spread < 0.0)
    certain = (np.abs(b) + b_spread < radius) & (a > a_spread) & ~shapes.passed[0][rays.shape]
    s, tangent, chord = height_bounds(b, b_spread, radius)
    value, rest = a - s * b, np.sqrt(1.0 + np.square(s)) * (error + slack)
    depth = np.sqrt(np.maximum(np.square(radius) - np.square(b), 0.0))
    return Glimpses(
        row=rays.row,
        nearest=np.where((np.abs(b) <= radius) & (a > 0.0), a - depth, np.inf),
        slope=rays.slopes(np.asarray(1.0 + 1j * s, dtype=np.complex128), w),
        lower=np.where(missed, np.inf, value - tangent - rest),
        upper=value - chord + rest,
        least=np.where(missed, np.inf, np.maximum(far - radius - rays.reach, 0.0) - slack),
        most=far + rays.reach + slack,
        certain=certain,
    )


def height_bounds(b: Floats, spread: Floats, radius: Floats) -> tuple[Floats, Floats, Floats]:
    """Bound ``h(b) = sqrt(r^2 - b^2)`` by lines of one slope for all b within a spread where the circle is met.

    Returns
    -------
    tuple of ndarray
        (T,) slope s, and the constants of ``s b + constant`` above (a tangent) and below (the chord).
    """
    ends = [np.clip(b + sign * spread, -radius, radius) for sign in (-1.0, 1.0)]
    heights = [np.sqrt((radius - np.abs(end)) * (radius + np.abs(end))) for end in ends]
    total = heights[0] + heights[1]
    s = np.where(total > 0.0, -(ends[0] + ends[1]) / np.where(total > 0.0, total, 1.0), 0.0)
    s = np.clip(s, -_STEEPEST, _STEEPEST)
    chord = np.minimum(heights[0] - s * ends[0], heights[1] - s * ends[1])
    return s, radius * np.sqrt(1.0 + np.square(s)), chord
