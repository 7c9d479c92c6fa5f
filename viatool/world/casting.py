"""Where rays end: analytic ranges of batches of ray fans against circles, edges and half-planes.

Everything is computed as the *inverse* range, which turns "nearest hit" into "largest number", "no hit" into
anything at or below 0, and every shape into rows of one matrix product with the directions of the rays. In the
robot's frame, with d the unit direction of a ray:

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
        (B, 3) x, y, theta of the ray fans, outside every shape and inside the arena.
    around : Surroundings
        The shapes around each of them.
    directions : ndarray
        (2, R) unit vectors of the rays in the fan's frame. Rays are computed in its kind of float, the geometry
        before in float64.
    limit : float
        Range of a ray that meets nothing nearer, in metres.

    Returns
    -------
    ndarray
        (B, R) metres.
    """
    fans, rays = len(poses), directions.shape[1]
    kind = directions.dtype.type
    circle_rows, offset = _circle_rows(poses, around.circles)
    edge_rows = _edge_rows(poses, around.edges, _OVERLAP[kind])
    parts = [circle_rows, _line_rows(poses, around.lines), *edge_rows]
    rows = np.concatenate(parts).reshape(-1, 2).astype(kind)
    products = (rows @ directions).reshape(-1, fans, rays)
    ends = np.cumsum([len(part) for part in parts])
    circles, lines, inverse, from_first, from_second = np.split(products, ends[:-1])  # (shapes, B, R) each
    nearest = np.full((fans, rays), 1.0 / limit, kind)
    if len(circles):
        root = np.square(circles)
        root -= offset[..., None].astype(kind)
        with np.errstate(invalid="ignore"):
            np.sqrt(root, out=root)  # NaN where the ray passes the circle, which fmax ignores
        root += circles
        np.fmax(nearest, np.fmax.reduce(root, axis=0), out=nearest)
    if len(lines):
        np.maximum(nearest, lines.max(axis=0), out=nearest)
    if len(inverse):
        np.minimum(from_first, from_second, out=from_first)
        np.minimum(from_first, inverse, out=inverse)
        np.maximum(nearest, inverse.max(axis=0), out=nearest)
    np.reciprocal(nearest, out=nearest)
    return np.minimum(nearest, kind(limit), out=nearest)


def _to_frame(poses: Floats, points: Floats) -> tuple[Floats, Floats]:
    """Return x and y, (K, B) each, of points (B, K, 2) in the frames of poses (B, 3)."""
    relative = points.transpose(2, 1, 0) - poses.T[:2, None]
    cosine, sine = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    x = cosine * relative[0] + sine * relative[1]
    return x, cosine * relative[1] - sine * relative[0]


def _circle_rows(poses: Floats, circles: Floats) -> tuple[Floats, Floats]:
    """Return c/q, (K, B, 2), and 1/q, (K, B)."""
    x, y = _to_frame(poses, circles[..., :2])
    radius = circles[..., 2].T
    power = x * x + y * y - radius * radius
    there = (radius > 0.0) & (power > 0.0)
    inverse = 1.0 / np.where(there, power, 1.0)  # together with c/q = 0 it gives the root of -1: no hit
    scale = inverse * there
    return np.stack([x * scale, y * scale], axis=-1), inverse


def _line_rows(poses: Floats, lines: Floats) -> Floats:
    """Return n/h, (L, B, 2), with n the outward normal."""
    x, y = _to_frame(poses, lines[..., :2])
    x_second, y_second = _to_frame(poses, lines[..., 2:])
    cross = x * y_second - y * x_second  # the distance from the line times the edge's length
    scale = np.where(cross > 0.0, 1.0 / np.where(cross > 0.0, cross, 1.0), 0.0)
    return np.stack([(y_second - y) * scale, (x - x_second) * scale], axis=-1)


def _edge_rows(poses: Floats, edges: Floats, overlap: float) -> tuple[Floats, Floats, Floats]:
    """Return the rows, (M, B, 2), of u + w and of u and w divided by half the overlap."""
    extension = overlap * (edges[..., 2:] - edges[..., :2])
    x, y = _to_frame(poses, edges[..., :2] - extension)
    x_second, y_second = _to_frame(poses, edges[..., 2:] + extension)
    cross = x * y_second - y * x_second
    seen = cross > 1e-12
    scale = seen / np.where(seen, cross, 1.0)
    first = np.stack([y_second * scale, -x_second * scale], axis=-1)
    second = np.stack([-y * scale, x * scale], axis=-1)
    return first + second, first * (2.0 / overlap), second * (2.0 / overlap)
