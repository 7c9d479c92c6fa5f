from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from viatool.errors import ConfigurationError, MapError, TrajectoryError, ViatoolError
from viatool.trajectory import read_scenario
from viatool.world import (
    Footprint,
    Lidar,
    Obstacles,
    OccupancyGrid,
    Robot,
    Scenario,
    Scenes,
    WorldMap,
    load_map,
    simple_polygon,
    wall_polygons,
)
from viatool.world.measurement import as_plane
from viatool.world.rings import LEAST_EDGE, signed_area

SQUARE = np.array([[-2.0, -2.0], [2.0, -2.0], [2.0, 2.0], [-2.0, 2.0]])
HOLLOW = np.array([[-2.0, -2.0], [2.0, -2.0], [0.5, 0.5], [2.0, 2.0], [-2.0, 2.0]])
NAN, INFINITE = float("nan"), float("inf")


def world(arena: Any = SQUARE, *polygons: Any) -> WorldMap:
    return WorldMap("made", Path("made.yaml"), "", arena, Obstacles(polygons=polygons))


@st.composite
def repeated(draw: st.DrawFn, ring: np.ndarray) -> np.ndarray:
    """Return the corners of a ring, some of them several times, exactly or nearly."""
    corners = []
    for corner in ring:
        shifts = draw(st.lists(st.sampled_from([0.0, 1e-300, 4e-16, -1e-12, 3e-10]), max_size=3))
        corners += [corner, *(corner + shift for shift in shifts)]
    return np.array(corners)


@pytest.mark.parametrize("ring", [SQUARE, HOLLOW, SQUARE[::-1]], ids=["square", "hollow", "clockwise"])
@given(data=st.data())
def test_repeated_corners_change_nothing(ring: np.ndarray, data: st.DataObject) -> None:
    mended = simple_polygon(data.draw(repeated(ring)))
    assert len(mended) == len(ring)
    assert {tuple(corner) for corner in mended.tolist()} == {tuple(corner) for corner in ring.tolist()}
    assert signed_area(mended) > 0.0


@pytest.mark.parametrize("ring", [SQUARE, HOLLOW], ids=["convex", "hollow"])
def test_a_corner_that_stands_twice_does_not_change_what_is_measured(ring: np.ndarray) -> None:
    rng = np.random.default_rng(3)
    poses = rng.uniform(-3.0, 3.0, (500, 3))
    scene, plate = np.zeros(len(poses), np.int64), Footprint.rectangle(0.3, 0.2)
    inner = 0.2 * ring + 0.1
    plain = Scenes.of(world(ring, inner), [None])
    twice = Scenes.of(world(np.repeat(ring, 2, axis=0), np.repeat(inner, 3, axis=0)), [None])
    for found, expected in (
        (twice.clearance(poses[:, :2], scene), plain.clearance(poses[:, :2], scene)),
        (twice.footprint_clearance(poses, plate, scene), plain.footprint_clearance(poses, plate, scene)),
        (twice.cast(poses, scene, Lidar()), plain.cast(poses, scene, Lidar())),
    ):
        assert np.isfinite(found).all()
        assert np.array_equal(found, expected)


def test_repeated_corners_of_walls_footprints_and_stored_scenarios_are_dropped() -> None:
    line = [[0.0, 0.0], [1.0, 0.0], [1.0, 0.0], [1.0, 1.0]]
    assert len(wall_polygons(line, 0.1)) == 2
    assert len(Footprint("polygon", polygon=np.repeat(0.1 * SQUARE, 2, axis=0)).polygon) == 4
    ring = str(np.repeat(SQUARE, 2, axis=0).tolist())
    scenario = read_scenario(
        f'{{"name": "a", "start": [0, 0, 0], "goal": [1, 1], "circles": [], "polygons": [{ring}]}}'
    )
    assert scenario is not None
    assert len(scenario.obstacles.polygons[0]) == 4


def test_clockwise_obstacles_are_turned() -> None:
    box = 0.2 * SQUARE
    scenes = Scenes.of(world(SQUARE, box[::-1]), [None])
    assert scenes.clearance(np.zeros((1, 2)), np.zeros(1, np.int64)).tolist() == [0.0]
    assert scenes.cast(np.array([[1.0, 0.0, np.pi]]), np.zeros(1, np.int64), Lidar(rays=1, bins=1)) == (
        pytest.approx(0.6)
    )


