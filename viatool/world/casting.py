"""Where rays end: analytic ranges of batches of ray fans against circles, edges and half-planes.

Everything is computed as the *inverse* range, which turns "nearest hit" into "largest number", "no hit" into
anything at or below 0, and every shape into rows of one matrix product with the directions of the rays. In
the robot's frame, with d the unit direction of a ray:

- a line n.x = h with h > 0 is met at 1/t = (n/h).d;
- a circle with centre c and q = |c|^2 - r^2 > 0 is met at 1/t = P + sqrt(P^2 - 1/q), P = (c/q).d;
- an edge from a to b with D = a x b > 0 is met at 1/t = u + w, u = (d x b)/D, w = (a x d)/D, if u, w >= 0.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viatool.world.shapes import Floats

Ranges = NDArray[np.floating[Any]]
Booleans = NDArray[np.bool_]
Frame = tuple[Floats, Floats, Floats, Floats]  # x, y, cos theta, sin theta of B poses, (B,) each

# Edges are taken longer by this part of their length at both ends, and fade out within it: so no ray slips
# through between two edges that share a corner, whatever the rounding.
_OVERLAP: dict[type, float] = {np.float32: 1e-4, np.float64: 1e-9}


@dataclass(frozen=True, eq=False)
class Surroundings:
    """The shapes around B ray fans, in the map frame.

    Parameters
    ----------
    circles : ndarray
        (B, K, 3) x, y, radius; a radius of 0 or less stands for no circle.
    edges : ndarray
        (B, M, 4) both ends of edges, the visible side to their left; equal ends stand for no edge.
    lines : ndarray
        (B, L, 4) edges of a convex arena, its inside to their left.
    """

    circles: Floats
    edges: Floats
    lines: Floats


def cast_rays(poses: Floats, around: Surroundings, directions: Ranges, limit: float) -> Ranges:
    """Return the distance at which each ray first meets a shape.

    Parameters
    ----------
    poses : ndarray
        (B, 3) x, y, theta of the ray fans; not within the polygons of the edges.
    around : Surroundings
        The shapes around each of them.
    directions : ndarray
        (2, R) unit vectors of the rays in the fan's frame. Rays are computed in its kind of float, the
        geometry before in float64.
    limit : float
        Range of a ray that meets nothing nearer, in metres.

    Returns
    -------
    ndarray
        (B, R) metres; 0 for a fan within a circle or beyond a line.
    """
    fans, rays = len(poses), directions.shape[1]
    kind = directions.dtype.type
    frame = poses[:, 0], poses[:, 1], np.cos(poses[:, 2]), np.sin(poses[:, 2])
    circle_rows, offset, within = _circle_rows(frame, around.circles)
    line_rows, beyond = _line_rows(frame, around.lines)
    edge_rows = _edge_rows(frame, around.edges, _OVERLAP[kind])
    parts = [circle_rows, line_rows, *edge_rows]
    rows = np.concatenate(parts, dtype=kind, casting="same_kind").reshape(-1, 2)
    products = (rows @ directions).reshape(-1, fans, rays)
    ends = np.cumsum([len(part) for part in parts])
    circles, lines, inverse, from_first, from_second = np.split(products, ends[:-1])  # (shapes, B, R) each
    nearest = np.full((fans, rays), 1.0 / limit, kind)
    if len(lines):
        np.maximum(nearest, lines.max(axis=0), out=nearest)
    if len(circles):
        np.fmax(nearest, _inverse_circle_ranges(circles, offset.astype(kind)), out=nearest)
    if len(inverse):
        np.minimum(from_first, from_second, out=from_first)
        np.minimum(from_first, inverse, out=inverse)
        np.maximum(nearest, inverse.max(axis=0), out=nearest)
    np.reciprocal(nearest, out=nearest)
    np.minimum(nearest, kind(limit), out=nearest)
    nearest[within | beyond] = 0.0
    return nearest


def _inverse_circle_ranges(projections: Ranges, offset: Ranges) -> Ranges:
    """Return the largest P + sqrt(P^2 - 1/q), (B, R), of P (K, B, R) and 1/q (K, B); NaN for no hit."""
    root = np.square(projections)
    root -= offset[..., None]
    with np.errstate(invalid="ignore"):
        np.sqrt(root, out=root)  # NaN where the ray misses the circle, which fmax ignores
    root += projections
    nearest: Ranges = np.fmax.reduce(root, axis=0)
    return nearest


def _to_frame(frame: Frame, x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """Return the coordinates of points (B, K) in the frames of B poses, (K, B) each."""
    x_origin, y_origin, cosine, sine = frame
    x, y = x.T - x_origin, y.T - y_origin
    return cosine * x + sine * y, cosine * y - sine * x


def _circle_rows(frame: Frame, circles: Floats) -> tuple[Floats, Floats, Booleans]:
    """Return c/q, (K, B, 2), 1/q, (K, B), and which fans stand within a circle, (B,)."""
    x, y = _to_frame(frame, circles[..., 0], circles[..., 1])
    radius = circles[..., 2].T
    there = radius > 0.0
    power = np.where(there, x * x + y * y - radius * radius, 1.0)  # with c/q = 0, 1/q = 1 no ray hits
    outside = power > 0.0
    inverse = 1.0 / np.where(outside, power, 1.0)
    scale = inverse * there
    return np.stack([x * scale, y * scale], axis=-1), inverse, np.any(~outside, axis=0)


def _line_rows(frame: Frame, lines: Floats) -> tuple[Floats, Booleans]:
    """Return n/h, (L, B, 2), with n the outward normal, and which fans stand beyond a line, (B,)."""
    x, y = _to_frame(frame, lines[..., 0], lines[..., 1])
    x_second, y_second = _to_frame(frame, lines[..., 2], lines[..., 3])
    cross = x * y_second - y * x_second  # the distance from the line times the edge's length
    before = cross > 0.0
    scale = before / np.where(before, cross, 1.0)
    return np.stack([(y_second - y) * scale, (x - x_second) * scale], axis=-1), np.any(~before, axis=0)


def _edge_rows(frame: Frame, edges: Floats, overlap: float) -> tuple[Floats, Floats, Floats]:
    """Return the rows, (M, B, 2), of u + w and of u and w divided by half the overlap."""
    dx, dy = overlap * (edges[..., 2] - edges[..., 0]), overlap * (edges[..., 3] - edges[..., 1])
    x, y = _to_frame(frame, edges[..., 0] - dx, edges[..., 1] - dy)
    x_second, y_second = _to_frame(frame, edges[..., 2] + dx, edges[..., 3] + dy)
    cross = x * y_second - y * x_second
    seen = cross > 1e-12
    scale = seen / np.where(seen, cross, 1.0)
    first = np.stack([y_second * scale, -x_second * scale], axis=-1)
    second = np.stack([-y * scale, x * scale], axis=-1)
    return first + second, first * (2.0 / overlap), second * (2.0 / overlap)
