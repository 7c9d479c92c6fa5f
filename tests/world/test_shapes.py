from __future__ import annotations

import numpy as np
import pytest
import shapely

from viatool.errors import ConfigurationError, MapError
from viatool.world import (
    ROBOTS,
    Footprint,
    Lidar,
    Obstacles,
    bin_ranges,
    box_polygon,
    simple_polygon,
    wall_polygons,
)
from viatool.world.rings import centroid, is_convex, signed_area


def test_a_box_has_its_size_and_yaw() -> None:
    box = box_polygon((1.0, 2.0), (4.0, 2.0), np.pi / 6)
    assert signed_area(box) == pytest.approx(8.0)
    assert box.mean(axis=0) == pytest.approx([1.0, 2.0])
    along = box[1] - box[0]
    assert np.arctan2(along[1], along[0]) == pytest.approx(np.pi / 6)
    assert np.hypot(*along) == pytest.approx(4.0)


def test_boxes_come_in_batches() -> None:
    yaw = np.linspace(-3, 3, 6).reshape(2, 3)
    boxes = box_polygon(np.zeros((2, 3, 2)), (1.0, 2.0), yaw)
    assert boxes.shape == (2, 3, 4, 2)
    assert boxes[1, 2] == pytest.approx(box_polygon((0, 0), (1.0, 2.0), yaw[1, 2]))


def test_a_bent_wall_has_no_notch() -> None:
    points = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 3.0]])
    wall = shapely.union_all([shapely.Polygon(box) for box in wall_polygons(points, 0.2)])
    outline = shapely.LineString(points).buffer(0.1, cap_style="square", join_style="mitre")
    assert wall.symmetric_difference(outline).area < 1e-9


def test_polygons_are_turned_counter_clockwise_and_opened() -> None:
    ring = simple_polygon([[0, 0], [0, 1], [1, 1], [1, 0], [0, 0]])
    assert ring.shape == (4, 2)
    assert signed_area(ring) == pytest.approx(1.0)
    assert centroid(ring) == pytest.approx([0.5, 0.5])


@pytest.mark.parametrize(
    ("points", "reason"),
    [
        ([[0, 0], [1, 1], [1, 0], [0, 1]], "not a simple polygon: Self-intersection at"),
        ([[0, 0], [1, 0], [0, 0]], "2 distinct corners"),
        ([[0, 0], [1, 0], [2, 0]], "island is"),
    ],
)
def test_impossible_polygons_are_refused(points: list[list[float]], reason: str) -> None:
    with pytest.raises(MapError, match=reason if "island" not in reason else "island"):
        simple_polygon(points, "island")


def test_convexity() -> None:
    assert is_convex(box_polygon((0, 0), (1, 2), 0.3))
    assert not is_convex(simple_polygon([[0, 0], [2, 0], [2, 2], [1, 0.5]]))


def test_centroids_stand_in_for_the_centres_of_polygons() -> None:
    obstacles = Obstacles(np.array([[1.0, 1.0, 0.5]]), (box_polygon((-3, 2), (1, 2), 0.3),))
    assert obstacles.centres() == pytest.approx(np.array([[1.0, 1.0], [-3.0, 2.0]]))
    assert len(obstacles) == 2
    assert len(obstacles + obstacles) == 4
    assert len(Obstacles().edges()) == 0


def test_rays_are_binned_in_order() -> None:
    lidar = Lidar(rays=6, bins=3)
    binned = bin_ranges(np.array([[1.0, 2.0, 4.0, 3.0, 6.0, 5.0]]), lidar)
    assert binned.tolist() == [[1.0, 3.0, 5.0]]


@pytest.mark.parametrize(
    "wrong",
    [
        {"rays": 181},
        {"bins": 0},
        {"field_of_view": 7.0},
        {"minimum_range": 8.0},
        {"maximum_range": float("inf")},
        {"noise": -0.1},
    ],
)
def test_impossible_lidars_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(ConfigurationError, match="LiDAR"):
        Lidar(**wrong)  # type: ignore[arg-type]


def test_known_robots_carry_their_names_and_footprints_their_reach() -> None:
    assert all(name == robot.name for name, robot in ROBOTS.items())
    assert ROBOTS["jackal"].footprint.reach == pytest.approx(np.hypot(0.254, 0.215))
    assert Footprint().reach == 0.0
