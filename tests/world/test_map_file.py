from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

from viatool.errors import ConfigurationError, MapError
from viatool.world import MapFile, WorldMap, load_map

EVERYTHING = """\
schema_version: 1
name: every shape
arena: {shape: polygon, points: [[-5, -5], [-5, 5], [5, 5], [5, -5]]}   # clockwise
obstacles:
  - {shape: circle, center: [2, 2], radius: 0.5}
  - {shape: box, center: [-2, 2], size: [2, 1], yaw: 1.5707963267948966}
  - {shape: polygon, points: [[-1, -3], [1, -3], [0, -2], [-1, -3]]}
  - {shape: wall, points: [[3, -4], [3, -1], [4, -1]], thickness: 0.2}
robot:
  name: jackal
  max_linear: 1.0
  footprint: {shape: circle, radius: 0.3}
  lidar: {rays: 90, bins: 10}
clearance: {collision: 0.05, danger: 0.2}
scenarios:
  - {start: [0, 0, 0], goal: [4, 4]}
  - name: crowded
    start: [0, 0, 3.14]
    goal: [-4, -4]
    obstacles:
      - {shape: box, center: [0, 2], size: [1e-1, 1]}
generator:
  obstacles: [{shape: circle, radius: 0.2}, {shape: box, size: [0.3, 0.7]}]
  goal_distance: [1, 3]
"""


def write(folder: Path, text: str) -> Path:
    path = folder / "map.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def complaint(folder: Path, text: str) -> str:
    """Return what load_map says about a file, which has a hint in every case."""
    with pytest.raises(MapError) as raised:
        load_map(write(folder, text))
    assert raised.value.hint
    return raised.value.message


@pytest.fixture
def everything(tmp_path: Path) -> WorldMap:
    return load_map(write(tmp_path, EVERYTHING))


def test_every_shape_is_read(everything: WorldMap) -> None:
    assert everything.name == "every shape"
    assert everything.bounds == (-5.0, -5.0, 5.0, 5.0)
    assert everything.obstacles.circles.tolist() == [[2.0, 2.0, 0.5]]
    box, triangle, wall, second_wall = everything.obstacles.polygons
    assert np.ptp(box, axis=0) == pytest.approx([1.0, 2.0])  # turned by a quarter
    assert triangle.shape == (3, 2)
    assert np.ptp(wall, axis=0) == pytest.approx([0.2, 3.2])
    assert np.ptp(second_wall, axis=0) == pytest.approx([1.2, 0.2])
    assert len(everything.sha256) == 64


def test_the_robot_takes_what_is_not_given_from_the_known_one(everything: WorldMap) -> None:
    robot = everything.robot
    assert (robot.name, robot.max_linear, robot.max_angular) == ("jackal", 1.0, 4.0)
    assert (robot.footprint.kind, robot.footprint.reach) == ("circle", 0.3)
    assert (robot.lidar.rays, robot.lidar.bins, robot.lidar.maximum_range) == (90, 10, 7.0)


def test_scenarios_have_names_and_obstacles_of_their_own(everything: WorldMap) -> None:
    first, second = everything.scenarios
    assert (first.name, second.name) == ("scenario-0", "crowded")
    assert first.goal == (4.0, 4.0)
    assert np.ptp(second.obstacles.polygons[0], axis=0) == pytest.approx([0.1, 1.0])


