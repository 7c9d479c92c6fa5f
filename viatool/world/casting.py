"""Where rays end: analytic ranges of batches of ray fans against circles, edges and half-planes.

Everything is computed as the *inverse* range, which turns "nearest hit" into "largest number", "no hit" into
anything at or below 0, and every shape into rows of one matrix product with the directions of the rays. In
the robot's frame, with d the unit direction of a ray:

- a line n.x = h with unit normal n and h > 0 is met at 1/t = (n/h).d;
- a circle with centre c and q = |c|^2 - r^2 > 0 is met at 1/t = P + sqrt(P^2 - 1/q), P = (c/q).d;
- an edge from a to b with D = a x b > 0 is met at 1/t = u + w, u = (d x b)/D, w = (a x d)/D, if u, w >= 0.

Points and directions of the plane are complex numbers x + iy: turning into the robot's frame is a product.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from viatool.arrays import Booleans, Floats, Plane, Reals

# Edges are taken longer by this part of their length at both ends, and fade out within it: so no ray slips
# through between two edges that share a corner, whatever the rounding.
_OVERLAP: dict[type, float] = {np.float32: 1e-4, np.float64: 1e-9}
# Distances from a circle (as q) and from a line are not divided by if they are smaller, in m^2 and m.
_TOUCHING = 1e-9
# Edges are not seen if their line passes the fan nearer than this divided by their length, in m^2.
_EDGE_ON = 1e-12


@dataclass(frozen=True, eq=False)
class Surroundings:
    """The shapes around B ray fans, in the map frame.

    Parameters
    ----------
    centres, radii : ndarray
        (K, B) of circles, in metres; a radius of 0 cannot be seen.
    first, second : ndarray
        (M, B) both ends of edges, the visible side to their left; equal ends cannot be seen.
    normals, offsets : ndarray
        (L, 1) lines around a convex arena: unit normal outward, distance of the line from the map's origin.
    """

    centres: Plane
    radii: Floats
    first: Plane
    second: Plane
    normals: Plane
    offsets: Floats


def cast_rays(
    places: Plane, headings: Floats, around: Surroundings, directions: Reals, limit: float
) -> Reals:
    """Return the distance at which each ray first meets a shape.

    Parameters
    ----------
    places : ndarray
        (B,) origins of the ray fans, not within the polygons of the edges.
    headings : ndarray
        (B,) radians.
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
    fans, kind = len(places), directions.dtype.type
    turn = np.exp(-1j * headings)
    circles, offset, within = _circle_rows(places, turn, around)
    lines, beyond = _line_rows(places, turn, around)
    rows = [circles, lines]
    if len(around.first):
        first, second = _seen_edges(places, turn, around, _OVERLAP[kind], limit, directions)
        rows += _edge_rows(first, second, _OVERLAP[kind])
    products = _project(np.concatenate(rows), directions)  # (shapes, B, R)
    count, beside = len(circles), len(circles) + len(lines)
    # A little beyond the limit, so that a ray that hits nothing gives exactly the limit after rounding.
    beyond_limit = 1.0 / (limit * (1.0 + 8.0 * np.finfo(kind).eps))
    nearest = np.full((fans, directions.shape[1]), beyond_limit, kind)
    if beside > count:
        np.maximum(nearest, products[count:beside].max(axis=0), out=nearest)
    if count:
        np.fmax(nearest, _inverse_circle_ranges(products[:count], offset.astype(kind)), out=nearest)
    if len(products) > beside:
        np.maximum(nearest, _inverse_edge_ranges(products[beside:]), out=nearest)
    np.reciprocal(nearest, out=nearest)
    np.minimum(nearest, kind(limit), out=nearest)
    nearest[within | beyond] = 0.0
    return nearest


def _project(rows: Plane, directions: Reals) -> Reals:
    """Return the dot products, (N, B, R), of vectors (N, B) with the directions (2, R)."""
    single = directions.dtype == np.float32
    flat = rows.astype(np.complex64).view(np.float32) if single else rows.view(np.float64)
    return (flat.reshape(-1, 2) @ directions).reshape(*rows.shape, directions.shape[1])


def _inverse_circle_ranges(projections: Reals, offset: Reals) -> Reals:
    """Return the largest P + sqrt(P^2 - 1/q), (B, R), of P (K, B, R) and 1/q (K, B); NaN for no hit."""
    root = np.square(projections)
    root -= offset[..., None]
    with np.errstate(invalid="ignore"):
        np.sqrt(root, out=root)  # NaN where the ray misses the circle, which fmax ignores
    root += projections
    nearest: Reals = np.fmax.reduce(root, axis=0)
    return nearest


def _inverse_edge_ranges(products: Reals) -> Reals:
    """Return the largest u + w, (B, R), of edges that are hit; at most 0 where none is."""
    inverse, from_first, from_second = np.split(products, 3)
    np.minimum(from_first, from_second, out=from_first)
    np.minimum(from_first, inverse, out=inverse)
    nearest: Reals = inverse.max(axis=0)
    return nearest


def _circle_rows(places: Plane, turn: Plane, around: Surroundings) -> tuple[Plane, Floats, Booleans]:
    """Return c/q and 1/q, (K, B), and which fans stand within a circle, (B,)."""
    centres = around.centres - places
    power = np.square(centres.real) + np.square(centres.imag) - np.square(around.radii)
    within = ~np.all(power > 0.0, axis=0)
    inverse = 1.0 / np.maximum(power, _TOUCHING)
    centres *= turn
    centres *= inverse
    return centres, inverse, np.asarray(within)


def _line_rows(places: Plane, turn: Plane, around: Surroundings) -> tuple[Plane, Booleans]:
    """Return n/h, (L, B), and which fans stand beyond a line, (B,)."""
    normals = around.normals
    distance = around.offsets - (normals.real * places.real + normals.imag * places.imag)
    beyond = ~np.all(distance > 0.0, axis=0)
    return normals * turn / np.maximum(distance, _TOUCHING), np.asarray(beyond)


def _seen_edges(
    places: Plane, turn: Plane, around: Surroundings, overlap: float, limit: float, directions: Reals
) -> tuple[Plane, Plane]:
    """Return both ends, (m, B) in the fans' frames, of the most prolonged edges that any fan may hit."""
    extension = overlap * (around.second - around.first)
    first = (around.first - extension - places) * turn
    second = (around.second + extension - places) * turn
    cross = first.real * second.imag - first.imag * second.real  # distance from the line times the length
    seen = (cross > _EDGE_ON) & (cross < limit * np.abs(second - first))
    if directions[0].min() >= -1e-6:  # rays to the front only
        seen &= np.maximum(first.real, second.real) > 0.0
    most = int(seen.sum(axis=0).max(initial=0))
    if most < len(seen):
        chosen = np.argsort(~seen, axis=0, kind="stable")[:most]
        first, second = np.take_along_axis(first, chosen, 0), np.take_along_axis(second, chosen, 0)
    return first, second


def _edge_rows(first: Plane, second: Plane, overlap: float) -> list[Plane]:
    """Return the rows, (m, B) each, of u + w and of u and w divided by half the overlap."""
    cross = first.real * second.imag - first.imag * second.real
    there = cross > _EDGE_ON
    scale = there / np.where(there, cross, 1.0)
    from_second, from_first = -1j * second * scale, 1j * first * scale
    return [from_first + from_second, from_first * (2.0 / overlap), from_second * (2.0 / overlap)]
