"""Closed outlines: mended or refused where they are made, and then measured.

A ring is an (n, 2) array of corners in metres, the first not repeated. Whatever measures it may rely on what
`simple_polygon` has checked: finite numbers, every edge longer than `LEAST_EDGE`, an inside, and no point passed twice.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from viatool.arrays import Booleans, Floats
from viatool.errors import MapError

LEAST_EDGE = 1e-9
"""Corners that are nearer to each other, in metres, are one corner; an outline that is thinner has no inside."""

LARGEST = 1e6
"""No coordinate is larger, in metres: more than that is a slip, and squares of it lose digits."""


def simple_polygon(points: ArrayLike, name: str = "polygon") -> Floats:
    """Return corners as a simple counter-clockwise ring.

    Parameters
    ----------
    points : array_like
        (n, 2) corners in metres, in either direction. A corner that repeats the one before it, within `LEAST_EDGE`, is
        dropped, and so is the first one where it stands at the end again.
    name : str
        What to call the polygon in an error.

    Returns
    -------
    ndarray
        (m, 2), m at most n.

    Raises
    ------
    MapError
        If a number is not finite or too large, if fewer than three corners or no area are left, or if it crosses or
        touches itself.

    Notes
    -----
    Sound: an exactly repeated corner changes nothing; a nearly repeated one moves the outline by at most `LEAST_EDGE`.
    """
    ring = without_repeats(finite_points(points, name), closed=True)
    if len(ring) < 3:
        raise MapError(f"{name} has {len(ring)} distinct corners, expected at least 3", "add the corners")
    if signed_area(ring) < 0.0:
        ring = ring[::-1].copy()
    if not _is_plainly_convex(ring):
        _check_simple(ring, name)
    if not 2.0 * signed_area(ring) > LEAST_EDGE * np.hypot(*_along(ring).T).sum():
        raise MapError(f"{name} has no area", "move its corners apart")
    return ring


def _is_plainly_convex(ring: Floats) -> bool:
    """Tell whether a ring turns left at every corner, by far more than rounding, and once around: it is simple then."""
    along = _along(ring)
    edges = along[:, 0] + 1j * along[:, 1]
    turns = np.angle(np.roll(edges, -1) / edges)
    return bool(turns.min() > 1e-6 and turns.sum() < 3.0 * np.pi)


def _check_simple(ring: Floats, name: str) -> None:
    """Refuse a ring that crosses or touches itself."""
    from shapely import Polygon, is_valid_reason

    outline = Polygon(ring)
    if not outline.is_valid:
        reason = str(is_valid_reason(outline)).replace("[", " at (").replace("]", ")").replace(" )", ")")
        raise MapError(
            f"{name} is not a simple polygon: {reason}",
            "list the corners once around the outline, without crossing or touching it",
        )


def _along(ring: Floats) -> Floats:
    """Return the edges of a ring as vectors, (n, 2)."""
    return np.asarray(np.roll(ring, -1, axis=0) - ring)


def finite_points(points: ArrayLike, name: str) -> Floats:
    """Return points (n, 2) as float64, refusing by name what is not a point on a map.

    Raises
    ------
    MapError
        If they are not pairs of numbers, or a number is not finite or larger than `LARGEST`.
    """
    try:
        given = np.asarray(points, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise MapError(
            f"{name} has corners that are not points (x, y)", "give two numbers for each"
        ) from error
    if given.ndim != 2 or given.shape[1] != 2:
        raise MapError(
            f"{name} has corners of shape {given.shape}, expected points (x, y)", "give two numbers for each"
        )
    wrong = np.flatnonzero(~fit(given).all(axis=1))
    if wrong.size:
        raise MapError(
            f"{name} has {tuple(given[wrong[0]].tolist())} as corner {wrong[0]}, expected finite numbers of at "
            f"most {LARGEST:g} m",
            "correct the corner",
        )
    return given


def fit(lengths: ArrayLike) -> Booleans:
    """Tell which numbers may be a length or a coordinate: neither NaN nor larger than `LARGEST`."""
    return np.asarray(np.abs(lengths) <= LARGEST)


def without_repeats(points: Floats, *, closed: bool) -> Floats:
    """Return a line of points (n, 2) without those within `LEAST_EDGE` of the last one that was kept.

    Of a closed line the points at the end that repeat the first one are dropped as well.
    """
    apart = np.hypot(*(points - np.roll(points, 1, axis=0)).T) > LEAST_EDGE
    if apart.all():
        return points
    kept = [points[0]]
    for point in points[1:]:
        if np.hypot(*(point - kept[-1])) > LEAST_EDGE:
            kept.append(point)
    while closed and len(kept) > 1 and np.hypot(*(kept[-1] - kept[0])) <= LEAST_EDGE:
        kept.pop()
    return np.array(kept)


def ring_edges(ring: Floats) -> Floats:
    """Return the edges of one closed ring of n corners, (n, 4)."""
    return np.concatenate([ring, np.roll(ring, -1, axis=0)], axis=1)


def ring_width(ring: Floats) -> float:
    """Return the least distance of two parallel lines with a ring between them, in metres."""
    import shapely

    hull = shapely.get_coordinates(shapely.MultiPoint(ring).convex_hull)
    along = np.diff(hull, axis=0)
    normals = np.stack([-along[:, 1], along[:, 0]]) / np.hypot(*along.T)
    heights = hull @ normals  # (corners, edges): one of the lines lies along an edge of the hull
    return float((heights.max(axis=0) - heights.min(axis=0)).min())


def signed_area(ring: Floats) -> float:
    """Return the area of a ring in m^2, positive when its corners run counter-clockwise."""
    x, y = (ring - ring.mean(axis=0)).T
    return float(0.5 * np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


def centroid(ring: Floats) -> Floats:
    """Return the centre of area of a simple ring, (2,)."""
    origin = ring.mean(axis=0)
    first = ring - origin
    second = np.roll(first, -1, axis=0)
    cross = first[:, 0] * second[:, 1] - second[:, 0] * first[:, 1]
    return np.asarray(origin + ((first + second) * cross[:, None]).sum(axis=0) / (3.0 * cross.sum()))


def is_convex(ring: Floats) -> bool:
    """Tell whether a simple counter-clockwise ring is convex; straight corners are allowed."""
    along = _along(ring)
    turn = along[:, 0] * np.roll(along[:, 1], -1) - along[:, 1] * np.roll(along[:, 0], -1)
    return bool(np.all(turn >= 0.0))
