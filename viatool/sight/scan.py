"""What a LiDAR reads anywhere in a box of poses: every bin as a linear form of the pose with a guaranteed rest.

Notation. A pose of the box is the middle pose plus (dx, dy, dtheta); D = (dx, dy), rho = its largest length, tau
= the largest |dtheta|. In the frame of a ray with direction u, a point at q from the robot is
``w = conj(u) q = a + i b``: a along the ray, b to its left. At another pose of the box

    w(D, dtheta) = e^(-i dtheta) (w - conj(u) D) = w - conj(u) D - i dtheta w + rest,

with ``|rest| <= E = |q| tau^2 / 2 + rho tau``.

1. *Circles* (centre c, radius r). A ray hits if a > 0 and |b| <= r, at ``a - h(b)``, ``h(b) = sqrt(r^2 - b^2)``.
   As h is concave, for every slope s and all |b| <= r

       h(b) <= s b + r sqrt(1 + s^2)                                    (a tangent)
       h(b) >= s b + min over the ends of [h(b) - s b]                  (a chord)

   and ``a - s b = Re((1 + i s) w)`` is linear up to ``sqrt(1 + s^2) E``.
2. *Edges* (unit normal n away from the robot, distance d of their line). A ray hits if the first end is to its
   right and the second to its left, at ``d sec(phi)``, phi the angle from the ray to n. With ``d = d_0 - n.D``
   and ``phi = phi_0 - dtheta``, Taylor's theorem gives the linear form
   ``t_0 - sec(phi_0) n.D - t_0 tan(phi_0) dtheta`` and a rest between ``-|n.D| tau max|sec'|`` and
   ``d_0 tau^2 / 2 max sec'' + |n.D| tau max|sec'|``, as sec'' > 0. Whatever the angle, the range lies between
   the least and the largest a of both ends, of which the point that is hit is a mean.
3. *A bin* reads the least range of its rays, and at most the maximum range. Its reference is the form of what is
   nearest at the middle pose. Every shape that some pose may hit bounds the bin from below where it is hit;
   every shape that all poses hit bounds it from above. Both are bounds relative to the reference, so that where
   all poses see the same wall hardly more than the second order is left.

A shape that hides another needs no rule: the least range counts.
"""

from __future__ import annotations

import numpy as np

from viatool.arrays import Floats
from viatool.rounding import SIGHT_ROUNDING
from viatool.sets.forms import Forms, PoseBoxes
from viatool.sight.circles import see_circles
from viatool.sight.edges import see_edges
from viatool.sight.glimpses import Glimpses
from viatool.sight.shapes import Shapes
from viatool.world import Lidar


def enclose_scan(boxes: PoseBoxes, shapes: Shapes, lidar: Lidar) -> Forms:
    """Enclose the bins of a perfect LiDAR at every pose of boxes.

    Parameters
    ----------
    boxes : PoseBoxes
        C boxes. Poses within an obstacle or off the arena do not count.
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
    slack = SIGHT_ROUNDING * (
        shapes.scale + lidar.maximum_range + float(np.abs(boxes.centre).max(initial=0.0))
    )
    boxes.checked()
    parts = [see_circles(boxes, shapes, lidar, slack), see_edges(boxes, shapes, lidar, slack)]
    return _bins(parts, len(boxes), lidar, slack)


def _bins(parts: list[Glimpses], count: int, lidar: Lidar, slack: float) -> Forms:
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
        apart = _apart(part.slope, reference)
        around = np.abs(reference).sum(axis=0)
        np.minimum.at(low, part.row, np.maximum(part.lower - apart, part.least - around))
        np.minimum.at(high, part.row, np.minimum(part.upper + apart, part.most + around))
    low, high = low - slack, high + slack
    forms = Forms(0.5 * (low + high), slope, 0.5 * (high - low) + slack)
    return _clipped(forms, count, lidar)


def _apart(slope: Floats, reference: Floats) -> Floats:
    """Return by how much two forms with scaled slopes (3, T) may differ more than at the middle pose."""
    return np.asarray(np.abs(slope - reference).sum(axis=0))


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
