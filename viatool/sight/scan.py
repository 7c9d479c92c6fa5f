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
4. *A thin obstacle* may be passed by any ray, or seen by it: its parts bound a bin from below, and never from above.

A shape that hides another needs no rule: the least range counts.

5. *Rays that return nothing.* Whichever k rays of a bin are lost, one of those k + 1 is left whose upper bounds are the
   least: the bin then reads at most the (k + 1)-th least upper bound of its rays, and at least what it reads else.

6. *What may be elsewhere* is somewhere within a region. A range is at least what it would be if the whole region were
   solid, and at most what it would be without the thing: the lower form of the one and the upper form of the other
   hold it. Bins, whatever they make of their rays, do not fall when ranges grow.

7. *Jumps.* Where some pose sees a near thing and some pose one behind it, a bin reads either, and nothing in between.
   Of the poses at which it reads at most b, less than the maximum range, what is read is met, and not beyond b: the
   reading is at most the largest of the upper bounds of what may be so near. Of those at which it reads at least a,
   nothing is met that is surely nearer than a. So with b = a in the gap each side has a form as tight as that of one
   thing alone.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from viatool.arrays import Booleans, Floats
from viatool.rounding import SIGHT_ROUNDING, SLIGHTLY_MORE, UNIT_ROUNDOFF
from viatool.sets.forms import Forms, PoseBoxes
from viatool.sight.circles import see_circles
from viatool.sight.compiled import fan_of, gaps, scan
from viatool.sight.edges import see_edges
from viatool.sight.glimpses import Glimpses
from viatool.sight.shapes import Shapes
from viatool.sight.windows import Gaps, Windows
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
        Its rays, bins and limits. Where something may be elsewhere, what it reads without a return is no less than
        its maximum range.

    Returns
    -------
    Forms
        (C, bins) readings in metres, clipped to the LiDAR's limits.

    Notes
    -----
    Sound: yes, by the derivation of the module; rounding is counted. Cost: O(C (K + M)) and O(1) for each ray and shape
    that may meet.
    """
    return enclose_losing(boxes, shapes, lidar, 0)[0]


def enclose_losing(
    boxes: PoseBoxes, shapes: Shapes, lidar: Lidar, lost: int, windows: Windows | None = None
) -> tuple[Forms, Floats]:
    """Enclose the bins of a perfect LiDAR, and bound what they read when rays return nothing.

    Parameters
    ----------
    boxes, shapes, lidar
        As in `enclose_scan`.
    lost : int
        How many rays return nothing, whichever they are.
    windows : Windows, optional
        Which poses count, where `has_gaps`, and no ray is lost; elsewhere all do.

    Returns
    -------
    Forms
        (C, bins), of bins of which every ray returns.
    ndarray
        (C, bins) metres: a bin that is the least of its rays reads at most so much when the others return; of other
        bins the maximum range, or what a ray reads without a return if that is more.

    Notes
    -----
    Sound: yes; of what may be elsewhere, rays are bounded without it.
    """
    windows = windows if has_gaps(shapes, lidar) else None
    if windows is None and len(boxes) > 1:  # cells that differ in what was commanded before see the same
        some, which = boxes.distinct()
        if len(some) < len(boxes):
            seen, most = enclose_losing(some, shapes, lidar, lost)
            return seen.select(which), most[which]
    seen, most = _enclose(boxes.checked(), shapes, lidar, lost, windows)
    if shapes.without is None:
        return seen, most
    far, most = _enclose(boxes, shapes.without, lidar, lost, None)
    return _spanning(seen, far), most


def has_gaps(shapes: Shapes, lidar: Lidar) -> bool:
    """Tell whether poses are told apart by what bins read there: by the least of rays, of things that stay in place."""
    return lidar.reduce == "minimum" and lidar.no_return is None and shapes.without is None


def gaps_of(boxes: PoseBoxes, shapes: Shapes, lidar: Lidar) -> Gaps:
    """Return what bins (C, bins) never read between what they read at some poses and at others."""
    slack, fan = _slack(boxes, shapes, lidar), fan_of(shapes, lidar)
    if fan is not None:
        found, done = gaps(fan, boxes, slack)
        if done.all():
            return found
    parts = _glimpses(boxes, shapes, lidar, slack)
    return Gaps.between(Glimpses.concatenate(parts), len(boxes), lidar.bins, lidar.maximum_range)


def _spanning(near: Forms, far: Forms) -> Forms:
    """Return forms (C, bins) of readings between what is read at most and at least of what may be there.

    Notes
    -----
    Sound: yes, for readings that do not fall when something is taken away. A thing that may be anywhere within some
    region hides no more than the region, and no less than nothing.
    """
    apart = np.abs(far.slope - near.slope).sum(axis=1)
    low, high = near.centre - near.rest, far.centre + far.rest + apart
    rest = np.maximum(0.5 * (high - low), near.rest) * SLIGHTLY_MORE
    sloped, flat = Forms(0.5 * (low + high), near.slope, rest), Forms.between(near.lower, far.upper)
    flat = Forms(flat.centre, np.zeros_like(near.slope), np.maximum(flat.rest, near.rest) * SLIGHTLY_MORE)
    same = (near.centre == far.centre) & (near.rest == far.rest) & (apart == 0.0)
    return Forms.where(
        same, near, Forms.where(flat.upper - flat.lower <= sloped.upper - sloped.lower, flat, sloped)
    )


def _slack(boxes: PoseBoxes, shapes: Shapes, lidar: Lidar) -> float:
    """Return what covers the rounding of ranges, in metres."""
    size = float(np.abs(boxes.centre).max(initial=0.0))
    return SIGHT_ROUNDING * (shapes.scale + lidar.maximum_range + size)


def _enclose(
    boxes: PoseBoxes, shapes: Shapes, lidar: Lidar, lost: int, windows: Windows | None
) -> tuple[Forms, Floats]:
    """Enclose the bins where all shapes are there, and bound them without some rays."""
    slack = _slack(boxes, shapes, lidar)
    if lidar.reduce == "minimum" and lidar.no_return is None:
        if not lost:
            return _seen(boxes, shapes, lidar, slack, windows), _no_limit(len(boxes), lidar, slack)
        parts = _glimpses(boxes, shapes, lidar.unreduced, slack)
        each = _most_of_rays(parts, len(boxes), lidar, slack)
        binned = [replace(part, row=part.row // lidar.each) for part in parts]
        return _bins(binned, len(boxes), lidar, slack), _most_without(each, lidar, lost, slack)
    if lidar.no_return is None:
        rays = _seen(boxes, shapes, lidar.unreduced, slack)
    else:
        parts = _glimpses(boxes, shapes, lidar.unreduced, slack)
        rays, met = _bins(parts, len(boxes), lidar.unreduced, slack), _met(parts, len(boxes), lidar.unreduced)
        rays = _without_return(rays, met, lidar.maximum_range - 4.0 * slack, lidar.no_return)
    seen = {"minimum": _least, "mean": _mean, "first": _each}[lidar.reduce](rays, lidar.bins)
    if lidar.reduce != "minimum":
        return seen, _no_limit(len(boxes), lidar, slack)
    return seen, _most_without(rays.upper, lidar, lost, slack)


def _seen(
    boxes: PoseBoxes, shapes: Shapes, lidar: Lidar, slack: float, windows: Windows | None = None
) -> Forms:
    """Enclose bins that are the least of their rays, by the compiled engine where it is there."""
    fan = fan_of(shapes, lidar)
    if fan is None:
        return _bins(_glimpses(boxes, shapes, lidar, slack), len(boxes), lidar, slack, windows)
    forms, done = scan(fan, boxes, slack, windows)
    left = np.flatnonzero(~done)
    if left.size:
        some = boxes.select(left)
        of_some = None if windows is None else windows.select(left)
        found = _bins(_glimpses(some, shapes, lidar, slack), len(some), lidar, slack, of_some)
        forms.centre[left], forms.slope[left], forms.rest[left] = found.centre, found.slope, found.rest
    return forms


def _glimpses(boxes: PoseBoxes, shapes: Shapes, lidar: Lidar, slack: float) -> list[Glimpses]:
    """Return what rays may meet."""
    return [see_circles(boxes, shapes, lidar, slack), see_edges(boxes, shapes, lidar, slack)]


def _met(parts: list[Glimpses], count: int, lidar: Lidar) -> Booleans:
    """Tell in which bins anything may be met, (C, bins)."""
    met = np.zeros(count * lidar.bins, dtype=bool)
    for part in parts:
        missed = np.isposinf(part.lower) & np.isposinf(part.least)  # NaN is none
        met[part.row[~missed]] = True
    return met.reshape(count, lidar.bins)


def _most_of_rays(parts: list[Glimpses], count: int, lidar: Lidar, slack: float) -> Floats:
    """Bound from above what each ray reads, (C, rays), of what each ray may meet."""
    most = _no_limit(count, lidar.unreduced, slack).ravel()
    for part in parts:
        sure = part.select(part.certain)
        np.fmin.at(most, sure.row, sure.ends[1] + 2.0 * slack)
    return np.maximum(most, lidar.minimum_range).reshape(count, lidar.rays)


def _most_without(rays: Floats, lidar: Lidar, lost: int, slack: float) -> Floats:
    """Bound from above what bins (C, bins) read without so many rays, of bounds of all of them (C, rays)."""
    each = rays.reshape(len(rays), lidar.bins, -1)
    if lost >= each.shape[2]:
        return _no_limit(len(rays), lidar, slack)
    return np.asarray(np.partition(each, lost, axis=2)[:, :, lost])


def _no_limit(count: int, lidar: Lidar, slack: float) -> Floats:
    """Return what bins (C, bins) read at most, whatever is around and whether or not anything returns."""
    nothing = lidar.maximum_range if lidar.no_return is None else lidar.no_return
    return np.full((count, lidar.bins), max(lidar.maximum_range, nothing) + 2.0 * slack)


def _without_return(rays: Forms, met: Booleans, limit: float, reading: float) -> Forms:
    """Let rays that meet nothing read a number: surely where nothing may be met, perhaps from a limit on."""
    hull = Forms.between(np.minimum(rays.lower, reading), np.maximum(rays.upper, reading))
    none = Forms.between(np.full_like(rays.centre, reading), np.full_like(rays.centre, reading))
    return Forms.where(met, Forms.where(rays.upper >= limit, hull, rays), none)


def _each(rays: Forms, bins: int) -> Forms:
    """Return rays as they are: one for each bin."""
    return rays


def _mean(rays: Forms, bins: int) -> Forms:
    """Return the means of consecutive rays, as a program in float32 may sum them."""
    count, symbols = rays.slope.shape[:2]
    size = np.maximum(np.abs(rays.lower), np.abs(rays.upper)).reshape(count, bins, -1)
    rounded = (2 + size.shape[2]) * UNIT_ROUNDOFF["float32"] * size.max(axis=2)
    return Forms(
        rays.centre.reshape(count, bins, -1).mean(axis=2),
        rays.slope.reshape(count, symbols, bins, -1).mean(axis=3),
        (rays.rest.reshape(count, bins, -1).mean(axis=2) + rounded) * SLIGHTLY_MORE,
    )


def _least(rays: Forms, bins: int) -> Forms:
    """Return the least of consecutive rays, relative to the ray whose middle is the least."""
    count, symbols = rays.slope.shape[:2]
    centre, rest = rays.centre.reshape(count, bins, -1), rays.rest.reshape(count, bins, -1)
    slope = rays.slope.reshape(count, symbols, bins, -1)
    chosen = centre.argmin(axis=2)[:, :, None]
    reference = np.take_along_axis(slope, chosen[:, None], axis=3)
    spread = np.abs(slope - reference).sum(axis=1) + rest
    low, high = (centre - spread).min(axis=2), (centre + spread).min(axis=2)
    return Forms(0.5 * (low + high), reference[:, :, :, 0], 0.5 * (high - low) * SLIGHTLY_MORE)


def _bins(
    parts: list[Glimpses], count: int, lidar: Lidar, slack: float, windows: Windows | None = None
) -> Forms:
    """Take the minimum of every bin relative to its reference, of the poses that count."""
    size, limit = count * lidar.bins, lidar.maximum_range
    nearer = np.zeros(size, dtype=bool)
    if windows is not None:
        parts = [windows.may_read(part, slack) for part in parts]
        nearer = windows.upper.ravel() < limit - slack
    slope = _references(parts, size, limit, nearer)
    # Everything from here on is relative to the reference: what a range exceeds `slope . pose` by.
    spread = np.abs(slope).sum(axis=0)
    low, high, met = limit - spread, limit + spread, np.full(size, -np.inf)
    for part in parts:
        reference = slope[:, part.row]
        apart = _apart(part.slope, reference)
        around = np.abs(reference).sum(axis=0)
        most = np.minimum(part.upper + apart, part.most + around)
        np.minimum.at(low, part.row, np.maximum(part.lower - apart, part.least - around))
        np.minimum.at(high, part.row[part.certain], most[part.certain])
        np.maximum.at(met, part.row, most)
    if windows is not None:
        high = np.where(nearer & (met > -np.inf), np.minimum(high, met), high)
        low = np.maximum(low, windows.lower.ravel() - spread)
        high = np.maximum(
            np.minimum(high, windows.upper.ravel() + spread), low
        )  # crossed where no pose counts
    low, high = low - slack, high + slack
    forms = Forms(0.5 * (low + high), slope, 0.5 * (high - low) + slack)
    return _clipped(forms, count, lidar)


def _references(parts: list[Glimpses], size: int, limit: float, nearer: Booleans) -> Floats:
    """Return the slopes (3, size) of what bins read at the middle pose, or, where that is nearer, could read there."""
    middle, slope = np.full(size, limit), np.zeros((3, size))
    values = [np.where(nearer[part.row], np.maximum(part.lower, part.least), part.nearest) for part in parts]
    for part, value in zip(parts, values, strict=True):
        np.minimum.at(middle, part.row, value)
    for part, value in zip(parts, values, strict=True):
        chosen = np.flatnonzero(value <= middle[part.row])
        chosen = chosen[value[chosen] < limit]
        slope[:, part.row[chosen]] = part.slope[:, chosen]
    return slope


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
