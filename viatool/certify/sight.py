"""What a LiDAR reads anywhere in a box of poses: every bin as a linear form of the pose with a guaranteed rest.

Notation. A pose of the box is the middle pose plus (dx, dy, dtheta); D = (dx, dy), rho = its largest length, tau = the
largest |dtheta|. In the frame of a ray with direction u, a point at q from the robot is ``w = conj(u) q = a + i b``: a
along the ray, b to its left. At another pose of the box

    w(D, dtheta) = e^(-i dtheta) (w - conj(u) D) = w - conj(u) D - i dtheta w + rest,   |rest| <= |q| tau^2/2 + rho tau = E.

1. *Circles* (centre c, radius r). A ray hits if a > 0 and |b| <= r, at ``a - h(b)`` with ``h(b) = sqrt(r^2 - b^2)``. As h is
   concave, for every slope s and all |b| <= r

       h(b) <= s b + r sqrt(1 + s^2)                                    (a tangent)
       h(b) >= s b + min over the ends of [h(b) - s b]                  (a chord)

   and ``a - s b = Re((1 + i s) w)`` is linear up to ``sqrt(1 + s^2) E``.
2. *Edges* (unit normal n away from the robot, distance d of their line). A ray hits if the first end is to its right and the
   second to its left, at ``d sec(phi)``, phi the angle from the ray to n. With ``d = d_0 - n.D`` and ``phi = phi_0 - dtheta``,
   Taylor's theorem gives the linear form ``t_0 - sec(phi_0) n.D - t_0 tan(phi_0) dtheta`` and a rest between
   ``-|n.D| tau max|sec'|`` and ``d_0 tau^2/2 max sec'' + |n.D| tau max|sec'|`` (sec'' > 0). Seen nearly along the edge, and where only
   a part of the edge is in the fan, the ends bound the range: it lies between the least and the largest a of both ends.
3. *A bin* reads the least range of its rays, and at most the maximum range. Its reference is the form of the shape that is
   nearest at the middle pose. Every shape that some pose may hit bounds the bin from below where it is hit; every shape that
   all poses hit bounds it from above. Both are bounds relative to the reference, so that where all poses see the same wall
   hardly more than the second order is left.

A shape that hides another needs no rule: the least range counts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from viatool.certify.poses import ROUNDING, Forms, PoseBoxes
from viatool.certify.shapes import Shapes
from viatool.world import Lidar

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]
Plane = NDArray[np.complex128]
Booleans = NDArray[np.bool_]

_STEEPEST = 32.0
"""Largest slope s of the linear forms of circles, so that no rounding is amplified."""
_GRAZING = 1.5
"""Angle to the normal in radians from which on an edge is bounded by its ends alone."""


@dataclass(frozen=True, eq=False)
class _Glimpses:
    """T rays that may meet a shape somewhere in a box.

    Parameters
    ----------
    row : ndarray
        (T,) ``box * bins + bin``.
    nearest : ndarray
        (T,) range at the middle pose; infinite if the ray misses there.
    slope : ndarray
        (3, T) scaled slopes of the linear form.
    lower, upper : ndarray
        (T,) constants of the forms below and above the range; the upper one is infinite where a pose may miss.
    least, most : ndarray
        (T,) bounds that do not depend on the pose.
    """

    row: Indices
    nearest: Floats
    slope: Floats
    lower: Floats
    upper: Floats
    least: Floats
    most: Floats


def enclose_scan(boxes: PoseBoxes, shapes: Shapes, lidar: Lidar) -> Forms:
    """Enclose the bins of a perfect LiDAR at every pose of boxes.

    Parameters
    ----------
    boxes : PoseBoxes
        C boxes. Poses within an obstacle or off the arena are none.
    shapes : Shapes
        What is around.
    lidar : Lidar
        Its rays, bins and limits.

    Returns
    -------
    Forms
        (C, bins) readings in metres, clipped to the LiDAR's limits.

    Notes
    -----
    Sound: yes, by the derivation of the module; rounding is counted. Cost: O(C (K + M)) and O(1) for each ray and shape
    that may meet.
    """
    slack = ROUNDING * (shapes.scale + lidar.maximum_range + float(np.abs(boxes.centre).max(initial=0.0)))
    parts = [_circle_glimpses(boxes, shapes, lidar, slack), _edge_glimpses(boxes, shapes, lidar, slack)]
    scaled = boxes.radius.T
    return _bins(parts, scaled, len(boxes), lidar, slack)


def _bins(parts: list[_Glimpses], scaled: Floats, count: int, lidar: Lidar, slack: float) -> Forms:
    """Take the minimum of every bin relative to its reference."""
    size, limit = count * lidar.bins, lidar.maximum_range
    middle = np.full(size, limit)
    for part in parts:
        np.minimum.at(middle, part.row, part.nearest)
    slope = np.zeros((3, size))
    for part in parts:
        chosen = np.flatnonzero(part.nearest <= middle[part.row])
        chosen = chosen[part.nearest[chosen] < limit]
        slope[:, part.row[chosen]] = part.slope[:, chosen]
    # Everything from here on is relative to the reference: what a range exceeds `slope . pose` by.
    spread = np.abs(slope).sum(axis=0)
    low, high = limit - spread, limit + spread
    for part in parts:
        reference = slope[:, part.row]
        apart = np.abs(part.slope - reference).sum(axis=0)
        around = np.abs(reference).sum(axis=0)
        np.minimum.at(low, part.row, np.maximum(part.lower - apart, part.least - around))
        np.minimum.at(high, part.row, np.minimum(part.upper + apart, part.most + around))
    low, high = low - slack, high + slack
    forms = Forms(0.5 * (low + high), slope, 0.5 * (high - low) + slack)
    return _clipped(forms, count, lidar)


def _clipped(forms: Forms, count: int, lidar: Lidar) -> Forms:
    """Lift bins that may fall below the minimum range, and put the bins of a box on one axis."""
    centre, rest = forms.centre.reshape(count, lidar.bins), forms.rest.reshape(count, lidar.bins)
    slope = np.moveaxis(forms.slope.reshape(3, count, lidar.bins), 0, 1)
    shaped = Forms(centre, slope, rest)
    short = shaped.lower < lidar.minimum_range
    if not short.any():
        return shaped
    flat = Forms.between(*(np.maximum(end, lidar.minimum_range) for end in (shaped.lower, shaped.upper)))
    return Forms(
        np.where(short, flat.centre, centre),
        np.where(short[:, None], 0.0, slope),
        np.where(short, flat.rest, rest),
    )


def _circle_glimpses(boxes: PoseBoxes, shapes: Shapes, lidar: Lidar, slack: float) -> _Glimpses:
    away = shapes.centres - boxes.places[:, None]  # (C, K)
    distance, reach = np.abs(away), boxes.extent[:, None]
    heading = np.angle(away) - boxes.centre[:, 2, None]
    grown = shapes.radii + reach + slack
    half = _arcsine(grown, distance) + boxes.turn[:, None] + slack
    near = distance - grown < lidar.maximum_range
    box, shape, ray = _rays_between(heading - half, heading + half, near, lidar)
    along, w = _frame(boxes, box, ray, away[box, shape], lidar)
    error = _turning_error(boxes, box, distance[box, shape])
    a, b, radius = w.real, w.imag, shapes.radii[shape]
    b_spread = _spread(boxes, box, 1j * along) + np.abs(a) * boxes.turn[box] + error + slack
    a_spread = _spread(boxes, box, along) + np.abs(b) * boxes.turn[box] + error + slack
    certain = (np.abs(b) + b_spread < radius) & (a > a_spread)
    hits = (np.abs(b) <= radius) & (a > 0.0)
    ends = [np.clip(b + sign * b_spread, -radius, radius) for sign in (-1.0, 1.0)]
    heights = [np.sqrt((radius - np.abs(end)) * (radius + np.abs(end))) for end in ends]
    total = heights[0] + heights[1]
    s = np.where(total > 0.0, -(ends[0] + ends[1]) / np.where(total > 0.0, total, 1.0), 0.0)
    s = np.clip(s, -_STEEPEST, _STEEPEST)
    size = np.sqrt(1.0 + np.square(s))
    value, rest = a - s * b, size * (error + slack)
    chord = np.minimum(heights[0] - s * ends[0], heights[1] - s * ends[1])
    slope = _slopes(boxes, box, (1.0 + 1j * s), along, w)
    depth = np.sqrt(np.maximum(np.square(radius) - np.square(b), 0.0))
    # A ray that misses on both sides of the middle touches at most: it must not pass for a hit.
    missed = (np.abs(b) - b_spread > radius) | (a + a_spread < 0.0)
    return _Glimpses(
        box * lidar.bins + ray // (lidar.rays // lidar.bins),
        np.where(hits, a - depth, np.inf),
        slope,
        np.where(missed, np.inf, value - radius * size - rest),
        np.where(certain, value - chord + rest, np.inf),
        np.where(missed, np.inf, np.maximum(distance[box, shape] - radius - reach[box, 0], 0.0) - slack),
        np.where(certain, distance[box, shape] + reach[box, 0] + slack, np.inf),
    )


def _edge_glimpses(boxes: PoseBoxes, shapes: Shapes, lidar: Lidar, slack: float) -> _Glimpses:
    places, headings, reach = boxes.places[:, None], boxes.centre[:, 2, None], boxes.extent[:, None]
    edge = shapes.second - shapes.first
    normal = -1j * edge / np.abs(edge)  # away from a robot that stands to the left
    first, second = shapes.first - places, shapes.second - places  # (C, M)
    distance = normal.real * first.real + normal.imag * first.imag
    range_first, range_second = np.abs(first), np.abs(second)
    spread = np.abs(normal.real) * boxes.radius[:, 0, None] + np.abs(normal.imag) * boxes.radius[:, 1, None]
    near = (distance - spread < lidar.maximum_range + slack) & (distance + spread > -slack)
    close = (distance <= reach + slack) | (range_first <= reach + slack) | (range_second <= reach + slack)
    begin, turn = np.angle(first) - headings, boxes.turn[:, None] + slack
    before, after = (_arcsine(reach, away) for away in (range_first, range_second))
    low, high = begin - before - turn, begin + np.angle(second * np.conj(first)) + after + turn
    middle = 0.5 * (first + second)
    around = _arcsine(0.5 * np.abs(edge) + reach, np.abs(middle)) + turn
    towards = np.angle(middle) - headings
    low, high = np.where(close, towards - around, low), np.where(close, towards + around, high)
    box, shape, ray = _rays_between(low, high, near, lidar)
    along, w_first = _frame(boxes, box, ray, first[box, shape], lidar)
    w_second = np.conj(along) * second[box, shape]
    d, d_spread, tau = distance[box, shape], spread[box, shape], boxes.turn[box]
    sideways, forward = _spread(boxes, box, 1j * along) + slack, _spread(boxes, box, along) + slack
    left, right, least, most = [], [], np.full(len(box), np.inf), np.full(len(box), -np.inf)
    for w, far in ((w_first, range_first), (w_second, range_second)):
        error = _turning_error(boxes, box, far[box, shape])
        b_spread = sideways + np.abs(w.real) * tau + error
        a_spread = forward + np.abs(w.imag) * tau + error
        left.append(w.imag + b_spread)
        right.append(w.imag - b_spread)
        least, most = np.minimum(least, w.real - a_spread), np.maximum(most, w.real + a_spread)
    missed = (right[0] > 0.0) | (left[1] < 0.0) | (most < 0.0)
    certain = (left[0] < 0.0) & (right[1] > 0.0) & (d > d_spread + slack)
    aim = np.conj(along) * normal[shape]
    phi = np.abs(np.angle(aim)) + tau
    oblique = phi < _GRAZING
    secant = 1.0 / np.where(oblique, aim.real, 1.0)
    steep = 1.0 / np.cos(np.where(oblique, phi, 0.0))
    tangent = np.where(oblique, aim.imag, 0.0) * secant
    t = d * secant
    first_order, second_order = steep * np.sqrt(np.maximum(np.square(steep) - 1.0, 0.0)), steep * (2.0 * np.square(steep) - 1.0)
    mixed = d_spread * tau * first_order
    curved = np.maximum(d, 0.0) * np.square(tau) * 0.5 * second_order
    bound = slack * np.square(steep)
    behind = np.maximum(-d, 0.0) * np.square(tau) * 0.5 * second_order
    slope = np.stack(
        [
            -secant * normal[shape].real * boxes.radius[box, 0],
            -secant * normal[shape].imag * boxes.radius[box, 1],
            -t * tangent * tau,
        ]
    )
    slope[:, ~oblique] = 0.0
    hits = oblique & (w_first.imag <= 0.0) & (w_second.imag >= 0.0) & (d > 0.0)
    return _Glimpses(
        box * lidar.bins + ray // (lidar.rays // lidar.bins),
        np.where(hits, t, np.inf),
        slope,
        np.where(missed, np.inf, np.where(oblique, t - mixed - behind - bound, -np.inf)),
        np.where(certain & oblique, t + curved + mixed + bound, np.inf),
        np.where(missed, np.inf, np.maximum(least, 0.0) - slack),
        np.where(certain, most + slack, np.inf),
    )


def _arcsine(radius: Floats, distance: Floats) -> Floats:
    """Return half the angle that a disc fills when seen from a distance; pi from within."""
    outside = distance > radius
    return np.where(outside, np.arcsin(np.minimum(radius / np.where(outside, distance, 1.0), 1.0)), np.pi)


def _rays_between(low: Floats, high: Floats, near: Booleans, lidar: Lidar) -> tuple[Indices, Indices, Indices]:
    """Return box, shape and ray, (T,) each, of all rays between two bearings (C, N), wherever they are near."""
    box, shape = np.nonzero(near)
    low, high = low[box, shape], high[box, shape]
    half = 0.5 * lidar.field_of_view if lidar.rays > 1 else 0.0
    step = lidar.field_of_view / max(lidar.rays - 1, 1)
    found = []
    high = np.minimum(high, low + 2.0 * np.pi)
    offset = 2.0 * np.pi * np.floor((low + half) / (2.0 * np.pi))  # the bearing low lies in [-half, 2 pi - half)
    for shift in (0.0, 2.0 * np.pi):
        begin = np.ceil((low - offset - shift + half) / step - 1e-6)
        end = np.floor((high - offset - shift + half) / step + 1e-6)
        begin = np.clip(begin, 0, lidar.rays).astype(np.int64)
        if shift:  # the second turn must not repeat a ray of the first
            end = np.minimum(end, np.clip(first_begin - 1, -1, lidar.rays))
        else:
            first_begin = begin
        count = np.maximum(np.clip(end, -1, lidar.rays - 1).astype(np.int64) - begin + 1, 0)
        which = np.repeat(np.arange(len(box)), count)
        ray = np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count) + begin[which]
        found.append((box[which], shape[which], ray))
    return tuple(np.concatenate(parts) for parts in zip(*found, strict=True))  # type: ignore[return-value]


def _frame(boxes: PoseBoxes, box: Indices, ray: Indices, away: Plane, lidar: Lidar) -> tuple[Plane, Plane]:
    """Return the directions u of rays, and points in the frames of the rays."""
    along = np.exp(1j * (boxes.centre[box, 2] + lidar.angles()[ray]))
    return along, np.conj(along) * away


def _turning_error(boxes: PoseBoxes, box: Indices, distance: Floats) -> Floats:
    """Return E, what the linear form of a point in the frame of a ray leaves out."""
    turn = boxes.turn[box]
    return np.asarray(0.5 * distance * np.square(turn) + boxes.extent[box] * turn)


def _spread(boxes: PoseBoxes, box: Indices, direction: Plane) -> Floats:
    """Return the largest ``|direction . D|``."""
    radius = boxes.radius[box]
    return np.asarray(np.abs(direction.real) * radius[:, 0] + np.abs(direction.imag) * radius[:, 1])


def _slopes(boxes: PoseBoxes, box: Indices, factor: Plane, along: Plane, w: Plane) -> Floats:
    """Return the scaled slopes (3, T) of ``Re(factor w)``."""
    moved, radius = factor * np.conj(along), boxes.radius[box]
    return np.stack([-moved.real * radius[:, 0], moved.imag * radius[:, 1], (factor * w).imag * radius[:, 2]])
