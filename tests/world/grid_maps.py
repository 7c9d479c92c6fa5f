"""Occupancy maps for tests, and the same questions answered by shapely on one square for each cell."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import shapely
from PIL import Image

from viatool.world import Obstacles, OccupancyGrid, WorldMap

FIELDS = {
    "image": "map.pgm",
    "resolution": 0.5,
    "origin": [1.0, 2.0, 0.0],
    "negate": 0,
    "occupied_thresh": 0.65,
    "free_thresh": 0.196,
}


def write_map(folder: Path, greys: object, *, image: str = "map.pgm", **changes: object) -> Path:
    """Write an image, given row by row from the top, and its map_server file; None leaves a field out."""
    Image.fromarray(np.asarray(greys, np.uint8)).save(folder / image)
    fields = FIELDS | {"image": image} | changes
    path = folder / "map.yaml"
    lines = [f"{name}: {value}" for name, value in fields.items() if value is not None]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def random_grid(rng: np.random.Generator, density: float, yaw: float = 0.0) -> OccupancyGrid:
    """Return a grid of 23 x 31 cells."""
    cells = (rng.random((23, 31)) < density).astype(np.uint8)
    return OccupancyGrid(cells, 0.05, (-3.0, 2.0, yaw))


def world_of(grid: OccupancyGrid) -> WorldMap:
    """Return a map with nothing but a grid."""
    return WorldMap("grid", Path("grid.yaml"), "", grid.outline, Obstacles(grid=grid))


def solid_region(grid: OccupancyGrid, margin: float = 10.0) -> shapely.Geometry:
    """Return the squares of all blocked cells and everything outside of the grid."""
    frame = shapely.Polygon(grid.outline)
    squares = [
        shapely.transform(shapely.box(column, row, column + 1, row + 1), grid.to_map)
        for row, column in zip(*np.nonzero(grid.blocked), strict=True)
    ]
    return shapely.union_all([frame.buffer(margin).difference(frame), *squares])
