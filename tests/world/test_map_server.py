from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.world.grid_maps import write_map
from viatool.errors import MapError, MapWarning
from viatool.world import Cell, OccupancyGrid, Scenes, load_map

F, O, U = Cell.FREE, Cell.OCCUPIED, Cell.UNKNOWN  # noqa: E741  # a table of them reads best with letters


def grid_of(path: Path, unknown: str | None = None) -> OccupancyGrid:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MapWarning)
        grid = load_map(path, unknown=unknown).obstacles.grid
    assert grid is not None
    return grid


# Shares with negate 0: 255 -> 0, 206 -> 0.192, 205 -> 0.19608, 90 -> 0.647, 89 -> 0.651, 0 -> 1.
GREYS = [255, 206, 205, 90, 89, 0]


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({}, [F, F, U, U, O, O]),
        ({"mode": "trinary"}, [F, F, U, U, O, O]),
        ({"mode": "scale"}, [F, F, U, U, O, O]),
        ({"negate": 1}, [O, O, O, U, U, F]),
        ({"negate": "true"}, [O, O, O, U, U, F]),
        ({"free_thresh": 0.25}, [F, F, F, U, O, O]),
        ({"occupied_thresh": 0.6}, [F, F, U, O, O, O]),
        ({"occupied_thresh": 0.4, "free_thresh": 0.4}, [F, F, F, O, O, O]),
    ],
)
def test_greys_become_cells_as_map_server_says(
    tmp_path: Path, changes: dict[str, object], expected: list[Cell]
) -> None:
    assert grid_of(write_map(tmp_path, [GREYS], **changes)).cells.tolist() == [expected]


def test_a_cell_that_is_both_free_and_occupied_is_free(tmp_path: Path) -> None:
    grid = grid_of(write_map(tmp_path, [[255, 0]], free_thresh=0.0, occupied_thresh=0.0))
    assert grid.cells.tolist() == [[F, O]]


def test_raw_values_are_percent_up_to_100_and_unknown_above(tmp_path: Path) -> None:
    path = write_map(tmp_path, [[0, 19, 20, 64, 65, 100, 101, 255]], mode="raw")
    assert grid_of(path).cells.tolist() == [[F, F, U, U, O, O, U, U]]


def test_transparent_pixels_are_unknown_except_in_raw_mode(tmp_path: Path) -> None:
    pixels = np.array([[[254, 254, 254, 255], [254, 254, 254, 254], [0, 0, 0, 0], [0, 0, 0, 255]]])
    assert grid_of(write_map(tmp_path, pixels, image="map.png")).cells.tolist() == [[F, U, U, O]]
    path = write_map(tmp_path, pixels, image="map.png", mode="scale")
    assert grid_of(path).cells.tolist() == [[F, U, U, O]]
    assert grid_of(write_map(tmp_path, pixels, image="map.png", mode="raw")).cells.tolist() == [[U, U, F, F]]


COLOURS = [
    [255, 255, 255],
    [255, 0, 0],
    [0, 255, 0],
    [0, 0, 255],
    [120, 255, 120],
    [206, 206, 206],
]
# Luma by nav2's (306 r + 601 g + 117 b) >> 10: 255, 76, 149, 29, 199, 206. Means: 255, 85, 85, 85, 165, 206.


@pytest.mark.parametrize("image", ["map.png", "map.ppm", "map.bmp"])
def test_colours_count_by_their_luma_and_where_their_mean_says_otherwise_it_is_told(
    tmp_path: Path, image: str
) -> None:
    path = write_map(tmp_path, [COLOURS], image=image, occupied_thresh=0.5, free_thresh=0.25)
    with pytest.warns(MapWarning, match=r"image: is coloured, and 2 of its cells"):
        world = load_map(path)
    assert world.obstacles.grid is not None
    assert world.obstacles.grid.cells.tolist() == [[F, O, U, O, F, F]]


def test_raw_colours_count_by_their_luma(tmp_path: Path) -> None:
    pixels = [[[60, 0, 0], [0, 0, 255], [0, 40, 0]]]  # luma 17, 29, 23; mean 20, 85, 13
    path = write_map(tmp_path, pixels, image="map.png", mode="raw", free_thresh=0.23, occupied_thresh=0.28)
    assert grid_of(path).cells.tolist() == [[F, O, F]]


@pytest.mark.parametrize("mode", ["RGB", "RGBA", "P", "L", "LA", "1"])
def test_a_map_without_colour_is_the_same_in_every_kind_of_pixels(tmp_path: Path, mode: str) -> None:
    path = write_map(tmp_path, [[0]], image="map.png")
    grey = Image.fromarray(np.array([[254, 0, 254, 254, 0]], np.uint8))
    grey.convert("1", dither=Image.Dither.NONE).convert(mode).save(tmp_path / "map.png")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert load_map(path).obstacles.grid.cells.tolist() == [[F, O, F, F, O]]  # type: ignore[union-attr]


