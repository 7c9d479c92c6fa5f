from __future__ import annotations

import numpy as np
import pytest
import shapely

from tests.world.random_worlds import ARENAS, LIDAR, expected_ranges, random_world
from viatool.world import Lidar, Obstacles, Scenario, Scenes, WorldMap, bin_ranges, box_polygon, load_map


@pytest.mark.parametrize("arena", ARENAS)
@pytest.mark.parametrize("seed", range(3))
def test_ranges_are_those_of_shapely(arena: str, seed: int) -> None:
    rng = np.random.default_rng([seed, 1])
    world, scenarios = random_world(rng, ARENAS[arena], situations=5)
    scenes = Scenes.of(world, scenarios)
    poses = np.column_stack([rng.uniform(-5, 5, (40, 2)), rng.uniform(-np.pi, np.pi, 40)])
    scene = rng.integers(0, len(scenes), 40)
    ranges = scenes.cast(poses, scene, LIDAR)
    expected = np.array(
        [
            expected_ranges(world, scenarios[index], pose, LIDAR.angles(), LIDAR.maximum_range)
            for pose, index in zip(poses, scene, strict=True)
        ]
    )
    np.testing.assert_allclose(ranges, expected, atol=1e-7)
    assert (expected == 0.0).all(axis=1).any()  # some robots stood inside an obstacle or outside the arena
    assert (expected == LIDAR.maximum_range).any()


def test_single_precision_differs_from_double_precision_only_where_a_ray_grazes() -> None:
    rng = np.random.default_rng(2)
    world, scenarios = random_world(rng, ARENAS["box"], situations=5)
    scenes = Scenes.of(world, scenarios)
    poses = np.column_stack([rng.uniform(-4, 4, (400, 2)), rng.uniform(-np.pi, np.pi, 400)])
    scene = rng.integers(0, len(scenes), 400)
    lidar = Lidar()
    double, single = scenes.cast(poses, scene, lidar), scenes.cast(poses, scene, lidar, dtype=np.float32)
    assert single.dtype == np.float32
    error = np.abs(single - double)
    assert np.quantile(error, 0.999) < 1e-4
    assert (error > 1e-2).mean() < 1e-4  # rays that pass a corner or a rim on the other side


def test_no_ray_slips_through_the_corners_of_a_box() -> None:
    box = Obstacles(polygons=(box_polygon((2.0, 0.3), (1.0, 1.0), 0.4),))
    world = WorldMap("", load_map("maps/lab.yaml").path, "", ARENAS["box"], box)
    corners = box.polygons[0]
    nearer = corners[np.argsort(np.hypot(*corners.T))[:3]]
    ray = nearer[:1].T / np.hypot(*nearer[0])
    for dtype in (np.float32, np.float64):
        hit = Scenes.of(world, [None]).cast(
            np.zeros((1, 3)), np.zeros(1, int), Lidar(), directions=ray.astype(dtype)
        )
        assert hit[0, 0] == pytest.approx(np.hypot(*nearer[0]), rel=1e-4)


def test_ranges_do_not_depend_on_how_many_robots_are_cast_together() -> None:
    rng = np.random.default_rng(3)
    world, scenarios = random_world(rng, ARENAS["l-shaped"], situations=4)
    scenes = Scenes.of(world, scenarios)
    poses = np.column_stack([rng.uniform(-4, 4, (3000, 2)), rng.uniform(-np.pi, np.pi, 3000)])
    scene = rng.integers(0, len(scenes), 3000)
    together = scenes.cast(poses, scene, LIDAR)  # in several chunks
    alone = np.concatenate(
        [scenes.cast(poses[i : i + 1], scene[i : i + 1], LIDAR) for i in range(0, 3000, 100)]
    )
    np.testing.assert_allclose(together[::100], alone, rtol=1e-12)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("limit", [3.5, 7.0, 5.3, 0.3])
def test_nothing_in_range_reads_exactly_the_maximum_range(limit: float, dtype: type) -> None:
    world = WorldMap("", load_map("maps/lab.yaml").path, "", box_polygon((0, 0), (40, 40)))
    lidar = Lidar(maximum_range=limit)
    ranges = Scenes.of(world, [None]).cast(np.zeros((1, 3)), np.zeros(1, int), lidar, dtype=dtype)
    assert ranges.shape == (1, 180)
    assert (ranges == dtype(limit)).all()


def test_the_first_ray_looks_right_and_the_last_one_left() -> None:
    circle = Obstacles(np.array([[0.0, -2.0, 0.5]]))  # to the right of a robot that looks along x
    world = WorldMap("", load_map("maps/lab.yaml").path, "", box_polygon((0, 0), (40, 40)), circle)
    ranges = Scenes.of(world, [None]).cast(np.zeros((1, 3)), np.zeros(1, int), Lidar())
    assert ranges[0, 0] == pytest.approx(1.5)
    assert ranges[0, -1] == 7.0
    binned = bin_ranges(ranges, Lidar())
    assert binned.shape == (1, 20)
    assert binned[0, 0] == pytest.approx(1.5)
    assert (binned[0] == ranges.reshape(20, 9).min(axis=1)).all()


def test_replaced_obstacles_are_seen() -> None:
    world = load_map("maps/lab.yaml")
    assert world.generator is not None
    batch = world.generator.draw_arrays(6, np.random.default_rng(0))
    scenes = Scenes(world.arena, world.obstacles, batch.circles[:3], batch.edges()[:3])
    scenes.replace(np.array([2, 0]), batch.circles[4:], batch.edges()[4:])
    expected: list[Scenario | None] = [batch.scenario(i, "") for i in (5, 1, 4)]
    poses = np.array([batch.starts[i] for i in (5, 1, 4)])
    index = np.arange(3)
    lidar = world.robot.lidar
    assert (scenes.cast(poses, index, lidar) == Scenes.of(world, expected).cast(poses, index, lidar)).all()
    assert shapely.equals(scenes.shapely(0), Scenes.of(world, expected).shapely(0))
