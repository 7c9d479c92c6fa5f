"""Occupancy grids on matplotlib axes: one picture, however many cells there are."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgba
from matplotlib.transforms import Affine2D
from numpy.typing import NDArray

if TYPE_CHECKING:
    from viatool.world import OccupancyGrid

_SIDE = 1600  # pixels along the longer side, at most
_UNKNOWN = "#C9CED4"


def draw_cells(axes: Axes, grid: OccupancyGrid, *, colour: str) -> None:
    """Draw the occupied cells in a colour and the unknown ones paler; free cells stay as they are."""
    x, y, yaw = grid.origin
    place = Affine2D().scale(grid.resolution).rotate(yaw).translate(x, y)
    kinds, block = darkest(grid.cells)
    shades = np.array([(0.0, 0.0, 0.0, 0.0), to_rgba(colour), to_rgba(_UNKNOWN)])
    width, height = kinds.shape[1] * block, kinds.shape[0] * block
    axes.imshow(
        shades[kinds],
        extent=(0.0, width, 0.0, height),
        origin="lower",
        interpolation="nearest",
        transform=place + axes.transData,
        zorder=1.9,
    )


def darkest(cells: NDArray[np.uint8]) -> tuple[NDArray[np.uint8], int]:
    """Return cells in blocks, so that a picture of them stays small, and the side of a block in cells.

    A block is occupied if any of its cells is, else unknown if any is, else free.
    """
    rows, columns = cells.shape
    block = -(-max(rows, columns) // _SIDE)
    if block == 1:
        return cells, block
    whole = np.pad(cells, ((0, -rows % block), (0, -columns % block)))
    blocks = whole.reshape(whole.shape[0] // block, block, whole.shape[1] // block, block)
    unknown, occupied = (blocks == 2).any(axis=(1, 3)), (blocks == 1).any(axis=(1, 3))
    return np.where(occupied, 1, np.where(unknown, 2, 0)).astype(np.uint8), block