def test_a_palette_counts_by_its_colours_and_their_opacity(tmp_path: Path) -> None:
    path = write_map(tmp_path, [[0]], image="map.png")
    image = Image.fromarray(np.array([[0, 1, 2, 3]], np.uint8)).convert("P")
    image.putpalette([255, 255, 255, 0, 0, 255, 250, 250, 250, 0, 0, 0])
    image.save(tmp_path / "map.png", transparency=bytes([255, 255, 100, 255]))
    assert grid_of(path).cells.tolist() == [[F, O, U, O]]


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"P2\n# by hand\n3 1\n255\n255 205 0\n", [F, U, O]),
        (b"P5\n3 1\n255\n\xff\xcd\x00", [F, U, O]),
        (b"P5\n3 1\n65535\n\xff\xff\xcd\xcd\x00\x00", [F, U, O]),
        (b"P5\n2 1\n100\n\x64\x00", [F, O]),
        (b"P5 # made by hand\n# twice\n3 # wide\n1\n255\n\xff\xcd\x00\n", [F, U, O]),
        (b"P2 3 1 65535 65535 # white\n52685 0", [F, U, O]),
        (b"P1\n3 1\n0 1\n0\n", [F, O, F]),
        (b"P1\n3 1\n010", [F, O, F]),
        (b"P4\n9 1\n\x40\x80", [F, O, F, F, F, F, F, F, O]),
        (b"P3\n1 1\n255\n255 255 255\n", [F]),
        (b"P6\n2 1\n255\n\xff\xff\xff\x00\x00\x00", [F, O]),
    ],
)
def test_every_kind_of_netpbm_is_read(tmp_path: Path, content: bytes, expected: list[Cell]) -> None:
    path = write_map(tmp_path, [[0]])
    (tmp_path / "map.pgm").write_bytes(content)
    assert grid_of(path).cells.tolist() == [expected]


def test_the_origin_is_the_lower_left_corner_of_the_last_row_of_the_image(tmp_path: Path) -> None:
    path = write_map(tmp_path, [[254, 254, 254], [0, 254, 254]])  # occupied: lower left
    world = load_map(path)
    assert world.bounds == (1.0, 2.0, 2.5, 3.0)
    points = np.array([[1.25, 2.25], [1.25, 2.75], [1.75, 2.25], [2.4, 2.1]])
    scenes = Scenes.of(world, [None])
    assert scenes.blocked(points, np.zeros(4, int)).tolist() == [True, False, False, False]
    # A quarter of a cell above the occupied one; next to it; half a cell from the lower wall.
    assert scenes.clearance(points, np.zeros(4, int)) == pytest.approx([0.0, 0.25, 0.25, 0.1])


def test_the_yaw_of_the_origin_turns_the_map_about_its_corner_with_a_warning(tmp_path: Path) -> None:
    path = write_map(tmp_path, [[254, 0, 254]], origin=[1.0, 2.0, np.pi / 2.0])
    with pytest.warns(MapWarning, match="yaw"):
        world = load_map(path)
    assert world.bounds == pytest.approx((0.5, 2.0, 1.0, 3.5))
    points = np.array([[0.75, 2.25], [0.75, 2.75], [0.75, 3.25]])
    blocked = Scenes.of(world, [None]).blocked(points, np.zeros(3, int))
    assert blocked.tolist() == [False, True, False]
    assert any("nav2 ignores it" in text for text in world.warnings)


def test_unknown_cells_are_obstacles_unless_the_user_says_otherwise(tmp_path: Path) -> None:
    path = write_map(tmp_path, [[254, 205, 0]])
    assert grid_of(path).blocked.tolist() == [[False, True, True]]
    assert grid_of(path, "obstacle").blocked.tolist() == [[False, True, True]]
    assert grid_of(path, "free").blocked.tolist() == [[False, False, True]]


def test_a_free_threshold_above_grey_205_is_told(tmp_path: Path) -> None:
    with pytest.warns(MapWarning, match="free_thresh") as caught:
        load_map(write_map(tmp_path, [[254, 205]], free_thresh=0.25))
    assert "map.yaml:6" in str(caught[0].message)
    load_map(write_map(tmp_path, [[254, 205]], free_thresh=0.196))
    load_map(write_map(tmp_path, [[254, 0]], free_thresh=0.25))  # no cell of that grey


