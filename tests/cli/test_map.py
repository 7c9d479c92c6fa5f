"""Maps on the command line: what is summarised, drawn and warned about."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from click.testing import Result

from tests.world.grid_maps import write_map

Run = Callable[..., Result]

NATIVE = """\
occupancy: map.yaml
clearance: {collision: 0.1, danger: 0.2}
scenarios:
  - {name: open, start: [0.75, 0.75, 0.0], goal: [1.5, 1.5]}
"""


@pytest.fixture
def room(tmp_path: Path) -> Path:
    """Return the native map of a room of 2 m x 2 m, a tenth of which is unknown, and its map_server file."""
    greys = np.full((40, 40), 254)
    greys[:, 36:] = 205
    write_map(tmp_path, greys, resolution=0.05, origin=[0.0, 0.0, 0.0])
    (tmp_path / "native.yaml").write_text(NATIVE, encoding="utf-8")
    return tmp_path / "native.yaml"


def test_an_occupancy_map_is_summarised_and_drawn(run: Run, room: Path, tmp_path: Path) -> None:
    result = run("map", room, "-o", tmp_path / "picture.png")
    assert result.exit_code == 0
    assert "40 x 40 of 0.05 m" in result.stdout
    assert "90.0 % free, 0.0 % occupied, 10.0 % unknown; unknown cells count as obstacles" in result.stdout
    assert "starts at least 0.75 m and goals at least 0.30 m" in result.stdout
    assert result.stderr == ""
    assert (tmp_path / "picture.png").stat().st_size > 5000
    result = run("map", room, "--unknown", "free")
    assert "unknown cells count as free" in result.stdout
    assert "goals at least 0.50 m" in result.stdout


@pytest.mark.parametrize("suffix", ["svg", "pdf"])
def test_a_turned_map_is_drawn_with_a_warning(run: Run, room: Path, tmp_path: Path, suffix: str) -> None:
    served = room.with_name("map.yaml")
    served.write_text(served.read_text().replace("[0.0, 0.0, 0.0]", "[0.0, 0.0, 0.3]"), encoding="utf-8")
    result = run("map", served, "-o", tmp_path / f"picture.{suffix}")
    assert result.exit_code == 0
    assert result.stderr.startswith("warning: ")
    assert "map.yaml:3: origin: yaw 0.3 rad" in result.stderr
    assert (tmp_path / f"picture.{suffix}").stat().st_size > 3000


def test_a_start_that_is_not_free_is_refused(run: Run, room: Path) -> None:
    room.write_text(NATIVE.replace("[0.75, 0.75, 0.0]", "[1.88, 0.75, 0.0]"), encoding="utf-8")
    result = run("map", room)
    assert result.exit_code == 2
    assert "native.yaml:4: scenarios[0].start" in result.stderr
    assert run("map", room, "--unknown", "free").exit_code == 0  # it stands on unknown cells


def test_a_goal_behind_a_wall_is_told(run: Run, room: Path) -> None:
    wall = "obstacles: [{shape: wall, points: [[1.0, -1.0], [1.0, 3.0]]}]\n"
    room.write_text(NATIVE.replace("[1.5, 1.5]", "[1.6, 1.5]") + wall, encoding="utf-8")
    result = run("map", room)
    assert result.exit_code == 0
    assert "scenario 'open': no path leads to the goal" in result.stderr


def test_a_broken_image_is_one_message(run: Run, room: Path) -> None:
    image = room.with_name("map.pgm")
    image.write_bytes(image.read_bytes()[:500])
    for command in (("map", room), ("verify", "policy.onnx", "--map", room, "--eps", "0.01")):
        result = run(*command)
        assert result.exit_code == 2
        assert result.stderr.count("error: ") == 1
        assert "map.yaml:1: image" in result.stderr


def test_a_policy_is_verified_on_an_occupancy_map(run: Run, tmp_path: Path) -> None:
    greys = np.full((100, 100), 254)
    greys[48:52, 60:62] = 0
    served = write_map(tmp_path, greys, resolution=0.1, origin=[-5.0, -5.0, 0.0])
    report = tmp_path / "report.json"
    arguments = ("--map", served, "--eps", "0.01", "--scenarios", "3")
    result = run(
        "verify", "policy.onnx", *arguments, "-o", f"json:{report}", "-o", f"figure:{tmp_path}/f.png"
    )
    assert result.exit_code == 0, result.stderr
    written = json.loads(report.read_text())
    assert written["states"] > 0
    assert "unknown cells count as obstacles" in written["assumptions"]["obstacles"]
    assert (
        run("simulate", "policy.onnx", *arguments[:2], "--scenarios", "2", "--unknown", "free").exit_code == 0
    )
