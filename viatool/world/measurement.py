"""Exact distances of points and segments from circles, edges and areas, in batches.

Points are complex numbers x + iy in metres; all arguments of a function are broadcast against each other.
Sound: under rounding only; nothing is approximated, results are those of float64 arithmetic to nearest.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from viatool.arrays import Booleans, Floats, Plane


def as_plane(points: Floats) -> Plane:
    """Return points (..., 2) as complex numbers (...)."""
    return np.asarray(points[..., 0] + 1j * points[..., 1])


def dot(first: Plane, second: Plane) -> Floats:
    """Return the dot products of vectors."""
    return np.asarray(first.real * second.real + first.imag * second.imag)


def cross(first: Plane, second: Plane) -> Floats:
    """Return the cross products of vectors, positive if the second points to the left of the first."""
    return np.asarray(first.real * second.imag - first.imag * second.real)


def point_edge_squared(points: Plane, first: Plane, second: Plane) -> Floats:
    """Return the squared distances of points from the edges between two ends, m^2."""
    edge, away = second - first, points - first
    square = dot(edge, edge)
    along = np.clip(dot(edge, away) / np.where(square > 0.0, square, 1.0), 0.0, 1.0)
    rest = away - along * edge
    return dot(rest, rest)


def segments_cross(starts: Plane, ends: Plane, first: Plane, second: Plane) -> Booleans:
    """Tell which segments cross the interior of which edges; mere touching is left to the distances."""
    edge, segment = second - first, ends - starts
    apart = cross(edge, starts - first) * cross(edge, ends - first) < 0.0
    return np.asarray(apart & (cross(segment, first - starts) * cross(segment, second - starts) < 0.0))


def segment_edge_squared(starts: Plane, ends: Plane, first: Plane, second: Plane) -> Floats:
    """Return the squared distances between segments and edges, in m^2; 0 where they meet."""
    nearest = np.minimum(point_edge_squared(starts, first, second), point_edge_squared(ends, first, second))
    np.minimum(nearest, point_edge_squared(first, starts, ends), out=nearest)
    np.minimum(nearest, point_edge_squared(second, starts, ends), out=nearest)
    nearest[segments_cross(starts, ends, first, second)] = 0.0
    return nearest


def winding_number(points: Plane, first: Plane, second: Plane) -> NDArray[np.int64]:
    """Return how often closed rings run counter-clockwise around points.

    Parameters
    ----------
    points : ndarray
        (B,).
    first, second : ndarray
        (M, B) or (M, 1) ends of all edges of the rings, in any order.

    Returns
    -------
    ndarray
        (B,) int; at least 1 inside any of several counter-clockwise rings, which may overlap.
    """
    left = cross(second - first, points - first)
    below, below_second = first.imag <= points.imag, second.imag <= points.imag
    upward = below & ~below_second & (left > 0.0)
    downward = ~below & below_second & (left < 0.0)
    return np.asarray(upward.sum(axis=0) - downward.sum(axis=0), dtype=np.int64)
