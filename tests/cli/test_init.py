"""``viatool init``: from a model, a scan and an image of a map to a first verdict, without a line written by hand."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import yaml
from click.testing import CliRunner, Result

from tests.importing.saved import saved
from viatool.cli import main
from viatool.policy import load_policy
from viatool.projects import load_project
from viatool.samples import MAPS
from viatool.world import load_map

Run = Callable[..., Result]

SCAN: dict[str, Any] = {
    "header": {"stamp": {"sec": 3, "nanosec": 5}, "frame_id": "base_scan"},
    "angle_min": -1.5707963705062866,
    "angle_max": 1.5707963705062866,
    "angle_increment": 0.08975979,
    "time_increment": 0.0,
    "scan_time": 0.1,
    "range_min": 0.12,
    "range_max": 3.5,
    "ranges": [1.0] * 36,
    "intensities": [],
}
NAV2 = """
controller_server:
  ros__parameters:
    controller_frequency: 10.0
    FollowPath: {max_vel_x: 0.5, min_vel_x: 0.0, max_vel_theta: 1.0}
local_costmap:
  local_costmap:
    ros__parameters:
      robot_radius: 0.22
      footprint: "[[0.2, 0.1], [0.2, -0.1], [-0.2, -0.1], [-0.2, 0.1]]"
"""


@pytest.fixture(scope="module")
def given(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with what a user has: ``model.zip``, ``scan.yaml``, ``nav2_params.yaml`` and ``floor.png``."""
    folder = tmp_path_factory.mktemp("given")
    model, _ = saved(folder, "TD3", size=38, settings={"net_arch": [4]})
    steer(model)
    model.save(folder / "model.zip")
    text = yaml.safe_dump(SCAN, sort_keys=False) + "---\n"
    (folder / "scan.yaml").write_text(text.replace("- 1.0\n", "- .inf\n", 3), encoding="utf-8")
    (folder / "nav2_params.yaml").write_text(NAV2, encoding="utf-8")
    shutil.copy(MAPS.folder / "office.png", folder / "floor.png")
    return folder


def steer(model: Any) -> None:
    """Let an actor drive at half a metre a second towards its goal, whatever is in its way."""
    first, last = (layer for layer in model.actor.mu if isinstance(layer, torch.nn.Linear))
    with torch.no_grad():
        for parameter in (*first.parameters(), *last.parameters()):
            parameter.zero_()
        first.weight[0, 37], first.weight[1, 37] = 1.0, -1.0  # the bearing, and its negative
        last.bias[0] = 3.0
        last.weight[1, 0], last.weight[1, 1] = 1.0, -1.0