@pytest.mark.parametrize(
    ("changes", "words"),
    [({"frame": "map"}, "frame"), ({"negate": 1, "free_thresh": 0.0}, "no cell is free")],
)
def test_odd_maps_are_read_with_a_warning(tmp_path: Path, changes: dict[str, object], words: str) -> None:
    with pytest.warns(MapWarning, match=words):
        load_map(write_map(tmp_path, [[254, 254]], **changes))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"image": None}, ["map.yaml:1: image: field required"]),
        ({"image": "missing.pgm"}, ["map.yaml:1: image", "missing.pgm", "cannot be read"]),
        ({"image": "."}, ["map.yaml:1: image", "cannot be read"]),
        ({"image": "map.yaml"}, ["map.yaml:1: image", "not an image"]),
        ({"resolution": 0.0}, ["map.yaml:2: resolution", "greater than 0"]),
        ({"resolution": ".nan"}, ["map.yaml:2: resolution", "finite"]),
        ({"resolution": -0.05}, ["map.yaml:2: resolution", "greater than 0"]),
        ({"resolution": 1e-12}, ["map.yaml:2: resolution", "cells of 1e-12 m"]),
        ({"resolution": 1e6}, ["map.yaml:2: resolution", "outline of 2 x 1 cells"]),
        ({"resolution": None}, ["map.yaml:1: resolution", "required"]),
        ({"origin": [0.0, ".nan", 0.0]}, ["map.yaml:3: origin[1]"]),
        ({"origin": [0.0, 0.0, ".inf"]}, ["map.yaml:3: origin[2]"]),
        ({"origin": "home"}, ["map.yaml:3: origin", "expected a list"]),
        ({"negate": 2}, ["map.yaml:4: negate"]),
        ({"occupied_thresh": 65}, ["map.yaml:5: occupied_thresh", "less than or equal to 1"]),
        ({"free_thresh": ".nan"}, ["map.yaml:6: free_thresh", "finite"]),
        ({"free_thresh": 0.7}, ["map.yaml:6: free_thresh", "above occupied_thresh 0.65"]),
        ({"mode": "binary"}, ["map.yaml:7: mode", "'trinary', 'scale' or 'raw'"]),
    ],
)
def test_wrong_fields_give_one_clear_message(
    tmp_path: Path, changes: dict[str, object], words: list[str]
) -> None:
    path = write_map(tmp_path, [[254, 0]])
    text = path.read_text(encoding="utf-8").splitlines()
    (field, value), *_ = changes.items()
    lines = [line for line in text if not line.startswith(f"{field}:")]
    place = next((i for i, line in enumerate(text) if line.startswith(f"{field}:")), len(lines))
    if value is not None:
        shown = str(value).replace("'", "")
        lines.insert(place, f"{field}: {shown}")
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    with pytest.raises(MapError) as raised:
        load_map(path)
    for word in words:
        assert word in raised.value.message
    assert raised.value.hint
    assert "\n" not in raised.value.message


@pytest.mark.parametrize(
    "content",
    [
        b"P5\n40 40\n255\n" + bytes(700),  # truncated
        b"P5\n40 40\n255\n" + bytes(1601),  # another image's header
        b"P5\n40 40\n65535\n" + bytes(1600),
        b"P5\n2 1\n100\n\x65\x00",  # brighter than the largest sample
        b"P5\n2 1\n70000\n" + bytes(4),
        b"P6\n2 1\n255\n" + bytes(5),
        b"P4\n9 2\n" + bytes(3),
        b"P1\n2 2\n0 1 0\n",
        b"P1\n2 1\n0 7\n",
        b"P2\n2 1\n255\n12 13 14\n",
        b"P2\n2 1\n255\n12 -3\n",
        b"P2\n2 1\n255\n12 300\n",
        b"P2\n2 1\n255\n12 " + 30 * b"9",
        b"P5\n",
        b"P5 2 1 255",
        b"P5\n40",
        b"P5\n0 0\n255\n",
        b"P2\n2 1\n255\n12\n",
        b"P2\n2 1\n255\n12 x\n",
        b"",
        b"\x89PNG\r\n\x1a\n" + bytes(40),
    ],
)
def test_broken_images_give_one_clear_message(tmp_path: Path, content: bytes) -> None:
    path = write_map(tmp_path, [[254]])
    (tmp_path / "map.pgm").write_bytes(content)
    with pytest.raises(MapError, match=r"map.yaml:1: image: '.*map.pgm' .*image") as raised:
        load_map(path)
    assert raised.value.hint