def test_the_generator_knows_the_map(everything: WorldMap) -> None:
    assert everything.generator is not None
    assert everything.generator.start_clearance == pytest.approx(0.5)  # danger and the footprint's reach
    assert len(everything.generator.centres) == 3  # not the walls
    scenario = everything.generator.draw(1, seed=0)[0]
    assert (len(scenario.obstacles.circles), len(scenario.obstacles.polygons)) == (1, 1)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (
            ("radius: 0.5", "radius: -0.5"),
            ":5: obstacles[0].radius: input should be greater than 0, got -0.5",
        ),
        (("radius: 0.5", "radius: .nan"), ":5: obstacles[0].radius: input should be a finite number"),
        (("radius: 0.5", "radius: yes"), ":5: obstacles[0].radius: expected a number"),
        (("radius: 0.5", "radius: wide"), ":5: obstacles[0].radius: input should be a valid number"),
        (("radius: 0.5", "diameter: 1"), ":5: obstacles[0].diameter: is not a known field"),
        (("radius: 0.5", "diameter: 1"), ":5: obstacles[0].radius: field required"),
        (("center: [2, 2]", "center: [2, 2, 2]"), ":5: obstacles[0].center"),
        (("shape: circle, center: [2", "shape: disc, center: [2"), ":5: obstacles[0]: input tag 'disc'"),
        (("max_linear: 1.0", "max_linear: -1.0"), ":9: robot: max_linear -1.0 m/s is below"),
        (("name: jackal", "name: r2d2"), ":9: robot: robot 'r2d2' is unknown"),
        (("name: crowded", "name: scenario-0"), ":17: scenarios[1].name: 'scenario-0' is taken"),
        (
            ("radius: 0.5", "radius: 1e300"),
            ":5: obstacles[0].radius: expected a size of at most 1e6",
        ),
        (("rays: 90", "rays: 91"), ":9: robot: LiDAR has 91 rays in 10 bins"),
        (("collision: 0.05", "collision: 0.5"), ":14: clearance: danger clearance 0.2 m is below"),
        (("[-1, -3], [1, -3], [0, -2]", "[-1, -3], [1, -2], [1, -3], [-1, -2]"), ":7: obstacles[2]"),
        (("[-1, -3], [1, -3], [0, -2]", "[-1, -3], [0, -3], [1, -3]"), ":7: obstacles[2]"),
        (("start: [0, 0, 0]", "start: [2, 2.7, 0]"), ":16: scenarios[0].start: the robot is 0.000 m from"),
        (("goal: [4, 4]", "goal: [2, 2]"), ":16: scenarios[0].goal: lies in an obstacle"),
        (("goal: [4, 4]", "goal: [6, 4]"), ":16: scenarios[0].goal: lies in an obstacle or outside"),
        (("goal_distance: [1, 3]", "goal_distance: [3, 1]"), ":24: generator.goal_distance: 3.0 m is more"),
        (
            ("goal_distance: [1, 3]", "goal_distance: [99, 100]"),
            ":22: generator: the scenario generator finds",
        ),
        (("goal_distance: [1, 3]", "area: [1, 1, 1, 2]"), ":24: generator.area: has no inside"),
        (("name: every shape", "arena: {}"), ":3: 'arena' appears twice"),
        (("name: every shape", "name: [every, shape"), ": is not YAML"),
        (("schema_version: 1", "schema_version: 2"), ":1: schema_version: input should be 1, got 2"),
    ],
)
def test_an_error_names_the_file_the_line_and_the_field(
    tmp_path: Path, change: tuple[str, str], expected: str
) -> None:
    assert change[0] in EVERYTHING
    message = complaint(tmp_path, EVERYTHING.replace(*change, 1))
    assert str(tmp_path / "map.yaml") in message
    assert expected in message


@pytest.mark.parametrize(
    "text", ["", "just words", "[1, 2]", "3", "null", "arena:\n", "a: b: c", "%", "\t- x"]
)
def test_what_is_not_a_map_is_refused(tmp_path: Path, text: str) -> None:
    assert "map.yaml" in complaint(tmp_path, text)


def test_all_errors_are_told_at_once(tmp_path: Path) -> None:
    message = complaint(
        tmp_path, "arena: {shape: box, center: [0, 0], size: [0, 1]}\nspeed: 1\nrobot: {wheels: 4}\n"
    )
    assert [line.split(": ")[1] for line in message.splitlines()] == [
        "arena.size[0]",
        "robot.wheels",
        "speed",
    ]


def test_a_missing_file_a_folder_and_a_binary_are_refused(tmp_path: Path) -> None:
    with pytest.raises(MapError, match=r"nowhere\.yaml' cannot be read: No such file"):
        load_map(tmp_path / "nowhere.yaml")
    with pytest.raises(MapError, match="cannot be read"):
        load_map(tmp_path)
    (tmp_path / "binary.yaml").write_bytes(bytes(range(256)))
    with pytest.raises(MapError, match="not a UTF-8 text file"):
        load_map(tmp_path / "binary.yaml")


def test_a_map_server_file_is_called_by_its_name(tmp_path: Path) -> None:
    assert "map_server" in complaint(tmp_path, "image: lab.pgm\nresolution: 0.05\norigin: [0, 0, 0]\n")


def test_a_python_tag_is_not_executed(tmp_path: Path) -> None:
    assert "is not YAML" in complaint(tmp_path, "arena: !!python/object/apply:os.getcwd []\n")


def test_the_schema_accepts_the_maps_of_the_repository() -> None:
    jsonschema = pytest.importorskip("jsonschema")
    schema = MapFile.model_json_schema()
    native = [path for path in Path("maps").glob("*.yaml") if not path.name.endswith(".ros.yaml")]
    assert len(native) >= 8
    for path in native:
        jsonschema.validate(yaml.safe_load(path.read_text(encoding="utf-8")), schema)
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate({"arena": {"shape": "box"}}, schema)


def test_clearances_can_be_overridden() -> None:
    lab = load_map("maps/lab.yaml")
    wide = lab.with_clearance(collision=0.9).clearance
    assert (wide.collision, wide.danger) == (0.9, 0.9)
    assert lab.with_clearance(danger=0.7).clearance.collision == 0.4
    assert lab.with_clearance().clearance == lab.clearance
    for values in ({"collision": -0.1}, {"collision": float("nan")}, {"danger": float("inf")}):
        with pytest.raises(ConfigurationError, match="clearance is"):
            lab.with_clearance(**values)
    with pytest.raises(ConfigurationError, match="below the collision clearance"):
        lab.with_clearance(collision=0.6, danger=0.5)
