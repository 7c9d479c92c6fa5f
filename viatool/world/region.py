"""The space that is not free, as one shapely geometry."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from viatool.arrays import Floats, Plane

if TYPE_CHECKING:
    from shapely.geometry.base import BaseGeometry

    from viatool.world.occupancy import OccupancyGrid

# Corners in a quarter of the polygon around a circle: it is at most 8e-5 of the radius farther out.
_QUARTER = 64


def blocked_region(
    arena: Plane,
    centres: Plane,
    radii: Floats,
    first: Plane,
    second: Plane,
    margin: float,
    grid: OccupancyGrid | None = None,
) -> BaseGeometry:
    """Return obstacles and the outside of an arena; points are complex numbers in metres.

    Parameters
    ----------
    arena : ndarray
        (n,) corners.
    centres, radii : ndarray
        (K,) of circles; a radius of 0 stands for no circle.
    first, second : ndarray
        (M,) ends of the edges of polygons, one polygon after the other; equal ends stand for no polygon.
    margin : float
        How far the outside of the arena extends beyond the arena's bounds, in metres.
    grid : OccupancyGrid, optional
        Its cells that are not free.

    Returns
    -------
    shapely geometry
        Circles are circumscribed by polygons, so nothing that is blocked is missing.
    """
    import shapely

    inside = shapely.Polygon(_pairs(arena))
    frame = shapely.box(*inside.bounds).buffer(margin, join_style="mitre")
    there = radii > 0.0
    outer = radii[there] / np.cos(np.pi / (4 * _QUARTER))
    points = shapely.points(centres.real[there], centres.imag[there])
    circles = shapely.buffer(points, outer, quad_segs=_QUARTER)
    polygons = [shapely.Polygon(_pairs(ring)) for ring in _rings(first, second)]
    region = shapely.union_all([frame.difference(inside), *circles, *polygons])
    return region if grid is None else shapely.union(region, grid.polygons())


def _rings(first: Plane, second: Plane) -> list[Plane]:
    """Return the corners of each closed ring of consecutive edges."""
    rings: list[Plane] = []
    begin = 0
    for index in range(len(first)):
        if second[index] == first[begin]:  # closed
            if index > begin:
                rings.append(first[begin : index + 1])
            begin = index + 1
    return rings


def _pairs(points: Plane) -> Floats:
    return np.stack([points.real, points.imag], axis=1)
