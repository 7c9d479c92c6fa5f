from __future__ import annotations

import numpy as np
import pytest
import shapely

from tests.world.grid_maps import random_grid, solid_region, world_of
from viatool.world import Footprint, Lidar, Obstacles, OccupancyGrid, Scenario, Scenes

YAWS = (0.0, 0.7)


def outlines(poses: np.ndarray, footprint: Footprint) -> list[shapely.Polygon]:
    turns = [np.array([[np.cos(t), np.sin(t)], [-np.sin(t), np.cos(t)]]) for t in poses[:, 2]]
    return [
        shapely.Polygon(footprint.polygon @ turn + at) for turn, at in zip(turns, poses[:, :2], strict=True)
    ]


@pytest.mark.parametrize("yaw", YAWS)
@pytest.mark.parametrize("density", [0.01, 0.1, 0.5])
def test_clearances_are_those_of_shapely(density: float, yaw: float) -> None:
    rng = np.random.default_rng(1)
    grid = random_grid(rng, density, yaw)
    scenes, solid = Scenes.of(world_of(grid), [None]), solid_region(grid)
    cells = rng.uniform(-1.0, [32.0, 24.0], (400, 2))
    cells[::5] = np.round(cells[::5])  # corners of cells
    starts, ends = grid.to_map(cells), grid.to_map(cells + rng.normal(0.0, 2.0, (400, 2)))
    ends[::7] = starts[::7]
    index = np.zeros(400, int)
    lines = shapely.linestrings(np.stack([starts, ends], axis=1))
    points = shapely.points(starts)
    assert scenes.clearance(starts, index) == pytest.approx(shapely.distance(points, solid), abs=1e-12)
    assert scenes.segment_clearance(starts, ends, index) == pytest.approx(
        shapely.distance(lines, solid), abs=1e-12
    )


@pytest.mark.parametrize("yaw", YAWS)
def test_segments_along_the_edges_of_cells_are_measured_exactly(yaw: float) -> None:
    rng = np.random.default_rng(2)
    grid = random_grid(rng, 0.02, yaw)
    scenes, solid = Scenes.of(world_of(grid), [None]), solid_region(grid)
    cells = np.round(rng.uniform(0.0, [31.0, 23.0], (300, 2)))
    along = np.where(rng.random((300, 1)) < 0.5, [1.0, 0.0], [0.0, 1.0]) * np.round(
        rng.normal(0, 3, (300, 1))
    )
    starts, ends = grid.to_map(cells), grid.to_map(np.clip(cells + along, 0.0, [31.0, 23.0]))
    expected = shapely.distance(shapely.linestrings(np.stack([starts, ends], axis=1)), solid)
    measured = scenes.segment_clearance(starts, ends, np.zeros(300, int))
    assert measured == pytest.approx(expected, abs=1e-12)
    assert (measured > 0.0).any()


@pytest.mark.parametrize("yaw", YAWS)
def test_footprints_are_measured_with_their_whole_area(yaw: float) -> None:
    rng = np.random.default_rng(3)
    grid = random_grid(rng, 0.02, yaw)
    scenes, solid = Scenes.of(world_of(grid), [None]), solid_region(grid)
    cells = rng.uniform(0.0, [31.0, 23.0], (200, 2))
    poses = np.column_stack([grid.to_map(cells), rng.uniform(-np.pi, np.pi, 200)])
    hollow = [[-0.2, -0.15], [0.2, -0.15], [0.2, 0.15], [0.05, -0.05], [-0.2, 0.15]]
    for footprint in (Footprint.rectangle(0.3, 0.2), Footprint("polygon", polygon=np.array(hollow))):
        expected = shapely.distance(outlines(poses, footprint), solid)
        measured = scenes.footprint_clearance(poses, footprint, np.zeros(200, int))
        assert measured == pytest.approx(expected, abs=1e-12)
        assert 0.1 < (measured > 0.0).mean() < 0.9


def test_a_cell_within_the_footprint_leaves_no_clearance() -> None:
    cells = np.zeros((41, 41), np.uint8)
    cells[20, 20] = 1
    scenes = Scenes.of(world_of(OccupancyGrid(cells, 0.1, (-2.05, -2.05, 0.0))), [None])
    poses, index = np.array([[0.0, 0.0, 0.3], [1.0, 0.0, 0.3]]), np.zeros(2, int)
    assert scenes.footprint_clearance(poses, Footprint.rectangle(1.0, 1.0), index)[0] == 0.0
    assert scenes.footprint_clearance(poses, Footprint.rectangle(1.0, 1.0), index)[1] > 0.0


