"""The outline of blocked cells: closed rectilinear polygons with holes, exact at the edges of the cells."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from viatool.arrays import Booleans, Indices
from viatool.world.rings import signed_area

if TYPE_CHECKING:
    from shapely import Polygon


def blocked_polygons(blocked: Booleans) -> list[Polygon]:
    """Return one polygon for each piece of blocked cells that are joined by their sides.

    Parameters
    ----------
    blocked : ndarray
        (rows, columns) bool.

    Returns
    -------
    list of shapely.Polygon
        Valid, without common inner points, corners in cells; edges run from corner to corner. Pieces that
        share only a corner are polygons of their own.
    """
    import shapely
    from scipy.ndimage import label

    pieces, count = label(blocked)
    shells: list[Any] = [None] * (count + 1)
    holes: dict[int, list[Any]] = {}
    for ring in trace_rings(blocked):
        piece = int(pieces[_cell_to_the_left(ring)])
        if signed_area(ring.astype(np.float64)) > 0.0:
            shells[piece] = ring
        else:
            holes.setdefault(piece, []).append(ring)
    return [
        shapely.Polygon(shell, holes.get(piece)) for piece, shell in enumerate(shells) if shell is not None
    ]


def trace_rings(blocked: Booleans) -> list[Indices]:
    """Return the simple rings around blocked cells, which lie to the left of every edge.

    Parameters
    ----------
    blocked : ndarray
        (rows, columns) bool.

    Returns
    -------
    list of ndarray
        (n, 2) corners x, y in cells, the first not repeated; counter-clockwise around blocked cells,
        clockwise around holes.
    """
    column, row, following = _corners(blocked)
    ahead, width = following.tolist(), blocked.shape[1] + 1
    vertex = (row * width + column).tolist()
    visited = bytearray(len(ahead))
    rings: list[list[int]] = []
    for begin in range(len(ahead)):
        if visited[begin]:
            continue
        ring, node = [], begin
        while not visited[node]:
            visited[node] = 1
            ring.append(vertex[node])
            node = ahead[node]
        rings += [ring] if len(set(ring)) == len(ring) else _split(ring)
    return [np.stack(np.divmod(np.array(ring), width)[::-1], axis=1) for ring in rings]


def _corners(blocked: Booleans) -> tuple[Indices, Indices, Indices]:
    """Return the corners of the outline, (K,) column and row, and the index of the one that follows each.

    Where two blocked cells touch only at a corner, there are two corners in one place, one of each cell.
    """
    filled = np.pad(blocked, 1)
    south_west, south_east = filled[:-1, :-1], filled[:-1, 1:]
    north_west, north_east = filled[1:, :-1], filled[1:, 1:]
    corner = np.nonzero((south_west ^ south_east) ^ (north_west ^ north_east))
    pinch = (south_west == north_east) & (south_east == north_west) & (south_west != south_east)
    pinches = np.nonzero(pinch)
    row = np.concatenate([corner[0], pinches[0], pinches[0]])
    column = np.concatenate([corner[1], pinches[1], pinches[1]])
    sw, se, nw, ne = (part[row, column] for part in (south_west, south_east, north_west, north_east))
    east, north = se != ne, nw != ne  # whether its horizontal edge leads east, its vertical edge north
    single, double = len(corner[0]), len(pinches[0])
    upper = np.arange(len(row)) >= single + double  # the corner of the upper cell of a pinch
    joined = np.arange(len(row)) >= single
    east[joined] = np.where(upper, ne, se)[joined]
    north[joined] = upper[joined]
    horizontal = _partners(np.lexsort((east, column, row)))
    vertical = _partners(np.lexsort((north, row, column)))
    leaves = np.where(east, ne, sw)  # to the east with the blocked cell above, to the west with it below
    return column, row, np.where(leaves, horizontal, vertical)


def _partners(order: Indices) -> Indices:
    """Return for each corner the one at the other end of its edge; ends follow each other in `order`."""
    partner = np.empty_like(order)
    partner[order[0::2]], partner[order[1::2]] = order[1::2], order[0::2]
    return partner


def _split(ring: list[int]) -> list[list[int]]:
    """Return the simple rings of one that passes some places twice."""
    rings: list[list[int]] = []
    path: list[int] = []
    places: dict[int, int] = {}
    for vertex in ring:
        if vertex in places:
            begin = places[vertex]
            rings.append(path[begin:])
            for passed in path[begin:]:
                del places[passed]
            del path[begin:]
        places[vertex] = len(path)
        path.append(vertex)
    return [*rings, path]


def _cell_to_the_left(ring: Indices) -> tuple[int, int]:
    """Return row and column of the cell to the left of a ring's first edge."""
    (x, y), (next_x, next_y) = ring[0].tolist(), ring[1].tolist()
    if next_y == y:
        return (y, x) if next_x > x else (y - 1, x - 1)
    return (y, x - 1) if next_y > y else (y - 1, x)