@pytest.mark.parametrize("image", ["map.png", "map.bmp", "map.jpg", "map.tif", "map.gif", "map.webp"])
@pytest.mark.parametrize("share", [0.1, 0.5, 0.9])
def test_a_truncated_image_is_not_read(tmp_path: Path, image: str, share: float) -> None:
    rng = np.random.default_rng(0)
    path = write_map(tmp_path, rng.integers(0, 255, (60, 60)), image=image)
    whole = (tmp_path / image).read_bytes()
    (tmp_path / image).write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(MapError, match=r"not a complete image|not an image"):
        load_map(path)


def test_an_image_too_large_for_memory_is_refused_before_it_is_read(tmp_path: Path) -> None:
    path = write_map(tmp_path, [[254]])
    (tmp_path / "map.pgm").write_bytes(b"P5\n100000 100000\n255\n")
    with pytest.raises(MapError, match="too large"):
        load_map(path)


NATIVE = """\
occupancy: map.yaml
robot: jackal
clearance: {collision: 0.1, danger: 0.2}
obstacles: [{shape: circle, center: [3.5, 3.5], radius: 0.25}]
scenarios: [{name: across, start: [1.75, 2.75, 0.0], goal: [4.5, 4.5]}]
"""


def write_native(folder: Path, text: str = NATIVE) -> Path:
    write_map(folder, np.full((6, 8), 254), origin=[1.0, 2.0, 0.0])
    path = folder / "native.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_native_map_adds_robot_and_scenarios_to_an_occupancy_map(tmp_path: Path) -> None:
    world = load_map(write_native(tmp_path))
    assert world.bounds == (1.0, 2.0, 5.0, 5.0)
    assert (world.robot.name, world.clearance.collision, world.scenarios[0].name) == ("jackal", 0.1, "across")
    assert len(world.obstacles) == 1
    clearance = Scenes.of(world, [None]).clearance(np.array([[3.0, 3.5], [1.25, 2.5]]), np.zeros(2, int))
    assert clearance == pytest.approx([0.25, 0.25])


def test_the_digest_covers_the_image(tmp_path: Path) -> None:
    path = write_native(tmp_path)
    before, served = load_map(path).sha256, load_map(tmp_path / "map.yaml").sha256
    greys = np.full((6, 8), 254)
    greys[5, 7] = 0
    write_map(tmp_path, greys)
    assert load_map(path).sha256 != before
    assert load_map(tmp_path / "map.yaml").sha256 != served


def test_a_native_map_may_say_what_unknown_cells_are_and_the_user_has_the_last_word(tmp_path: Path) -> None:
    path = write_native(tmp_path, "unknown: free\n" + NATIVE)
    greys = np.full((6, 8), 254)
    greys[0, 0] = 205
    write_map(tmp_path, greys)
    assert not grid_of(path).blocked.any()
    assert grid_of(path, "obstacle").blocked.sum() == 1


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("occupancy: missing.yaml\n", ["native.yaml:1: occupancy", "missing.yaml"]),
        ("occupancy: native.yaml\n", ["native.yaml:1: occupancy", "not a map_server file"]),
        (NATIVE.replace("[1.75, 2.75, 0.0]", "[0.0, 0.0, 0.0]"), ["scenarios[0].start"]),
        (NATIVE.replace("[4.5, 4.5]", "[9.0, 9.0]"), ["scenarios[0].goal"]),
        ("robot: jackal\n", ["arena: field required"]),
        (NATIVE + "unknown: maybe\n", ["native.yaml:6: unknown"]),
    ],
)
def test_wrong_native_maps_name_the_field(tmp_path: Path, text: str, words: list[str]) -> None:
    path = write_native(tmp_path, text)
    with pytest.raises(MapError) as raised:
        load_map(path)
    for word in words:
        assert word in raised.value.message


def test_a_map_server_map_alone_draws_scenarios_in_its_free_space(tmp_path: Path) -> None:
    greys = np.zeros((40, 60))
    greys[5:35, 5:25] = 254
    world = load_map(write_map(tmp_path, greys, resolution=0.1, origin=[0.0, 0.0, 0.0]))
    assert world.generator is not None
    assert world.generator.area == pytest.approx((0.5, 0.5, 2.5, 3.5))
    scenarios = world.generator.draw(20, 1)
    scenes, index = Scenes.of(world, scenarios), np.arange(20)
    starts = np.array([scenario.start[:2] for scenario in scenarios])
    goals = np.array([scenario.goal for scenario in scenarios])
    assert scenes.clearance(starts, index).min() >= world.clearance.danger
    assert scenes.clearance(goals, index).min() >= world.clearance.collision


def test_a_grey_png_with_16_bits_is_read(tmp_path: Path) -> None:
    path = write_map(tmp_path, [[0]], image="map.png")
    Image.fromarray(np.array([[65535, 52685, 0]], np.uint16)).save(tmp_path / "map.png")
    assert grid_of(path).cells.tolist() == [[F, U, O]]
