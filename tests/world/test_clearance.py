from __future__ import annotations

import numpy as np
import pytest
import shapely

from tests.world.random_worlds import ARENAS, expected_clearance, random_world
from viatool.world import Footprint, Obstacles, Scenes, WorldMap, box_polygon, load_map


@pytest.mark.parametrize("arena", ARENAS)
@pytest.mark.parametrize("seed", range(3))
def test_clearance_of_points_and_segments_is_that_of_shapely(arena: str, seed: int) -> None:
    rng = np.random.default_rng([seed, 2])
    world, scenarios = random_world(rng, ARENAS[arena], situations=5)
    scenes = Scenes.of(world, scenarios)
    starts = rng.uniform(-5, 5, (120, 2))
    ends = starts + rng.normal(0.0, 0.4, (120, 2))
    ends[::10] = starts[::10]
    scene = rng.integers(0, len(scenes), 120)
    points, segments = scenes.clearance(starts, scene), scenes.segment_clearance(starts, ends, scene)
    assert points.shape == segments.shape == (120,)
    for i, index in enumerate(scene):
        point, segment = shapely.Point(starts[i]), shapely.LineString([starts[i], ends[i]])
        assert points[i] == pytest.approx(expected_clearance(world, scenarios[index], point), abs=1e-12)
        assert segments[i] == pytest.approx(expected_clearance(world, scenarios[index], segment), abs=1e-12)
    assert (scenes.blocked(starts, scene) == (points == 0.0)).all()
    assert (points == 0.0).any()
    assert ((segments == 0.0) & (points > 0.0)).any()


@pytest.mark.parametrize("arena", ARENAS)
def test_no_point_of_a_hull_is_farther_from_everything_than_its_corners_are_from_one_thing(
    arena: str,
) -> None:
    rng = np.random.default_rng(5)
    world, scenarios = random_world(rng, ARENAS[arena], situations=3)
    scenes = Scenes.of(world, scenarios)
    corners = rng.uniform(-5, 5, (300, 1, 2)) + rng.uniform(-0.3, 0.3, (300, 4, 2))
    scene = rng.integers(0, len(scenes), 300)
    most = scenes.farthest_within(corners, scene)
    shares = rng.dirichlet(np.ones(4), (300, 20))
    points = np.concatenate([corners, shares @ corners], axis=1)
    left = scenes.clearance(points.reshape(-1, 2), np.repeat(scene, 24)).reshape(300, 24).max(axis=1)
    assert (left <= most + 1e-12).all()
    assert (np.abs(left - most) < 1e-9).mean() > 0.3  # where one thing is nearest to all of a hull
    corners[0, 1, 0] = np.nan
    assert not scenes.farthest_within(corners[:1], scene[:1]) < np.inf


@pytest.mark.parametrize("seed", range(3))
def test_clearance_of_a_polygonal_footprint_is_that_of_shapely(seed: int) -> None:
    rng = np.random.default_rng([seed, 3])
    world, scenarios = random_world(rng, ARENAS["box"], situations=4)
    scenes = Scenes.of(world, scenarios)
    footprint = Footprint("polygon", polygon=np.array([[-0.6, -0.3], [0.5, -0.4], [0.9, 0.0], [0.5, 0.6]]))
    poses = np.column_stack([rng.uniform(-5, 5, (60, 2)), rng.uniform(-np.pi, np.pi, 60)])
    scene = rng.integers(0, len(scenes), 60)
    clearance = scenes.footprint_clearance(poses, footprint, scene)
    for i, (x, y, theta) in enumerate(poses):
        turn = np.array([[np.cos(theta), -np.sin(theta)], [np.sin(theta), np.cos(theta)]])
        outline = shapely.Polygon(footprint.polygon @ turn.T + (x, y))
        expected = expected_clearance(world, scenarios[scene[i]], outline)
        assert clearance[i] == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize(
    "obstacle",
    [Obstacles(np.array([[0.0, 0.0, 0.1]])), Obstacles(polygons=(box_polygon((0, 0), (0.1, 0.1)),))],
)
def test_an_obstacle_within_the_footprint_leaves_no_clearance(obstacle: Obstacles) -> None:
    world = WorldMap("", load_map("maps/lab.yaml").path, "", ARENAS["box"], obstacle)
    scenes = Scenes.of(world, [None])
    clearance = scenes.footprint_clearance(np.zeros((1, 3)), Footprint.rectangle(2.0, 2.0), np.zeros(1, int))
    assert clearance[0] == 0.0


def test_a_round_footprint_takes_its_radius_off_the_clearance_of_a_point() -> None:
    world = load_map("maps/lab.yaml")
    scenes = Scenes.of(world, [None])
    pose, scene = np.array([[4.0, 0.0, 1.0], [4.75, 0.0, 1.0]]), np.zeros(2, int)
    round_robot = Footprint("circle", radius=0.2)
    assert scenes.footprint_clearance(pose, Footprint(), scene) == pytest.approx([0.85, 0.1])
    assert scenes.footprint_clearance(pose, round_robot, scene) == pytest.approx([0.65, 0.0])


def test_many_points_are_measured_in_chunks_with_the_same_result() -> None:
    world = load_map("maps/lab.yaml")
    scenes = Scenes.of(world, world.scenarios)
    rng = np.random.default_rng(4)
    points, scene = rng.uniform(-5, 5, (100_000, 2)), rng.integers(0, len(scenes), 100_000)
    together = scenes.clearance(points, scene)
    alone = scenes.clearance(points[50_000:50_010], scene[50_000:50_010])
    assert (together[50_000:50_010] == alone).all()


def test_the_drawn_region_covers_every_circle() -> None:
    world = load_map("maps/lab.yaml")
    region = Scenes.of(world, [None]).shapely(0)
    for x, y, radius in world.obstacles.circles:
        angle = np.linspace(0.0, 2.0 * np.pi, 999)
        rim = shapely.points(x + radius * np.cos(angle), y + radius * np.sin(angle))
        assert shapely.distance(region, rim).max() < 1e-12
        assert region.intersection(shapely.Point(x, y).buffer(1.2 * radius)).area < 1.01 * np.pi * radius**2
    assert region.covers(shapely.Point(5.0, 0.0))  # outside of the arena
    assert not region.intersects(shapely.Point(0.0, 0.0))
