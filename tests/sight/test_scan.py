from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.sight.ray_oracle import outlines, ranges, scan
from tests.world.random_worlds import ARENAS, random_world
from viatool.sets.forms import PoseBoxes
from viatool.sight import circles as circle_sight
from viatool.sight import compiled, glimpses
from viatool.sight import edges as edge_sight
from viatool.sight import scan as sight
from viatool.sight.scan import enclose_losing, enclose_scan
from viatool.sight.shapes import Shapes
from viatool.sight.windows import Windows
from viatool.world import Lidar, Obstacles, OccupancyGrid, Scenes, WorldMap, load_map

LIDAR = Lidar(math.pi, 36, 6, 0.2, 5.0)
WHOLE_TURN = Lidar(2 * math.pi, 24, 24, 0.05, 12.0)
SINGLE = Lidar(1.0, 1, 1, 0.0, 6.0)
LIDARS = {"half turn": LIDAR, "whole turn": WHOLE_TURN, "one ray": SINGLE}
ROUNDING = 1e-8  # of the oracle, near tangents


def boxes_in(world, scenario, generator, count, sizes=(0.002, 0.02, 0.1, 0.3)):
    """Boxes of all sizes and shapes whose places are free."""
    scenes = Scenes.of(world, [scenario])
    x0, y0, x1, y1 = world.bounds
    centre = generator.uniform((x0, y0, -4.0), (x1, y1, 4.0), (20 * count, 3))
    radius = generator.choice(sizes, (20 * count, 1)) * generator.choice([0.0, 0.3, 1.0], (20 * count, 3))
    free = scenes.clearance(centre[:, :2], np.zeros(20 * count, np.int64)) > np.hypot(*radius.T[:2]) + 0.01
    return PoseBoxes(centre[free][:count], radius[free][:count])


