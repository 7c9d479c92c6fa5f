"""Poses in scenes: the rounding of large geometry is counted, and scenes stay with their poses."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mpmath
import numpy as np
import pytest

from tests.safety.brute_force import random_world
from viatool.motion.manoeuvre import Manoeuvre
from viatool.safety import ScenePoses, enclosure, scene_poses
from viatool.safety.enclosure import MotionBoxes, enclose
from viatool.world import Footprint, Obstacles, OccupancyGrid, Scenario, WorldMap

FAR = 4e5
COUNT = 200
BOX = np.array([[-3.0, -3.0], [3.0, -3.0], [3.0, 3.0], [-3.0, 3.0]])


def world(arena=BOX, **obstacles):
    return WorldMap("large", Path("large.yaml"), "", arena, Obstacles(**obstacles))


def circles(generator):
    """One that passes the origin at half a metre, however large it is."""
    angle, radius = generator.uniform(0.0, 6.0), generator.uniform(0.3, 1.0) * FAR
    x, y = (radius + 0.5) * np.cos(angle), (radius + 0.5) * np.sin(angle)
    return np.array([[x, y, radius]])


def of_circle(circle):
    (x, y, radius) = (mpmath.mpf(float(number)) for number in circle)
    return lambda px, py: mpmath.sqrt((x - px) ** 2 + (y - py) ** 2) - radius


def of_line(first, second):
    (ax, ay), (bx, by) = ((mpmath.mpf(float(x)), mpmath.mpf(float(y))) for x, y in (first, second))
    length = mpmath.sqrt((bx - ax) ** 2 + (by - ay) ** 2)
    return lambda px, py: ((bx - ax) * (py - ay) - (by - ay) * (px - ax)) / length


def large(kind, generator):
    """A map with something large, its scenario, and the exact distance from it."""
    if kind == "circle of the map":
        some = circles(generator)
        return world(circles=some), None, of_circle(some[0])
    if kind == "circle of the scenario":
        some = circles(generator)
        scenario = Scenario("far", (0.0, 0.0, 0.0), (1.0, 0.0), Obstacles(circles=some))
        return world(), scenario, of_circle(some[0])
    tilt = generator.uniform(-0.3, 0.3) * FAR
    if kind == "polygon":
        ring = np.array([[-FAR, 0.5 - tilt], [FAR, 0.5 + tilt], [0.0, 2.0 * FAR]])
        inside = of_line(ring[0], ring[1])
        return world(polygons=(ring,)), None, lambda x, y: -inside(x, y)
    arena = np.array([[-FAR, -0.5 - tilt], [FAR, -0.5 + tilt], [FAR, 2 * FAR], [-FAR, 2 * FAR]])
    return world(arena), None, of_line(arena[0], arena[1])


def excess(kind):
    """By how much the bound for robots at rest exceeds their exact clearance at most, in metres."""
    generator, worst = np.random.default_rng(0), -np.inf
    still = MotionBoxes.whole(np.zeros((COUNT // 20, 2)), np.zeros((COUNT // 20, 2)))
    with mpmath.workdps(60):
        for _ in range(20):
            some, scenario, exact = large(kind, generator)
            poses = generator.uniform(-0.1, 0.1, (COUNT // 20, 3))
            where = ScenePoses.of(some, [scenario], poses, np.zeros(len(poses), np.int64))
            least = enclose(still, where, Manoeuvre(0.1), Footprint()).least
            for (x, y, _), bound in zip(poses.tolist(), least.tolist(), strict=True):
                worst = max(worst, float(mpmath.mpf(bound) - exact(mpmath.mpf(x), mpmath.mpf(y))))
    return worst


KINDS = ("circle of the map", "circle of the scenario", "polygon", "arena")


@pytest.mark.parametrize("kind", KINDS)
def test_the_rounding_of_large_geometry_is_counted(kind):
    assert -1e-3 < excess(kind) <= 0.0


@pytest.mark.parametrize("kind", KINDS)
def test_exact_distances_catch_a_bound_without_rounding(monkeypatch, kind):
    monkeypatch.setattr(enclosure, "DISTANCE_ROUNDING", 0.0)
    assert excess(kind) > 0.0


@pytest.mark.parametrize("kind", KINDS)
def test_exact_distances_catch_a_scale_that_forgets_the_geometry(monkeypatch, kind):
    right = vars(ScenePoses)["of"].__func__
    monkeypatch.setattr(ScenePoses, "of", classmethod(lambda cls, *a: replace(right(cls, *a), scale=1.0)))
    assert excess(kind) > 0.0


@pytest.mark.parametrize("kind", KINDS[:3])
def test_exact_distances_catch_a_scale_that_forgets_the_obstacles(monkeypatch, kind):
    monkeypatch.setattr(scene_poses, "_extent", lambda obstacles: 0.0)
    assert excess(kind) > 0.0


def scale(some, *scenarios):
    return ScenePoses.of(some, scenarios or [None], np.zeros((1, 3)), np.zeros(1, np.int64)).scale


def test_the_scale_bounds_every_coordinate_and_radius():
    grid = OccupancyGrid(np.ones((4, 6), np.uint8), 0.5, (-40.0, 2.0, 0.0))
    ring = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, -80.0]])
    own = Obstacles(circles=np.array([[0.0, 0.0, 90.0]]))
    scenario = Scenario("own", (0.0, 0.0, 0.0), (1.0, 0.0), own)
    assert scale(world()) >= 1.0 + 3.0
    assert scale(world(BOX + np.array([100.0, 0.0]))) >= 1.0 + 103.0
    assert scale(world(circles=np.array([[-50.0, 0.0, 1.0]]))) >= 1.0 + 50.0
    assert scale(world(circles=np.array([[0.0, 0.0, 60.0]]))) >= 1.0 + 60.0
    assert scale(world(polygons=(ring,))) >= 1.0 + 80.0
    assert scale(world(grid=grid)) >= 1.0 + 40.0
    assert scale(world(), None, scenario) >= 1.0 + 90.0


def two_scenes():
    """Three poses at the same place: the obstacle there is the second scenario's alone."""
    there = Scenario("there", (0.0, 0.0, 0.0), (1.0, 0.0), Obstacles(circles=np.array([[0.0, 0.0, 0.5]])))
    poses = np.array([[0.6, 0.0, 0.0], [0.6, 0.0, 1.0], [1.0, 0.0, 2.0]])
    return ScenePoses.of(world(), [None, there], poses, np.array([0, 1, 1]))