@pytest.mark.parametrize(
    ("points", "message"),
    [
        ([[0, 0], [1, 0], [2, 0], [1, 1], [1, 0]], "not a simple polygon"),  # touches itself in a corner
        ([[0, 0], [2, 0], [2, 1], [1, 0], [0, 1]], "not a simple polygon"),  # touches an edge
        ([[0, 0], [1, 0], [1, 1], [0.5, 2], [1, 1], [0, 1]], "not a simple polygon"),  # a spike
        ([[0, 0], [2, 0], [1, 1], [2, 2], [0, 2], [1, 1]], "not a simple polygon"),
        ([[0, 0], [1, 0], [1, 1e-10], [0, 1e-10]], "distinct corners"),
        ([[0, 0], [1, 0], [0.5, 1e-10]], "no area"),
        ([[1, 1], [1, 1], [1, 1]], "1 distinct corners"),
        ([[0, 0], [0, NAN], [1, 1]], "corner 1, expected finite"),
        ([[0, 0], [INFINITE, 0], [1, 1]], "corner 1, expected finite"),
        ([[0, 0], [1e200, 0], [1, 1]], "corner 1, expected finite"),
        ([[0, 0, 0], [1, 0, 0], [1, 1, 0]], r"shape \(3, 3\)"),
        ([], "shape"),
        ([["a", 0], [1, 0], [1, 1]], "not points"),
        ([[0, 0], [10**400, 0], [1, 1]], "not points"),
    ],
)
@pytest.mark.parametrize("reverse", [False, True], ids=["forward", "backward"])
def test_outlines_without_an_inside_are_refused_by_name(
    points: list[Any], message: str, reverse: bool
) -> None:
    points = points[::-1] if reverse else points
    message = message if not reverse else message.replace("corner 1,", r"corner \d,")
    for made in (
        lambda: simple_polygon(points, "island"),
        lambda: Obstacles(polygons=(points,)),
        lambda: world(points),
        lambda: Footprint("polygon", polygon=points),  # type: ignore[arg-type]
    ):
        with pytest.raises(MapError, match=message):
            made()


@given(st.integers(3, 9), st.integers(0, 2**32 - 1))
def test_what_is_called_simple_is_valid_and_runs_counter_clockwise(count: int, seed: int) -> None:
    """Random corners, few of them on a coarse grid so that they repeat, touch and cross; shapely is the oracle."""
    points = np.random.default_rng(seed).integers(0, 4, (count, 2)).astype(float)
    kept = [second for first, second in pairwise([points[-1], *points]) if (first != second).any()]
    simple = len(kept) > 2 and shapely.Polygon(kept).is_valid and shapely.Polygon(kept).area > 0.0
    try:
        ring = simple_polygon(points)
    except MapError:
        assert not simple
    else:
        assert simple
        assert shapely.Polygon(ring).equals(shapely.Polygon(kept))
        assert shapely.LinearRing(ring).is_ccw


def test_star_shapes_that_turn_left_twice_are_not_taken_for_convex_ones() -> None:
    angles = 4.0 * np.pi * np.arange(5) / 5.0
    with pytest.raises(MapError, match="not a simple polygon"):
        simple_polygon(np.c_[np.cos(angles), np.sin(angles)])


@pytest.mark.parametrize(
    ("made", "message"),
    [
        (lambda: Obstacles(np.array([[0.0, 0.0, NAN]])), "circle 0"),
        (lambda: Obstacles(np.array([[0.0, 0.0, 1.0], [INFINITE, 0.0, 1.0]])), "circle 1"),
        (lambda: Obstacles(np.array([[0.0, 0.0, -0.5]])), "radius -0.5 m"),
        (lambda: Obstacles(np.array([[0.0, 0.0, 0.0]])), "radius 0 m"),
        (lambda: wall_polygons([[0, 0], [0, NAN]], 0.1), "wall has .* as corner 1"),
        (lambda: wall_polygons([[1, 1], [1, 1]], 0.1), "wall has no length"),
        (lambda: Footprint("circle", radius=NAN), "radius of nan m"),
        (lambda: Footprint("circle", radius=-0.1), "radius of -0.1 m"),
        (lambda: Footprint("disc", radius=0.1), "kind 'disc'"),  # type: ignore[arg-type]
        (lambda: Footprint("polygon"), "0 distinct corners"),
        (lambda: Robot(max_linear=NAN), "max_linear"),
        (lambda: Robot(max_angular=-1.0), "max_angular"),
        (lambda: Robot(min_linear=0.6), "below min_linear"),
        (lambda: Scenario("a", (0.0, 0.0, NAN), (1.0, 1.0)), "start of scenario 'a'"),
        (lambda: Scenario("a", (0.0, 0.0, 0.0), (INFINITE, 1.0)), "goal of scenario 'a'"),
        (lambda: OccupancyGrid(np.zeros((2, 2), np.uint8), 0.0), "cells of 0.0 m"),
        (lambda: OccupancyGrid(np.zeros((2, 2), np.uint8), NAN), "cells of nan m"),
        (lambda: OccupancyGrid(np.zeros((2, 2), np.uint8), -1.0), "cells of -1.0 m"),
        (lambda: OccupancyGrid(np.zeros((2, 0), np.uint8), 1.0), "shape"),
        (lambda: OccupancyGrid(np.zeros((2, 2), np.uint8), 1.0, (0.0, NAN, 0.0)), "origin"),
    ],
)
def test_what_has_no_extent_or_no_number_is_refused_by_name(made: Any, message: str) -> None:
    with pytest.raises((MapError, ConfigurationError), match=message):
        made()


