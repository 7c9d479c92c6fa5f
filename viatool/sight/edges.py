"""Edges in the fan of a LiDAR, anywhere in boxes of poses; see `sight` for the derivation."""

from __future__ import annotations

import numpy as np

from viatool.arrays import Booleans, Floats, Plane
from viatool.sets.forms import PoseBoxes
from viatool.sight.glimpses import Glimpses, Rays, half_angle, turning_error
from viatool.sight.shapes import Shapes
from viatool.world import Lidar

_GRAZING = 1.55
"""Angle to the normal in radians from which on an edge is bounded by its ends alone."""


def see_edges(boxes: PoseBoxes, shapes: Shapes, lidar: Lidar, slack: float) -> Glimpses:
    """Return what every ray that may meet an edge reads of it. **Sound:** yes."""
    edge = shapes.second - shapes.first
    normal = -1j * edge / np.abs(edge)  # away from a robot that stands to the left
    first, second = (ends - boxes.places[:, None] for ends in (shapes.first, shapes.second))  # (C, M)
    distance = normal.real * first.real + normal.imag * first.imag
    spread = np.abs(normal.real) * boxes.radius[:, 0, None] + np.abs(normal.imag) * boxes.radius[:, 1, None]
    beyond, behind = distance - spread >= lidar.maximum_range + slack, distance + spread <= -slack
    near = ~(beyond | behind)
    rays = Rays.between(boxes, lidar, *_bearings(boxes, first, second, distance, slack), near)
    at = (rays.box, rays.shape)
    missed, crossed, least, most = _between_ends(rays, first[at], second[at], slack)
    d, d_spread, n = distance[at], spread[at], normal[rays.shape]
    certain = crossed & (d > d_spread + slack) & ~shapes.passed[1][rays.shape]
    aim = np.conj(rays.along) * n
    phi = np.abs(np.angle(aim)) + rays.turn
    oblique = phi < _GRAZING
    secant = 1.0 / np.where(oblique, aim.real, 1.0)
    tangent = np.where(oblique, aim.imag, 0.0) * secant
    t = d * secant
    below, above = secant_rest(d, d_spread, np.where(oblique, phi, 0.0), rays.turn, slack)
    slope = np.stack([-secant * n.real, -secant * n.imag, -t * tangent]) * rays.radius.T
    w_first, w_second = (np.conj(rays.along) * ends[at] for ends in (first, second))
    met = oblique & (w_first.imag <= 0.0) & (w_second.imag >= 0.0) & (d > 0.0)
    return Glimpses(
        row=rays.row,
        nearest=np.where(met, t, np.inf),
        slope=np.where(oblique, slope, 0.0),
        lower=np.where(missed, np.inf, np.where(oblique, t - below, -np.inf)),
        upper=np.where(oblique, t + above, np.inf),
        least=np.where(missed, np.inf, np.maximum(least, 0.0) - slack),
        most=most + slack,
        certain=certain,
    )


def secant_rest(
    d: Floats, d_spread: Floats, phi: Floats, turn: Floats, slack: float
) -> tuple[Floats, Floats]:
    """Bound how far ``(d - n.D) sec`` falls below and rises above its linear form, for angles up to phi; (T,) each."""
    steep = 1.0 / np.cos(phi)
    first_order = steep * np.sqrt(np.maximum(np.square(steep) - 1.0, 0.0))
    second_order = 0.5 * np.square(turn) * steep * (2.0 * np.square(steep) - 1.0)
    mixed = d_spread * turn * first_order + slack * np.square(steep)
    return mixed + np.maximum(-d, 0.0) * second_order, mixed + np.maximum(d, 0.0) * second_order


def _bearings(
    boxes: PoseBoxes, first: Plane, second: Plane, distance: Floats, slack: float
) -> tuple[Floats, Floats]:
    """Return bearings (C, M) between which every ray lies that meets an edge from some pose."""
    reach, turn = boxes.extent[:, None], boxes.turn[:, None] + slack
    headings = boxes.centre[:, 2, None]
    far_first, far_second = np.abs(first), np.abs(second)
    close = (distance <= reach + slack) | (np.minimum(far_first, far_second) <= reach + slack)
    begin = np.angle(first) - headings
    before, after = (half_angle(reach + slack, far) for far in (far_first, far_second))
    low, high = begin - before - turn, begin + np.angle(second * np.conj(first)) + after + turn
    middle = 0.5 * (first + second)
    around = half_angle(0.5 * np.abs(second - first) + reach + slack, np.abs(middle)) + turn
    towards = np.angle(middle) - headings
    return np.where(close, towards - around, low), np.where(close, towards + around, high)


def _between_ends(
    rays: Rays, first: Plane, second: Plane, slack: float
) -> tuple[Booleans, Booleans, Floats, Floats]:
    """Return whether all poses miss an edge, whether all meet it if it faces them, and the least and largest a."""
    left, right, nearer, farther = [], [], [], []
    sideways, forward = rays.spread(1j * rays.along) + slack, rays.spread(rays.along) + slack
    for end in (first, second):
        w, error = np.conj(rays.along) * end, turning_error(np.abs(end), rays)
        b_spread = sideways + np.abs(w.real) * rays.turn + error
        a_spread = forward + np.abs(w.imag) * rays.turn + error
        left.append(w.imag + b_spread)
        right.append(w.imag - b_spread)
        nearer.append(w.real - a_spread)
        farther.append(w.real + a_spread)
    most = np.maximum(*farther)
    missed = (right[0] > 0.0) | (left[1] < 0.0) | (most < 0.0)
    return missed, (left[0] < 0.0) & (right[1] > 0.0), np.minimum(*nearer), most
