"""Exact distances of points and segments from circles, edges and areas, in batches.

Sound: under rounding only; nothing is approximated, the results are those of float64 arithmetic to nearest.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from viatool.world.shapes import Floats

Booleans = NDArray[np.bool_]


def point_edge_squared(points: Floats, edges: Floats) -> Floats:
    """Return the squared distances of points from segments.

    Parameters
    ----------
    points : ndarray
        (..., 2) metres, broadcast against the edges.
    edges : ndarray
        (..., 4) both ends in metres; equal ends are a point.

    Returns
    -------
    ndarray
        (...) m^2.
    """
    dx, dy = edges[..., 2] - edges[..., 0], edges[..., 3] - edges[..., 1]
    px, py = points[..., 0] - edges[..., 0], points[..., 1] - edges[..., 1]
    square = dx * dx + dy * dy
    along = np.clip((px * dx + py * dy) / np.where(square > 0.0, square, 1.0), 0.0, 1.0)
    px, py = px - along * dx, py - along * dy
    return np.asarray(px * px + py * py)


def line_distance(points: Floats, edges: Floats) -> Floats:
    """Return the distance of points (..., 2) from the lines of edges (..., 4), positive to the left."""
    dx, dy = edges[..., 2] - edges[..., 0], edges[..., 3] - edges[..., 1]
    px, py = points[..., 0] - edges[..., 0], points[..., 1] - edges[..., 1]
    return np.asarray((dx * py - dy * px) / np.hypot(dx, dy))


def segments_cross(first: Floats, second: Floats) -> Booleans:
    """Tell which segments (..., 4) cross each other's interior; touching is left to the distances."""

    def side(edge: Floats, x: Floats, y: Floats) -> Floats:
        dx, dy = edge[..., 2] - edge[..., 0], edge[..., 3] - edge[..., 1]
        return np.asarray(dx * (y - edge[..., 1]) - dy * (x - edge[..., 0]))

    start, end = (side(first, second[..., i], second[..., i + 1]) for i in (0, 2))
    other_start, other_end = (side(second, first[..., i], first[..., i + 1]) for i in (0, 2))
    return np.asarray((start * end < 0.0) & (other_start * other_end < 0.0))


def segment_edge_squared(segments: Floats, edges: Floats) -> Floats:
    """Return the squared distances between segments (..., 4) and edges (..., 4), 0 where they meet; m^2."""
    nearest = np.minimum(
        np.minimum(
            point_edge_squared(segments[..., :2], edges), point_edge_squared(segments[..., 2:], edges)
        ),
        np.minimum(
            point_edge_squared(edges[..., :2], segments), point_edge_squared(edges[..., 2:], segments)
        ),
    )
    return np.where(segments_cross(segments, edges), 0.0, nearest)


def winding_number(points: Floats, edges: Floats) -> NDArray[np.int64]:
    """Return how often closed rings run counter-clockwise around points.

    Parameters
    ----------
    points : ndarray
        (B, 2) metres.
    edges : ndarray
        (B, M, 4) or (M, 4): all edges of the rings, in any order.

    Returns
    -------
    ndarray
        (B,) int; at least 1 inside any of several counter-clockwise rings, which may overlap.
    """
    x, y = points[:, None, 0], points[:, None, 1]
    left = (edges[..., 2] - edges[..., 0]) * (y - edges[..., 1]) - (edges[..., 3] - edges[..., 1]) * (
        x - edges[..., 0]
    )
    below, below_second = edges[..., 1] <= y, edges[..., 3] <= y
    upward = below & ~below_second & (left > 0.0)
    downward = ~below & below_second & (left < 0.0)
    return np.asarray(upward.sum(axis=-1) - downward.sum(axis=-1), dtype=np.int64)
