"""Obstacles of a map as solids: circles become cylinders, everything else upright prisms.

Prisms are triangle meshes: the rings of a region, extruded, with a triangulated lid. Rays meet their faces exactly,
without the margin that an engine puts around convex solids, and one mesh holds thousands of faces in a tree.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from viatool.arrays import Floats, Indices
from viatool.world import WorldMap

if TYPE_CHECKING:
    from shapely.geometry.base import BaseGeometry

Ring = tuple[tuple[float, float], ...]  # corners in metres

HEIGHT = 0.6
"""Of all obstacles, in metres: above every LiDAR."""
_DEPTH = 0.1  # metres below the floor, so that no ray passes beneath a solid
_WALL = 0.15  # thickness of the arena's wall, in metres
_MOST_FACES = 20_000  # of one mesh; the engine limits what it takes at once


@dataclass(frozen=True, eq=False)
class TriangleMesh:
    """Triangles.

    Parameters
    ----------
    vertices : ndarray
        (V, 3) metres.
    faces : ndarray
        (F, 3) indices of vertices.
    """

    vertices: Floats
    faces: Indices


def map_meshes(world_map: WorldMap) -> list[TriangleMesh]:
    """Return the wall around the arena and everything of the map that is not a circle."""
    import shapely

    inside = shapely.Polygon(world_map.arena)
    wall = inside.buffer(_WALL, join_style="mitre").difference(inside)
    grid = world_map.obstacles.grid
    regions = [wall, *(() if grid is None else shapely.get_parts(grid.polygons()))]
    return _merged([_extrude(region) for region in regions]) + prisms(world_map.obstacles.polygons)


def prisms(rings: Sequence[Floats]) -> list[TriangleMesh]:
    """Return the prisms over simple polygons, (n, 2) corners each."""
    import shapely

    return _merged([_extrude(shapely.Polygon(ring)) for ring in rings])


def canonical_form(ring: Floats) -> tuple[Ring, tuple[float, float], float]:
    """Return a polygon without its place: congruent ones with the same first corner have the same form.

    Parameters
    ----------
    ring : ndarray
        (n, 2) corners.

    Returns
    -------
    tuple
        The corners, in micrometres exactly, with the first one in the origin and the first edge along x; where the
        first corner is; and how far the first edge is turned, in radians.
    """
    x, y = ring[0].tolist()
    along = ring[1] - ring[0]
    turn = math.atan2(along[1], along[0])
    cosine, sine = math.cos(turn), math.sin(turn)
    turned = (ring - ring[0]) @ np.array([[cosine, -sine], [sine, cosine]])
    return tuple((round(a, 6), round(b, 6)) for a, b in turned.tolist()), (x, y), turn


def _merged(meshes: Sequence[TriangleMesh]) -> list[TriangleMesh]:
    """Join meshes as far as the engine takes them."""
    joined: list[TriangleMesh] = []
    for group in _groups(meshes):
        offsets = np.cumsum([0, *(len(mesh.vertices) for mesh in group)])
        faces = [mesh.faces + offset for mesh, offset in zip(group, offsets, strict=False)]
        joined.append(TriangleMesh(np.concatenate([mesh.vertices for mesh in group]), np.concatenate(faces)))
    return joined


def _groups(meshes: Sequence[TriangleMesh]) -> Iterator[list[TriangleMesh]]:
    """Yield runs of meshes of a limited number of faces; a larger mesh is cut into pieces."""
    group: list[TriangleMesh] = []
    for mesh in meshes:
        for first in range(0, len(mesh.faces), _MOST_FACES):
            faces = mesh.faces[first : first + _MOST_FACES]
            used, inverse = np.unique(faces, return_inverse=True)
            piece = TriangleMesh(mesh.vertices[used], inverse.reshape(-1, 3))
            if group and sum(len(one.faces) for one in group) + len(faces) > _MOST_FACES:
                yield group
                group = []
            group.append(piece)
    if group:
        yield group


def _extrude(region: BaseGeometry) -> TriangleMesh:
    """Return the prism over a polygon with holes: its walls outward, and its lid."""
    import shapely

    upright = shapely.orient_polygons(region)  # exterior counter-clockwise, holes clockwise
    rings = [np.asarray(ring.coords)[:-1, :2] for ring in (upright.exterior, *upright.interiors)]
    vertices: list[Floats] = []
    faces: list[Indices] = []
    count = 0
    for ring in rings:
        size = len(ring)
        vertices += [_lift(ring, -_DEPTH), _lift(ring, HEIGHT)]
        low = count + np.arange(size)
        following = count + np.roll(np.arange(size), -1)
        faces.append(np.stack([low, following, following + size], axis=1))
        faces.append(np.stack([low, following + size, low + size], axis=1))
        count += 2 * size
    triangles = shapely.get_parts(shapely.constrained_delaunay_triangles(upright))
    corners = shapely.get_coordinates(shapely.orient_polygons(triangles)).reshape(-1, 4, 2)[:, :3]
    vertices.append(_lift(corners.reshape(-1, 2), HEIGHT))
    faces.append(count + np.arange(3 * len(corners)).reshape(-1, 3))
    return TriangleMesh(np.concatenate(vertices), np.concatenate(faces))


def _lift(points: Floats, height: float) -> Floats:
    return np.column_stack([points, np.full(len(points), height)])
