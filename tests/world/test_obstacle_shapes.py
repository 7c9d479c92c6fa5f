"""What the geometry makes of the shapes in a map file."""

from __future__ import annotations

from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from viatool.world import Obstacles, load_map
from viatool.world.obstacle_shapes import SHAPES, Circle, Obstacle

MAP = """\
arena: {shape: polygon, points: [[-3, -3], [3, -3], [3, 3], [-3, 3]]}
obstacles:
  - {shape: wall, points: [[-2, 2], [0, 2], [0, 1]], thickness: 0.2}
  - {shape: box, center: [1, 1], size: [1, 0.5], yaw: 0.3}
  - {shape: circle, center: [-1, -1], radius: 0.4}
  - {shape: polygon, points: [[1, -1], [2, -1], [2, -2]]}
generator: {}
"""


@pytest.fixture
def written(tmp_path: Path) -> Path:
    (tmp_path / "map.yaml").write_text(MAP, encoding="utf-8")
    return tmp_path / "map.yaml"


def test_every_shape_is_known_by_its_name():
    assert SHAPES == ("circle", "box", "polygon", "wall")
    assert len(SHAPES) == len(get_args(get_args(Obstacle)[0]))


def test_every_shape_becomes_circles_and_polygons_walls_last(written):
    world = load_map(written)
    np.testing.assert_array_equal(world.obstacles.circles, [[-1.0, -1.0, 0.4]])
    box, triangle, *wall = world.obstacles.polygons
    assert np.ptp(box[[0, 1]], axis=0) == pytest.approx([np.cos(0.3), np.sin(0.3)])
    assert len(triangle) == 3
    assert [np.ptp(part, axis=0).tolist() for part in wall] == [
        pytest.approx([2.2, 0.2]), pytest.approx([0.2, 1.2])
    ]  # fmt: skip


def test_random_places_keep_from_the_centres_of_all_but_the_walls(written):
    centres = load_map(written).generator.centres
    assert centres == pytest.approx(np.array([[-1.0, -1.0], [1.0, 1.0], [5 / 3, -4 / 3]]))


def test_a_shape_without_a_solid_is_never_taken_for_free_space(written, monkeypatch):
    monkeypatch.setattr(Circle, "solid", lambda shape: Obstacles())
    with pytest.raises(TypeError, match="shape 'circle' has no solid"):
        load_map(written)


def test_sets_together_are_those_that_are_added():
    parts = [
        Obstacles(np.array([[0.0, 0.0, 1.0]])),
        Obstacles(polygons=([[2, 0], [3, 0], [3, 1]],)),
        Obstacles(),
    ]
    both, added = Obstacles.together(parts), parts[0] + parts[1]
    np.testing.assert_array_equal(both.circles, added.circles)
    np.testing.assert_array_equal(both.polygons[0], added.polygons[0])
    assert len(Obstacles.together([])) == 0
