"""Rays through a grid of cells: exact, and in large steps where there is room.

Every cell knows the largest square of free cells around it, which a ray leaves at a known distance without
meeting anything. Cells are unit squares; lengths are in cells.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viatool.arrays import Booleans, Floats, Indices, Plane


def free_squares(blocked: Booleans) -> NDArray[np.uint8]:
    """Return how many cells away, in columns or rows, the nearest blocked cell is.

    Parameters
    ----------
    blocked : ndarray
        (R, C) bool.

    Returns
    -------
    ndarray
        (R + 2, C + 2), with a blocked rim; 0 in a blocked cell, at most 255.
    """
    from scipy.ndimage import distance_transform_cdt

    room = distance_transform_cdt(np.pad(~blocked, 1), metric="chessboard")
    return np.asarray(np.minimum(room, 255), dtype=np.uint8)


def march_rays(places: Plane, rays: Plane, squares: NDArray[np.uint8], limit: float) -> Floats:
    """Return how far rays get.

    Parameters
    ----------
    places, rays : ndarray
        (N,) origins in the grid without its rim, and unit directions.
    squares : ndarray
        (R, C) of `free_squares`.
    limit : float
        Where rays end that meet nothing nearer.

    Returns
    -------
    ndarray
        (N,) distances to the first blocked cell; 0 for a ray that is not finite.

    Notes
    -----
    Sound: under rounding only. A ray through the corner that two blocked cells share ends there: it leaves a
    square through one side, never through a corner.
    """
    ranges = np.full(len(places), limit)
    known = np.isfinite(places) & np.isfinite(rays)
    if not known.all():  # a ray from nowhere, or to nowhere, is not free
        ranges[:] = 0.0
        ranges[known] = march_rays(places[known], rays[known], squares, limit)
        return ranges
    rows, columns = squares.shape
    x, y, dx, dy = places.real + 1.0, places.imag + 1.0, rays.real, rays.imag
    i = np.clip(np.floor(x), 0, columns - 1).astype(np.int64)
    j = np.clip(np.floor(y), 0, rows - 1).astype(np.int64)
    ray, far = np.arange(len(places)), np.zeros(len(places))
    flat = squares.ravel()
    while len(ray):
        room = flat.take(j * columns + i).astype(np.int64)
        met = room == 0
        ranges[ray[met]] = far[met]
        going = np.flatnonzero(~met)
        ray, x, y, dx, dy, i, j, room = _pick(going, ray, x, y, dx, dy, i, j, room)
        far, i, j = _leave_squares(x, y, dx, dy, i, j, room)
        going = np.flatnonzero(far < limit)
        ray, x, y, dx, dy, i, j, far = _pick(going, ray, x, y, dx, dy, i, j, far)
    return ranges


def _pick(which: Indices, *arrays: NDArray[Any]) -> Iterator[Any]:
    return (array[which] for array in arrays)


def _leave_squares(
    x: Floats, y: Floats, dx: Floats, dy: Floats, i: Indices, j: Indices, room: Indices
) -> tuple[Floats, Indices, Indices]:
    """Return where rays leave the free squares around their cells: distance, and column and row behind."""
    with np.errstate(divide="ignore", invalid="ignore"):
        to_x = np.where(dx == 0.0, np.inf, (np.where(dx > 0.0, i + room, i - room + 1) - x) / dx)
        to_y = np.where(dy == 0.0, np.inf, (np.where(dy > 0.0, j + room, j - room + 1) - y) / dy)
    sideways = to_x <= to_y
    far = np.maximum(np.where(sideways, to_x, to_y), 0.0)
    least, most = 1 - room, room - 1
    beside = np.clip(np.floor(y + far * dy).astype(np.int64), j + least, j + most)
    above = np.clip(np.floor(x + far * dx).astype(np.int64), i + least, i + most)
    column = np.where(sideways, np.where(dx > 0.0, i + room, i - room), above)
    row = np.where(sideways, beside, np.where(dy > 0.0, j + room, j - room))
    return far, column, row