@pytest.fixture
def folder(given: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for file in given.iterdir():
        shutil.copy(file, tmp_path / file.name)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run(*arguments: object, said: str | None = None) -> Result:
    return CliRunner().invoke(main, [str(argument) for argument in arguments], input=said)


INIT = (
    "init",
    "--policy",
    "model.zip",
    "--scan",
    "scan.yaml",
    "--map",
    "floor.png",
    "--resolution",
    0.05,
    "--yes",
)


FLOOR = ("--origin=-8.3,-6.3,0", "--start=-6,-1.5,0", "--clearance", 0.2)
COURSE = (*FLOOR, "--goal", "6,4")


@pytest.mark.slow
def test_the_doctor_has_nothing_against_what_was_proposed(folder: Path) -> None:
    in_sight = "--goal=-4,-1.5"  # the actor sees no obstacle, so that it arrives where there is none
    assert run(*INIT, *FLOOR, in_sight).exit_code == 0
    doctor = run("doctor", "model.onnx", "--spec", "model.spec.yaml", "--map", "site.yaml", "--scenarios", 1)
    assert doctor.exit_code == 0, doctor.output
    assert "warning: " not in doctor.output


def test_a_model_a_scan_and_an_image_lead_to_a_verdict_that_is_true(folder: Path) -> None:
    made = run(*INIT, *COURSE)
    assert made.exit_code == 0, made.output
    assert (
        "next: viatool doctor model.onnx --spec model.spec.yaml --map site.yaml, then viatool run"
        in made.output
    )
    result = run("run", "--quiet")
    assert result.exit_code == 1
    report = json.loads(next((folder / ".viatool").glob("cells/*/report.json")).read_text(encoding="utf-8"))
    # The same, said by somebody who knows the policy, the robot and the map.
    (folder / "mine.yaml").write_text(
        yaml.safe_dump(
            {
                "schema_version": 2,
                "robot": "mine",
                "control_interval": 0.1,
                "observation": [
                    {
                        "name": "scan",
                        "kind": "lidar",
                        "lidar": {
                            "start": -1.5707963705062866, "step": 0.08975979, "rays": 36, "minimum_range": 0.12,
                            "maximum_range": 3.5,
                        },
                    },
                    {"name": "far", "kind": "goal_distance"},
                    {"name": "where", "kind": "goal_bearing"},
                ],
                "action": [
                    {"name": "linear", "kind": "linear", "unit": "m/s", "lower": 0.0, "upper": 0.5},
                    {"name": "angular", "kind": "angular", "unit": "rad/s", "lower": -1.0, "upper": 1.0},
                ],
            }
        ),
        encoding="utf-8",
    )  # fmt: skip
    shutil.copy(MAPS.folder / "office.ros.yaml", folder / "mine.ros.yaml")
    text = (folder / "mine.ros.yaml").read_text().replace("office.png", "floor.png")
    (folder / "mine.ros.yaml").write_text(text, encoding="utf-8")
    (folder / "mine.map.yaml").write_text(
        "schema_version: 1\noccupancy: mine.ros.yaml\nclearance: {collision: 0.2, danger: 0.3}\n"
        "scenarios: [{name: there, start: [-6, -1.5, 0], goal: [6, 4]}]\n",
        encoding="utf-8",
    )
    by_hand = ("verify", "model.onnx", "--spec", "mine.yaml", "--map", "mine.map.yaml", "--eps", 0.01)
    assert run(*by_hand, "-q", "-o", "json:mine.json").exit_code == 0
    mine = json.loads((folder / "mine.json").read_text(encoding="utf-8"))
    for name in ("states", "verdicts", "contested_rate", "danger_rate", "reachable_width"):
        assert report[name] == mine[name], name
    assert report["verdicts"]["unsafe"] > 0


def test_the_files_say_what_the_scan_and_nav2_say(folder: Path) -> None:
    assert run(*INIT, "--nav2", "nav2_params.yaml").exit_code == 0
    spec = load_policy(folder / "model.onnx", folder / "model.spec.yaml").spec
    lidar = spec.observation[0].lidar
    assert lidar is not None
    angles = lidar.lidar().angles()
    assert angles[[0, -1]] == pytest.approx([SCAN["angle_min"], SCAN["angle_max"]], abs=1e-5)
    assert (lidar.minimum_range, lidar.maximum_range, lidar.bins) == (0.12, 3.5, 36)
    robot = load_map(folder / "site.yaml").robot
    assert sorted(robot.footprint.polygon.tolist()) == [[-0.2, -0.1], [-0.2, 0.1], [0.2, -0.1], [0.2, 0.1]]
    assert (robot.min_linear, robot.max_linear, robot.max_angular, robot.control_interval) == (
        0.0,
        0.5,
        1.0,
        0.1,
    )
    assert (folder / "rays.png").read_bytes().startswith(b"\x89PNG")
    assert load_project(folder / "viatool.toml").file.check[0].kind == "verify"
    assert run("run", "--list").output == "drive/model/site\n"


def test_every_question_is_an_option_and_every_answer_counts(folder: Path) -> None:
    files, kinds = "model.zip\nfloor.png\n0.05\nscan.yaml\n\npoint\n", "lidar,goal_distance,goal_bearing\n"
    answers = f"{files}{kinds}linear,angular\n0.2\n0.02\n"
    asked = run("init", "--output", "asked", said=answers)
    assert asked.exit_code == 0, asked.output
    assert run(*INIT, "--output", "told", "--interval", 0.2, "--eps", 0.02).exit_code == 0
    names = sorted(path.name for path in (folder / "told").iterdir())
    assert names == [
        "floor.ros.yaml", "model.onnx", "model.spec.yaml", "rays.png", "site.yaml", "viatool.toml",
    ]  # fmt: skip
    for name in names:
        assert (folder / "asked" / name).read_bytes() == (folder / "told" / name).read_bytes(), name


def test_a_wrong_answer_is_asked_again_with_what_was_expected(folder: Path) -> None:
    answers = {
        "Policy": ["gone.zip", "model.zip"],
        "Map": ["nowhere", "floor.png"],
        "Side": ["wide", "-1", "0.05"],
        "LaserScan": ["floor.png", "scan.yaml"],
        "nav2": ["scan.yaml", ""],
        "Footprint": ["round", "1,2 3", "0.18"],
        "observation": ["lidar,goal_distance,smell", "lidar,goal_distance,goal_bearing"],
        "commands": ["linear,sideways", "linear,angular"],
        "Time": ["now", "0.2"],
        "error": ["much", "0.02"],
    }
    said = "".join(f"{answer}\n" for each in answers.values() for answer in each)
    asked = run("init", "--output", "asked", said=said)
    assert asked.exit_code == 0, asked.output
    for words in (
        "gone.zip",
        "the map 'nowhere': there is no such file",
        "samples: ",
        "'-1' is not a finite number above 0",
        "says nothing of a robot",
        "'round' is neither 'point', a radius, corners",
        "not 'sideways'",
        "'much' is not a finite radius",
    ):
        assert words in asked.output, words
    assert asked.output.count("Error: ") == sum(len(each) - 1 for each in answers.values())
    told = run(*INIT, "--output", "told", "--interval", 0.2, "--eps", 0.02, "--footprint", 0.18)
    assert told.exit_code == 0, told.output
    for path in (folder / "told").iterdir():
        assert (folder / "asked" / path.name).read_bytes() == path.read_bytes(), path.name
    assert load_map(folder / "told" / "site.yaml").robot.footprint.radius == 0.18


def test_nothing_is_overwritten_without_force(folder: Path) -> None:
    (folder / "viatool.toml").write_text("mine", encoding="utf-8")
    refused = run(*INIT)
    assert refused.exit_code == 2
    assert "viatool.toml' is there already" in refused.output
    assert not (folder / "model.onnx").exists()
    assert run(*INIT, "--force").exit_code == 0
    assert "policies" in (folder / "viatool.toml").read_text(encoding="utf-8")


def test_a_map_that_is_called_as_the_new_one_stays(folder: Path) -> None:
    mine = "{image: floor.png, resolution: 0.05, origin: [0, 0, 0], negate: 0, occupied_thresh: 0.65, free_thresh: 0.1}"
    (folder / "site.yaml").write_text(mine, encoding="utf-8")
    made = run(
        "init", "--policy", "model.zip", "--scan", "scan.yaml", "--map", "site.yaml", "--yes", "--force"
    )
    assert made.exit_code == 0
    assert (folder / "site.yaml").read_text(encoding="utf-8") == mine
    assert load_map(folder / "robot-site.yaml").obstacles.grid is not None
    assert run("run", "--list").output == "drive/model/robot-site\n"


def test_where_nobody_answers_it_says_what_to_give(folder: Path) -> None:
    silent = run("init", "--policy", "model.zip", "--map", "floor.png", "--resolution", 0.05)
    assert silent.exit_code == 2
    assert "nobody answers 'LaserScan message or bag (empty: none)'" in silent.output
    assert "--yes" in silent.output


def test_commands_beyond_the_robot_are_clipped_and_said(folder: Path) -> None:
    slow = NAV2.replace("max_vel_x: 0.5", "max_vel_x: 0.3")
    (folder / "nav2_params.yaml").write_text(slow, encoding="utf-8")
    made = run(
        *INIT, "--nav2", "nav2_params.yaml", "--origin=-8.3,-6.3,0", "--start=-6,-1.5,0", "--goal=-5,-1.5"
    )
    assert "guessed: commands of linear from 0 to 0.5 are clipped to the robot's 0 to 0.3" in made.output
    assert 'prefer = ["limits=map"]' in (folder / "viatool.toml").read_text(encoding="utf-8")
    assert "--map site.yaml --prefer limits=map, then viatool run" in made.output
    assert run("run", "--min-contested", 0, "--quiet").exit_code in (0, 1)


def test_what_numbers_are_can_be_said_in_their_order(folder: Path) -> None:
    kinds = "goal_distance,goal_bearing,lidar"
    assert run(*INIT, "--observation", kinds, "--command", "angular,linear").exit_code == 0
    spec = load_policy(folder / "model.onnx", folder / "model.spec.yaml").spec
    assert [(channel.kind, channel.size) for channel in spec.observation] == [
        ("goal_distance", 1), ("goal_bearing", 1), ("lidar", 36),
    ]  # fmt: skip
    assert [(channel.kind, channel.upper) for channel in spec.action] == [("angular", 0.5), ("linear", 1.0)]


@pytest.mark.parametrize(
    ("more", "told"),
    [
        (("--policy", "none.zip"), "cannot read the policy none.zip"),
        (("--scan", "nav2_params.yaml"), "is no LaserScan message: angle_min is None"),
        (("--nav2", "scan.yaml"), "says nothing of a robot"),
        (("--nav2", "model.zip"), "cannot read 'model.zip'"),
        (("--map", "none.png"), "there is no such file"),
        (("--observation", "lidar,goal_angle"), "'goal_angle' is no kind of observation"),
        (("--observation", "goal_distance"), "the policy takes 38 numbers"),
        (("--command", "linear"), "the policy gives 2 numbers"),
        (("--eps", "wide"), "is not a finite radius"),
        (("--map", "office.ros.yaml"), "--resolution has no effect: a map_server YAML states both"),
        (("--eps", "foo=1"), "there is no observation channel 'foo'"),
        (("--start", "0,0,0"), "--start and --goal belong together"),
        (("--start=0,0,0", "--goal=-9,0"), "--start 0,0,0: the robot is 0.000 m from the nearest obstacle"),
        ((*FLOOR, "--goal=-8.25,-6.25"), "--goal -8.25,-6.25 lies in an obstacle"),
    ],
)
def test_what_cannot_be_used_is_named_and_nothing_is_written(
    folder: Path, more: tuple[str, ...], told: str
) -> None:
    shutil.copy(MAPS.folder / "office.ros.yaml", folder / "office.ros.yaml")
    shutil.copy(MAPS.folder / "office.png", folder / "office.png")
    words = [str(word) for word in INIT]
    if more[0] in words:
        at = words.index(more[0])
        del words[at : at + 2]
    result = run(*words, *more)
    assert result.exit_code == 2
    assert told in result.output
    assert not (folder / "viatool.toml").exists()


def test_an_image_needs_the_size_of_its_pixels(folder: Path) -> None:
    result = run("init", "--policy", "model.zip", "--map", "floor.png", "--yes")
    assert result.exit_code == 2
    assert "give --resolution" in result.output
    assert run("init", "--yes").exit_code == 2


def test_a_policy_with_a_specification_and_a_sample_need_nothing_more(folder: Path) -> None:
    assert run("init", "--policy", "via", "--map", "lab", "--yes").exit_code == 0
    assert run("run", "--list").output == "drive/via/lab\n"
    assert run("run", "--min-contested", 0, "--quiet").exit_code == 0
    assert np.all([not (folder / name).exists() for name in ("via.onnx", "via.spec.yaml", "site.yaml")])


@pytest.mark.parametrize(
    "more",
    [
        ("--nav2", "nav2_params.yaml"), ("--footprint", "0.2"), ("--clearance", "0.2"), ("--resolution", "0.05"),
        ("--origin=0,0,0",), ("--start=0,0,0", "--goal=1,1"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("kept", ["lab", "mine.yaml"])
def test_a_native_map_states_its_robot_and_takes_no_other(
    folder: Path, more: tuple[str, ...], kept: str
) -> None:
    shutil.copy(MAPS.folder / "lab.yaml", folder / "mine.yaml")
    refused = run("init", "--policy", "via", "--map", kept, "--yes", *more)
    assert refused.exit_code == 2
    assert f"{more[0].partition('=')[0]} has no effect: a native map states its robot" in refused.output
    assert not (folder / "viatool.toml").exists()


@pytest.mark.parametrize(
    "more",
    [
        ("--scan", "scan.yaml"), ("--scan-yaw", "0.1"), ("--observation", "foo"), ("--command", "linear,angular"),
        ("--interval", "0.2"), ("--environment", "none:Robot-v0"),
    ],
)  # fmt: skip
def test_a_policy_with_a_specification_takes_nothing_else_that_it_says(
    folder: Path, more: tuple[str, ...]
) -> None:
    refused = run("init", "--policy", "via", "--map", "floor.png", "--resolution", 0.05, "--yes", *more)
    assert refused.exit_code == 2
    assert f"{more[0]} has no effect: the policy has its own specification" in refused.output
    assert not (folder / "viatool.toml").exists()


def test_no_question_is_asked_whose_answer_would_have_no_effect(folder: Path) -> None:
    asked = run("init", "--policy", "via", "--map", "lab", said="0.02\n")
    assert asked.exit_code == 0, asked.output
    assert asked.output.count("[") == asked.output.count("Sensor error") == 1


def test_a_footprint_brings_no_other_limits_than_the_policy_has(folder: Path) -> None:
    kinds = ("--command", "angular,linear")  # up to 0.5 rad/s, and from -1 to 1 m/s
    course = ("--origin=-8.3,-6.3,0", "--start=-6,-1.5,0", "--goal=-5,-1.5")
    assert run(*INIT, *kinds, *course, "--footprint", 0.2).exit_code == 0
    robot = load_map(folder / "site.yaml").robot
    assert (robot.min_linear, robot.max_linear, robot.max_angular) == (-1.0, 1.0, 0.5)
    assert robot.footprint.radius == 0.2
    assert run("run", "--min-contested", 0, "--quiet").exit_code in (0, 1)


def test_what_nav2_does_not_limit_the_policy_does(folder: Path) -> None:
    (folder / "slow.yaml").write_text("max_vel_x: 0.3\nfootprint: ''\n", encoding="utf-8")
    kinds = ("--command", "angular,linear")
    assert run(*INIT, *kinds, "--nav2", "slow.yaml").exit_code == 0
    robot = load_map(folder / "site.yaml").robot
    assert (robot.min_linear, robot.max_linear, robot.max_angular) == (-1.0, 0.3, 0.5)


def test_distances_and_errors_that_nobody_gave_are_said_to_be_guessed(folder: Path) -> None:
    keeps = "guessed: the footprint keeps 0.05 m, and is in danger below 0.15 m"
    errs = "guessed: every sensor errs by up to 0.01"
    guessed = run(*INIT, "--footprint", 0.2).output
    assert keeps in guessed
    assert errs in guessed
    answers = "\n0.2\nlidar,goal_distance,goal_bearing\nlinear,angular\n0.1\n0.01\n"
    words = [word for word in INIT if word != "--yes"]
    asked = run(*words, "--output", "asked", said=answers)
    assert keeps in asked.output, asked.output
    assert errs not in asked.output
    given = run(*INIT, "--footprint", 0.2, "--clearance", 0.1, "--eps", 0.01, "--force").output
    assert "keeps" not in given
    assert errs not in given