def excess(world, scenario, boxes, lidar, generator, samples=64):
    """By how much sampled readings leave their enclosure at most; corners of the boxes are among the samples."""
    forms = enclose_scan(boxes, Shapes.of(world, scenario), lidar)
    z = generator.uniform(-1, 1, (len(boxes), samples, 3))
    z[:, : samples // 3] = np.sign(z[:, : samples // 3])
    poses = boxes.centre[:, None] + z * boxes.radius[:, None]
    readings = scan(poses.reshape(-1, 3), lidar, outlines(world, scenario)).reshape(len(boxes), samples, -1)
    linear = forms.centre[:, None] + np.einsum("cjk,csj->csk", forms.slope, z)
    assert (readings >= forms.lower[:, None] - ROUNDING).all()
    assert (readings <= forms.upper[:, None] + ROUNDING).all()
    return float((np.abs(readings - linear) - forms.rest[:, None]).max())


@pytest.mark.parametrize("name", LIDARS)
@pytest.mark.parametrize("arena", ARENAS)
def test_readings_lie_within_their_forms(arena, name):
    for seed in range(3):
        generator = np.random.default_rng(seed)
        world, scenarios = random_world(generator, ARENAS[arena], 2)
        boxes = boxes_in(world, scenarios[0], generator, 120)
        assert excess(world, scenarios[0], boxes, LIDARS[name], generator) <= ROUNDING


NUMBERED = Lidar(math.pi, 36, 6, 0.2, 5.0, no_return=0.0)
FAR_OFF = Lidar(math.pi, 36, 6, 0.2, 5.0, no_return=9.0)
OTHERS = {"half turn": LIDAR, "whole turn": WHOLE_TURN, "a number": NUMBERED, "a large number": FAR_OFF}


def beyond(world, scenario, boxes, lidar, lost, generator, samples=40):
    """By how much sampled bins exceed their bounds when their nearest rays are lost, (C, samples, bins)."""
    most = enclose_losing(boxes, Shapes.of(world, scenario), lidar, lost)[1]
    z = generator.uniform(-1, 1, (len(boxes), samples, 3))
    z[:, : samples // 3] = np.sign(z[:, : samples // 3])
    poses = (boxes.centre[:, None] + z * boxes.radius[:, None]).reshape(-1, 3)
    rays = ranges(poses, lidar.angles(), outlines(world, scenario), lidar.maximum_range)
    rays = np.maximum(rays, lidar.minimum_range)
    if lidar.no_return is not None:
        rays = np.where(rays < lidar.maximum_range, rays, lidar.no_return)
    rays = np.sort(rays.reshape(len(boxes), samples, lidar.bins, -1), axis=3)
    nothing = lidar.maximum_range if lidar.no_return is None else lidar.no_return
    left = rays[..., lost] if lost < lidar.each else np.full(rays.shape[:3], nothing)
    return left - most[:, None]


@pytest.mark.parametrize("lost", [1, 2, 5, 6])
@pytest.mark.parametrize("name", OTHERS)
def test_bins_whose_rays_return_nothing_read_no_more_than_their_bounds(name, lost):
    lidar = OTHERS[name]
    for seed in range(2):
        generator = np.random.default_rng(seed)
        world, scenarios = random_world(generator, ARENAS["box"], 2)
        boxes = boxes_in(world, scenarios[0], generator, 120)
        assert beyond(world, scenarios[0], boxes, lidar, lost, generator).max() <= ROUNDING
        forms, _ = enclose_losing(boxes, Shapes.of(world, scenarios[0]), lidar, lost)
        plain = enclose_scan(boxes, Shapes.of(world, scenarios[0]), lidar)
        for part in ("centre", "slope", "rest"):
            np.testing.assert_allclose(getattr(forms, part), getattr(plain, part), rtol=0.0, atol=1e-8)


def test_at_a_single_pose_the_bounds_without_rays_are_what_the_others_read():
    lab = load_map(Path("maps/lab.yaml"))
    generator = np.random.default_rng(3)
    centre = boxes_in(lab, lab.scenarios[0], generator, 200).centre
    left = beyond(lab, lab.scenarios[0], PoseBoxes(centre, 0.0 * centre), lab.robot.lidar, 2, generator, 1)
    assert (np.abs(left) < 1e-7).mean() > 0.99


def test_a_mutant_that_loses_a_ray_less_is_caught(monkeypatch):
    right = sight._most_without
    monkeypatch.setattr(
        sight, "_most_without", lambda rays, lidar, lost, slack: right(rays, lidar, lost - 1, slack)
    )
    generator = np.random.default_rng(0)
    world, scenarios = random_world(generator, ARENAS["box"], 2)
    boxes = boxes_in(world, scenarios[0], generator, 120)
    assert beyond(world, scenarios[0], boxes, LIDAR, 2, generator).max() > 0.1


def test_readings_of_occupied_cells_lie_within_their_forms():
    generator = np.random.default_rng(1)
    cells = (generator.random((14, 18)) < 0.12).astype(np.uint8)
    grid = OccupancyGrid(cells, 0.5, (-4.0, -3.0, 0.4))
    world = WorldMap("grid", Path("grid.yaml"), "", grid.outline, Obstacles(grid=grid))
    boxes = boxes_in(world, None, generator, 300, sizes=(0.002, 0.02, 0.06))
    assert excess(world, None, boxes, LIDAR, generator) <= ROUNDING


@pytest.mark.parametrize("touching", [-1e-3, -1e-6, 0.0, 1e-6, 1e-3])
def test_a_ray_that_grazes_a_circle_may_see_it_or_not(touching):
    """The only ray passes a circle of 0.5 m at its rim; turning the robot by a little gains or loses it."""
    world = WorldMap(
        "one", Path("one.yaml"), "", ARENAS["box"], Obstacles(np.array([[2.0, 0.5 + touching, 0.5]]))
    )
    boxes = PoseBoxes(np.zeros((1, 3)), np.array([[0.01, 0.01, 0.01]]))
    forms = enclose_scan(boxes, Shapes.of(world, None), SINGLE)
    assert forms.lower[0, 0] < 2.0
    assert forms.upper[0, 0] >= 5.0
    assert excess(world, None, boxes, SINGLE, np.random.default_rng(0), 3000) <= ROUNDING


def test_the_edge_of_a_box_that_some_poses_see_and_others_miss():
    box = np.array([[1.0, 0.0], [2.0, 0.0], [2.0, 1.0], [1.0, 1.0]])
    world = WorldMap("one", Path("one.yaml"), "", ARENAS["box"], Obstacles(polygons=(box,)))
    boxes = PoseBoxes(np.array([[0.0, 0.0, 0.0], [0.0, 0.02, 0.0], [1.5, -0.2, 0.0]]), np.full((3, 3), 0.005))
    forms = enclose_scan(boxes, Shapes.of(world, None), SINGLE)
    assert forms.lower[0, 0] <= 1.0  # at the corner: either
    assert forms.upper[0, 0] >= 5.0
    assert forms.lower[1, 0] > 0.99  # all poses hit the near side
    assert forms.upper[1, 0] < 1.01
    assert forms.lower[2, 0] > 3.4  # along the lower side, 0.2 m away: the far wall
    assert excess(world, None, boxes, SINGLE, np.random.default_rng(0), 3000) <= ROUNDING


def test_any_ray_may_meet_what_is_within_the_box_also_at_the_seam_of_its_bearings():
    world = WorldMap("round", Path("round.yaml"), "", ARENAS["box"], Obstacles(np.array([[0.5, 0.0, 0.2]])))
    shapes, lidar = Shapes.of(world, None), Lidar(math.pi, 1, 1, 0.0, 5.0)
    for heading in np.linspace(-3.0, 3.0, 300):
        boxes = PoseBoxes(np.array([[0.0, 0.0, heading]]), np.array([[1.0, 0.0, 0.0]]))
        seam = -heading - np.pi - sight._slack(boxes, shapes, lidar) - 1e-9
        seam -= 2.0 * np.pi * np.floor((seam + np.pi) / (2.0 * np.pi))
        rays = tuple((seam + np.arange(-2, 3) * np.spacing(seam)).tolist())
        around = replace(lidar, field_of_view=None, listed=rays, rays=5, bins=5)
        forms = enclose_scan(boxes, shapes, around)
        assert (forms.lower <= 0.1).all(), (heading, rays)


def test_a_single_pose_gets_what_a_cast_ray_gives():
    lab = load_map(Path("maps/lab.yaml"))
    generator = np.random.default_rng(3)
    centre = boxes_in(lab, lab.scenarios[0], generator, 200).centre
    boxes = PoseBoxes(centre, np.zeros_like(centre))
    forms = enclose_scan(boxes, Shapes.of(lab, lab.scenarios[0]), lab.robot.lidar)
    readings = scan(centre, lab.robot.lidar, outlines(lab, lab.scenarios[0]))
    sharp = forms.rest < 1e-6  # but for the few rays that pass within the rounding of an edge or a rim
    assert sharp.mean() > 0.999
    np.testing.assert_allclose(forms.centre[sharp], readings[sharp], atol=1e-7)


def test_the_rest_is_small_beside_the_readings_that_are_sampled():
    """In the lab, 2 cm and 1.1 degrees: what is not linear is a few millimetres, hardly more than sampling shows."""
    lab = load_map(Path("maps/lab.yaml"))
    generator = np.random.default_rng(4)
    centre = boxes_in(lab, lab.scenarios[0], generator, 150).centre
    boxes = PoseBoxes(centre, np.tile([0.01, 0.01, 0.01], (len(centre), 1)))
    forms = enclose_scan(boxes, Shapes.of(lab, lab.scenarios[0]), lab.robot.lidar)
    z = generator.uniform(-1, 1, (len(boxes), 200, 3))
    z[:, :80] = np.sign(z[:, :80])
    poses = (boxes.centre[:, None] + z * 0.01).reshape(-1, 3)
    readings = scan(poses, lab.robot.lidar, outlines(lab, lab.scenarios[0])).reshape(len(boxes), 200, -1)
    left = readings - np.einsum("cjk,csj->csk", forms.slope, z)
    sampled = np.ptp(left, axis=1)
    assert np.median(2.0 * forms.rest) < 3e-3
    assert np.median(2.0 * forms.rest) < 2.5 * np.median(sampled)
    assert (2.0 * forms.rest > 0.1).mean() < 1.5 * (sampled > 0.1).mean()


def no_error(distance, rays):
    return 0.0 * rays.turn


MUTANTS = {
    "turning of circles": (circle_sight, "turning_error", lambda right: no_error),
    "turning of ends": (edge_sight, "turning_error", lambda right: no_error),
    "tangent of a circle": (
        circle_sight,
        "height_bounds",
        lambda right: (
            lambda b, m, r: (lambda s, t, c: (s, r * np.sqrt(1 - np.square(b / r).clip(0, 1)), c))(
                *right(b, m, r)
            )
        ),
    ),
    "chord of a circle": (
        circle_sight,
        "height_bounds",
        lambda right: lambda b, m, r: (lambda s, t, c: (s, t, t))(*right(b, m, r)),
    ),
    "curvature of the secant": (
        edge_sight,
        "secant_rest",
        lambda right: lambda d, n, p, t, s: (right(d, n, p, t, s)[0],) * 2,
    ),
    "moving and turning": (
        edge_sight,
        "secant_rest",
        lambda right: lambda d, n, p, t, s: right(d, 0.0 * n, p, t, s),
    ),
    "sideways": (glimpses.Rays, "spread", lambda right: lambda rays, direction: 0.0 * rays.turn),
    "bearings of circles": (circle_sight, "half_angle", lambda right: lambda r, d: 0.7 * right(r, d)),
    "bearings of edges": (edge_sight, "half_angle", lambda right: lambda r, d: 0.0 * right(r, d)),
    "other slopes than the reference's": (
        sight,
        "_apart",
        lambda right: lambda slope, reference: 0.0 * right(slope, reference),
    ),
}


def worst_excess():
    """By how much readings leave their forms in a few scenes; infinite if they leave the bounds as well."""
    worst = 0.0
    for seed in range(4):
        generator = np.random.default_rng(seed)
        world, scenarios = random_world(generator, ARENAS["box"], 2)
        boxes = boxes_in(world, scenarios[0], generator, 150, sizes=(0.05, 0.2))
        boxes.radius[75:, 2] *= 4.0
        try:
            worst = max(worst, excess(world, scenarios[0], boxes, LIDARS["half turn"], generator))
        except AssertionError:
            return math.inf
    return worst


@pytest.mark.parametrize("engine", ["numpy"], indirect=True)
@pytest.mark.parametrize("name", MUTANTS)
def test_cast_rays_catch_an_enclosure_without_one_of_its_rules(monkeypatch, name):
    module, function, mutate = MUTANTS[name]
    monkeypatch.setattr(module, function, mutate(getattr(module, function)))
    assert worst_excess() > 1e-5


@pytest.mark.parametrize("engine", ["compiled"], indirect=True)
@pytest.mark.parametrize("name", [name for name, _ in compiled.Leeway._fields_])
def test_cast_rays_catch_a_compiled_enclosure_without_one_of_its_rules(monkeypatch, name):
    leeway = compiled.Leeway(*(0.0 if other == name else 1.0 for other, _ in compiled.Leeway._fields_))
    monkeypatch.setattr(sight, "fan_of", lambda shapes, lidar: compiled.PackedFan.of(shapes, lidar, leeway))
    assert worst_excess() > 1e-5


@pytest.mark.parametrize("arena", ARENAS)
@pytest.mark.parametrize("name", LIDARS)
def test_both_engines_give_the_same_forms_and_gaps(arena, name, monkeypatch):
    generator = np.random.default_rng(5)
    world, scenarios = random_world(generator, ARENAS[arena], 2)
    boxes, shapes = boxes_in(world, scenarios[0], generator, 200), Shapes.of(world, scenarios[0])
    found = {}
    for engine in ("compiled", "numpy"):
        monkeypatch.setenv("VIATOOL_ENGINE", engine)
        forms, gaps = enclose_scan(boxes, shapes, LIDARS[name]), sight.gaps_of(boxes, shapes, LIDARS[name])
        at = Windows(np.where(gaps.width > 0, gaps.middle, -np.inf), np.full(gaps.width.shape, np.inf))
        side, _ = enclose_losing(boxes, shapes, LIDARS[name], 0, at)
        found[engine] = forms, side, gaps
    for ours, theirs in zip(*found.values(), strict=True):
        for part in vars(ours):
            np.testing.assert_allclose(getattr(ours, part), getattr(theirs, part), rtol=0.0, atol=1e-8)


def test_what_the_compiled_engine_leaves_is_enclosed_by_numpy(monkeypatch):
    def leave_some(fan, boxes, slack, windows):
        forms, done = scan_of(fan, boxes, slack, windows)
        done[::3] = False
        forms.centre[::3], forms.rest[::3] = np.nan, np.nan
        return forms, done

    scan_of = sight.scan
    monkeypatch.setattr(sight, "scan", leave_some)
    generator = np.random.default_rng(0)
    world, scenarios = random_world(generator, ARENAS["box"], 2)
    boxes = boxes_in(world, scenarios[0], generator, 120)
    assert excess(world, scenarios[0], boxes, LIDAR, generator) <= ROUNDING