@pytest.mark.parametrize("number", [".nan", ".inf", "-.inf", "1.0e+300", "1" + 400 * "0"])
@pytest.mark.parametrize(
    "part",
    [
        "arena: {shape: polygon, points: [[0, 0], [VALUE, 0], [4, 4], [0, 4]]}",
        "arena: {shape: box, center: [2, VALUE], size: [4, 4]}",
        "arena: {shape: box, center: [2, 2], size: [4, 4], yaw: VALUE}",
        "obstacles: [{shape: circle, center: [1, 1], radius: VALUE}]",
        "obstacles: [{shape: wall, points: [[1, 1], [VALUE, 2]]}]",
        "obstacles: [{shape: polygon, points: [[1, 1], [2, VALUE], [2, 2]]}]",
        "robot: {footprint: {shape: polygon, points: [[0, 0], [VALUE, 0], [0, 1]]}}",
        "robot: {min_linear: -1.0, deceleration: VALUE}",
        "clearance: {collision: VALUE}",
        "scenarios: [{start: [2, 2, VALUE], goal: [3, 3]}]",
    ],
)
def test_files_with_numbers_that_are_no_lengths_are_refused(tmp_path: Path, part: str, number: str) -> None:
    text = "arena: {shape: box, center: [2, 2], size: [4, 4]}\n" if not part.startswith("arena") else ""
    (tmp_path / "m.yaml").write_text(text + part.replace("VALUE", number))
    with pytest.raises(MapError, match=r"m.yaml:\d+: \w+"):
        load_map(tmp_path / "m.yaml")


@pytest.mark.parametrize("number", [".nan", "-.inf", "1.0e+300"])
def test_speeds_that_are_no_limits_are_refused(tmp_path: Path, number: str) -> None:
    text = "arena: {shape: box, center: [2, 2], size: [4, 4]}\nrobot: {max_linear: VALUE}"
    (tmp_path / "m.yaml").write_text(text.replace("VALUE", number))
    with pytest.raises(MapError, match=r"m.yaml:2: robot"):
        load_map(tmp_path / "m.yaml")


@pytest.mark.parametrize(
    ("part", "message"),
    [
        (
            "obstacles: [{shape: wall, points: [[1, 1], [1, 1]]}]",
            r"m.yaml:2: obstacles\[0\]: wall has no length",
        ),
        ("obstacles: [{shape: wall, name: fence, points: [[1, 1], [2, 1]], thickness: 1e-12}]", "fence has"),
        ("obstacles: [{shape: box, name: crate, center: [1, 1], size: [1e-12, 1]}]", "crate has"),
        ("obstacles: [{shape: polygon, points: [[1, 1], [2, 2], [3, 3]]}]", r"obstacles\[0\]: polygon"),
        ("robot: {footprint: {shape: polygon, points: [[0, 0], [1, 0], [2, 0]]}}", "robot: footprint"),
    ],
)
def test_files_with_shapes_without_extent_name_them(tmp_path: Path, part: str, message: str) -> None:
    (tmp_path / "m.yaml").write_text("arena: {shape: box, center: [2, 2], size: [4, 4]}\n" + part)
    with pytest.raises(MapError, match=message):
        load_map(tmp_path / "m.yaml")