@pytest.mark.parametrize("yaw", YAWS)
@pytest.mark.parametrize("density", [0.003, 0.1])
def test_rays_end_where_shapely_says(density: float, yaw: float) -> None:
    rng = np.random.default_rng(4)
    grid = random_grid(rng, density, yaw)
    solid, lidar = solid_region(grid), Lidar(rays=24, bins=6, minimum_range=0.01, maximum_range=0.7)
    poses = np.column_stack([grid.to_map(rng.uniform(-1, [32, 24], (80, 2))), rng.uniform(-3, 3, 80)])
    angles = poses[:, 2, None] + lidar.angles()
    tips = poses[:, None, :2] + 0.7 * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    rays = shapely.linestrings(np.stack([np.broadcast_to(poses[:, None, :2], tips.shape), tips], axis=2))
    met = shapely.intersection(rays, solid)
    hit = shapely.distance(shapely.points(poses[:, None, :2]), met)
    expected = np.where(shapely.is_empty(met), 0.7, hit)
    ranges = Scenes.of(world_of(grid), [None]).cast(poses, np.zeros(80, int), lidar)
    assert ranges == pytest.approx(expected, abs=1e-9)
    assert (expected == 0.7).any()
    assert (expected == 0.0).any()


def test_rays_along_edges_and_through_corners_do_not_slip_between_cells() -> None:
    diagonal = np.zeros((5, 5), np.uint8)
    diagonal[1, 3] = diagonal[2, 2] = diagonal[3, 1] = 1  # they touch at corners only
    scenes = Scenes.of(world_of(OccupancyGrid(diagonal, 1.0)), [None])
    lidar = Lidar(rays=1, bins=1, minimum_range=0.0, field_of_view=1.0)
    poses = np.array([[1.0, 1.0, np.pi / 4.0], [0.5, 0.5, np.pi / 4.0], [1.5, 1.5, np.pi / 4.0]])
    corner = scenes.cast(poses, np.zeros(3, int), lidar)[:, 0]
    assert corner == pytest.approx(np.sqrt(2.0) * np.array([1.0, 1.5, 0.5]))


def test_scenarios_add_their_own_obstacles_to_the_cells() -> None:
    grid = random_grid(np.random.default_rng(5), 0.0)
    person = Scenario("", (0, 0, 0), (0, 0), Obstacles(np.array([[-2.5, 2.5, 0.1]])))
    scenes = Scenes.of(world_of(grid), [None, person])
    points = np.array([[-2.2, 2.5], [-2.2, 2.5]])
    assert scenes.clearance(points, np.array([0, 1])) == pytest.approx([0.5, 0.2])
    assert shapely.distance(scenes.shapely(1), shapely.Point(-2.2, 2.5)) == pytest.approx(0.2, abs=1e-4)


@pytest.mark.parametrize("yaw", YAWS)
@pytest.mark.parametrize("density", [0.05, 0.4, 0.6, 0.95])
def test_the_outline_is_the_union_of_the_cells(density: float, yaw: float) -> None:
    grid = random_grid(np.random.default_rng(6), density, yaw)
    polygons, solid = grid.polygons(), solid_region(grid, margin=0.0)
    assert polygons.is_valid
    assert polygons.area == pytest.approx(grid.blocked.sum() * 0.05**2, rel=1e-12)
    assert shapely.symmetric_difference(polygons, solid).area < 1e-12


def test_the_outline_has_corners_only_where_it_turns_and_holes_where_it_is_free() -> None:
    ring = np.ones((4, 5), np.uint8)
    ring[1:3, 1:4] = 0
    (polygon,) = OccupancyGrid(ring, 0.5, (1.0, 2.0, 0.0)).polygons().geoms
    assert polygon.equals(shapely.box(1.0, 2.0, 3.5, 4.0).difference(shapely.box(1.5, 2.5, 3.0, 3.5)))
    assert (len(polygon.exterior.coords), len(polygon.interiors[0].coords)) == (5, 5)


def test_pieces_that_share_a_corner_are_polygons_of_their_own() -> None:
    pinched = np.array([[1, 0], [0, 1]], np.uint8)
    assert len(OccupancyGrid(pinched, 1.0).polygons().geoms) == 2
    assert len(OccupancyGrid(np.zeros((2, 2), np.uint8), 1.0).polygons().geoms) == 0
