"""Scans and parameters as robots' programs write them."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import yaml

from viatool.errors import ConfigurationError
from viatool.projects import load_environment, load_nav2, load_scanner

MESSAGE: dict[str, Any] = {
    "header": {"frame_id": "laser"},
    "angle_min": 1.5,
    "angle_max": -1.5,
    "angle_increment": -0.01,
    "range_min": 0.1,
    "range_max": 8.0,
    "ranges": [2.0] * 301,
}


def test_a_message_is_read_as_it_is_printed(tmp_path: Path) -> None:
    (tmp_path / "scan.yaml").write_text(yaml.safe_dump(MESSAGE) + "---\n", encoding="utf-8")
    (tmp_path / "scan.json").write_text(json.dumps(MESSAGE), encoding="utf-8")
    cut = {**MESSAGE, "ranges": [*[2.0] * 128, "..."]}  # as echo prints it without --full-length
    (tmp_path / "cut.yaml").write_text(yaml.safe_dump(cut), encoding="utf-8")
    whole = load_scanner(tmp_path / "scan.yaml")
    assert (whole.first, whole.step, whole.rays, whole.most, whole.frame) == (1.5, -0.01, 301, 8.0, "laser")
    assert load_scanner(tmp_path / "scan.json") == whole
    assert load_scanner(tmp_path / "cut.yaml").rays == 301
    assert load_scanner(tmp_path / "cut.yaml").ranges == ()


@pytest.mark.parametrize(
    "wrong",
    [
        {"angle_min": None},
        {"angle_increment": 0.0},
        {"angle_increment": 0.01},
        {"range_max": 0.05},
        {"range_max": float("inf")},
        {"angle_max": True},
    ],
)
def test_what_is_no_scan_is_refused_by_name(tmp_path: Path, wrong: dict[str, Any]) -> None:
    (tmp_path / "scan.yaml").write_text(yaml.safe_dump({**MESSAGE, **wrong}), encoding="utf-8")
    with pytest.raises(ConfigurationError, match="is no LaserScan message"):
        load_scanner(tmp_path / "scan.yaml")


def test_nav2_tells_footprint_limits_and_rate(tmp_path: Path) -> None:
    path = tmp_path / "nav2_params.yaml"
    path.write_text(
        "controller_server: {ros__parameters: {controller_frequency: 20.0, FollowPath: {max_vel_x: 0.9}}}\n"
        "local_costmap: {local_costmap: {ros__parameters: {robot_radius: 0.22}}}\n"
        "velocity_smoother: {ros__parameters: {max_velocity: [0.5, 0.0, 2.5], min_velocity: [-0.5, 0.0, -2.5],"
        " max_decel: [-2.5, 0.0, -3.2]}}\n",
        encoding="utf-8",
    )
    found = load_nav2(path)
    assert found.footprint == {"shape": "circle", "radius": 0.22}
    assert found.limits == {"min_linear": -0.5, "max_linear": 0.5, "max_angular": 2.5, "deceleration": 2.5}
    assert found.interval == pytest.approx(0.05)
    path.write_text('local_costmap: {footprint: "[[0.1, 0.1]]"}\n', encoding="utf-8")
    with pytest.raises(ConfigurationError, match="expected corners"):
        load_nav2(path)


class Paced(gymnasium.Env):  # type: ignore[misc]
    """A robot that is commanded five times a second."""

    observation_space = gymnasium.spaces.Box(-1.0, 1.0, (4,), np.float32)
    action_space = gymnasium.spaces.Box(np.float32([0.0, -0.5]), np.float32([0.25, 0.5]))
    dt = 0.2


def test_an_environment_tells_limits_and_pace() -> None:
    gymnasium.register("Paced-v0", entry_point=Paced)
    found = load_environment("Paced-v0")
    assert (found.commands, found.interval) == (((0.0, 0.25), (-0.5, 0.5)), 0.2)
    with pytest.raises(ConfigurationError, match="cannot be made"):
        load_environment("Nobody-v0")


def test_an_environment_of_a_module_that_stands_here_is_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lines = "import gymnasium\n", "from tests.projects.test_robot_files import Paced\n"
    (tmp_path / "module_here.py").write_text(
        "".join(lines) + "gymnasium.register('Here-v0', entry_point=Paced)\n", encoding="utf-8"
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.path", [path for path in sys.path if path])
    assert load_environment("module_here:Here-v0").interval == 0.2