@pytest.mark.parametrize(
    "field",
    ['"circles": [[0, 0, -1]], "polygons": []', '"circles": [], "polygons": [[[0, 0], [1, 0], [2, 0]]]'],
)
def test_stored_scenarios_with_impossible_obstacles_are_refused(field: str) -> None:
    with pytest.raises(TrajectoryError, match="trajectory has the scenario"):
        read_scenario(f'{{"name": "a", "start": [0, 0, 0], "goal": [1, 1], {field}}}')
    with pytest.raises(ViatoolError, match="start of scenario"):
        read_scenario('{"name": "a", "start": [0, 0, NaN], "goal": [1, 1], "circles": [], "polygons": []}')


@pytest.mark.filterwarnings("ignore:invalid value")
@pytest.mark.parametrize("arena", [SQUARE, HOLLOW], ids=["convex", "hollow"])
@pytest.mark.parametrize("wrong", [NAN, INFINITE, -INFINITE])
@pytest.mark.parametrize("grid", [False, True], ids=["shapes", "grid"])
def test_poses_that_are_nowhere_touch_everything(arena: np.ndarray, wrong: float, grid: bool) -> None:
    cells = OccupancyGrid(np.zeros((8, 8), np.uint8), 0.5, (-2.0, -2.0, 0.3)) if grid else None
    made = replace(world(arena), obstacles=Obstacles(np.array([[-1.5, 1.5, 0.1]]), (0.1 * SQUARE,), cells))
    poses = np.zeros((4, 3))
    poses[np.arange(3), np.arange(3)] = wrong
    poses[3] = -1.0, 0.0, 0.0
    scenes, index = Scenes.of(made, [None]), np.zeros(4, np.int64)
    clear = scenes.clearance(poses[:, :2], index)
    assert clear[:2].tolist() == [0.0, 0.0]
    assert clear[3] > 0.0
    assert scenes.blocked(poses[:, :2], index)[:2].all()
    for footprint in (Footprint("circle", radius=0.1), Footprint.rectangle(0.2, 0.1)):
        assert scenes.footprint_clearance(poses, footprint, index)[:2].tolist() == [0.0, 0.0]
        assert scenes.footprint_clearance(poses, footprint, index)[3] > 0.0
    assert scenes.footprint_clearance(poses, Footprint.rectangle(0.2, 0.1), index)[2] == 0.0
    assert scenes.segment_clearance(poses[:3, :2], poses[[3, 3, 0], :2], index[:3]).tolist() == [0.0] * 3
    for kind in (np.float32, np.float64):
        ranges = scenes.cast(poses, index, Lidar(), dtype=kind)
        assert (ranges[:3] == 0.0).all()
        assert (ranges[3] > 0.0).all()


@given(st.integers(0, 2**32 - 1), st.integers(-12, 5), st.sampled_from([1e-8, 1e-5, 0.1, 1.0]))
def test_no_distance_of_a_made_world_is_nan(seed: int, power: int, size: float) -> None:
    """Worlds from nanometres to a hundred kilometres, places on corners and edges included; shapely is the oracle."""
    rng, scale = np.random.default_rng(seed), 10.0**power
    arena = scale * (HOLLOW if seed % 2 else SQUARE)
    centre, turn = rng.uniform(-1.0, 0.4, 2), np.exp(2j * np.pi * rng.random())
    shape = turn * (size * 0.2) * as_plane(HOLLOW)
    ring = scale * (np.stack([shape.real, shape.imag], axis=1) + centre)
    try:
        made = world(arena, ring)
    except MapError:
        assert scale * size * 0.2 < 4 * LEAST_EDGE  # only what is thinner than a nanometre
        return
    places = np.concatenate(
        [rng.uniform(-2.5, 2.5, (20, 2)) * scale, arena, ring, 0.5 * (arena + arena[[-1]])]
    )
    scenes, index = Scenes.of(made, [None]), np.zeros(len(places), np.int64)
    clear = scenes.clearance(places, index)
    free = shapely.Polygon(arena).difference(shapely.Polygon(ring))
    points = shapely.points(places)
    exact = np.where(shapely.contains(free, points), shapely.distance(free.boundary, points), 0.0)
    assert clear == pytest.approx(exact, abs=1e-12 * scale + 1e-300)
    poses = np.c_[places, rng.uniform(-4.0, 4.0, len(places))]
    assert np.isfinite(scenes.footprint_clearance(poses, Footprint.rectangle(0.1, 0.2), index)).all()
    assert np.isfinite(scenes.cast(poses, index, Lidar())).all()
    assert np.isfinite(scenes.segment_clearance(places, places[::-1], index)).all()
