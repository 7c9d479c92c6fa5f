"""A map_server map of 4000 x 4000 cells."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import shapely

from tests.world.grid_maps import write_map
from viatool.world import Lidar, Scenes, load_map

SIDE, CELL = 4000, 0.05
LOAD = """
import sys
from pathlib import Path
from viatool.world import load_map
load_map(sys.argv[1])
status = Path("/proc/self/status")  # the peak of this process alone; getrusage counts its parent's before the exec
lines = status.read_text().splitlines() if status.exists() else []
print(max((float(line.split()[1]) / 1024.0 for line in lines if line.startswith("VmHWM")), default=0.0))
"""


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    rng = np.random.default_rng(0)
    greys = np.full((SIDE, SIDE), 254, np.uint8)
    for wall in range(0, SIDE, 200):
        greys[wall : wall + 3] = greys[:, wall : wall + 3] = 0
    for x, y, width, height in np.column_stack(
        [rng.integers(0, SIDE - 60, (8000, 2)), rng.integers(3, 40, (8000, 2))]
    ):
        greys[y : y + height, x : x + width] = 0 if (x + y) % 3 == 0 else 254
    greys[rng.random((SIDE, SIDE)) < 0.0005] = 205
    return write_map(
        tmp_path_factory.mktemp("site"),
        greys,
        image="site.png",
        resolution=CELL,
        origin=[-100.0, -100.0, 0.0],
    )


def test_it_is_loaded_within_500_megabytes(site: Path) -> None:
    output = subprocess.run([sys.executable, "-c", LOAD, site], check=True, capture_output=True, text=True)
    assert float(output.stdout) < 500.0


def test_thousands_of_poses_are_measured_as_in_a_cut_out_of_the_map(site: Path) -> None:
    world = load_map(site)
    grid = world.obstacles.grid
    assert grid is not None
    rng = np.random.default_rng(1)
    poses = np.column_stack([rng.uniform(-95.0, 95.0, (5000, 2)), rng.uniform(-np.pi, np.pi, 5000)])
    ahead = poses[:, :2] + 0.2 * np.stack([np.cos(poses[:, 2]), np.sin(poses[:, 2])], axis=1)
    scenes, index, lidar = Scenes.of(world, [None]), np.zeros(5000, int), Lidar(maximum_range=3.5, rays=60)
    points = scenes.clearance(poses[:, :2], index)
    segments = scenes.segment_clearance(poses[:, :2], ahead, index)
    ranges = scenes.cast(poses, index, lidar)
    for state in rng.integers(0, 5000, 40):
        x, y, theta = poses[state]
        column, row = int((x + 100.0) / CELL), int((y + 100.0) / CELL)
        left, low = max(column - 80, 0), max(row - 80, 0)
        rows, columns = np.nonzero(grid.blocked[low : row + 80, left : column + 80])
        corner_x, corner_y = (left + columns) * CELL - 100.0, (low + rows) * CELL - 100.0
        squares = shapely.STRtree(shapely.box(corner_x, corner_y, corner_x + CELL, corner_y + CELL))

        def nearest(shape: shapely.Geometry, squares: shapely.STRtree = squares) -> float:
            return float(squares.query_nearest(shape, return_distance=True)[1][0])

        assert points[state] == pytest.approx(nearest(shapely.Point(x, y)), abs=1e-9)
        assert segments[state] == pytest.approx(nearest(shapely.LineString([(x, y), ahead[state]])), abs=1e-9)
        for angle, measured in zip(lidar.angles()[::6], ranges[state, ::6], strict=True):
            far = measured - 1e-6
            ray = np.array([np.cos(theta + angle), np.sin(theta + angle)])
            if far > 0.0:  # nothing until just before the hit, something at it
                assert nearest(shapely.LineString([(x, y), (x, y) + far * ray])) > 0.0
            if measured < 3.5:
                assert nearest(shapely.Point((x, y) + measured * ray)) < 1e-9