def test_every_pose_is_among_the_obstacles_of_its_own_scenario():
    some = two_scenes()
    away = some.still.clearance(some.poses[:, :2], some.scene)
    np.testing.assert_allclose(away, [2.4, 0.1, 0.5])


@pytest.mark.parametrize("which", [np.array([2, 0, 2]), np.array([True, False, True]), np.zeros(0, int)])
def test_a_selection_takes_poses_scenes_and_boxes_along(which):
    some = replace(two_scenes(), radii=np.arange(9.0).reshape(3, 3))
    picked = some.select(which)
    for part in ("poses", "scene", "radii"):
        np.testing.assert_array_equal(getattr(picked, part), getattr(some, part)[which])
    assert len(picked) == len(some.poses[which])
    assert picked.scale == some.scale
    assert two_scenes().select(which).radii is None


def test_moving_keeps_everything_but_the_poses():
    some = replace(two_scenes(), radii=np.ones((3, 3)))
    moved = some.moved(some.poses + 1.0)
    np.testing.assert_array_equal(moved.poses, some.poses + 1.0)
    np.testing.assert_array_equal(moved.scene, some.scene)
    np.testing.assert_array_equal(moved.radii, some.radii)
    assert moved.still is some.still


def test_a_crowded_room_has_the_scale_of_its_walls():
    assert 4.0 <= scale(random_world(0)) < 6.0
