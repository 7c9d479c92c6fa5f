from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from viatool.world import Scenes, load_map

LAB = Path("maps/lab.yaml")


def test_the_lab_is_the_paper_s() -> None:
    lab = load_map(LAB)
    assert lab.bounds == (-4.85, -4.85, 4.85, 4.85)
    assert lab.obstacles.circles.tolist() == [
        [-2.93, 3.17, 0.26],
        [2.86, -3.0, 0.56],
        [-2.77, -0.96, 0.14],
        [2.83, 2.93, 0.98],
    ]
    assert (lab.clearance.collision, lab.clearance.danger) == (0.4, 0.5)
    robot, lidar = lab.robot, lab.robot.lidar
    assert (robot.name, robot.footprint.kind, robot.control_interval) == ("turtlebot3", "point", 0.1)
    assert (robot.min_linear, robot.max_linear, robot.max_angular) == (0.0, 0.5, 1.0)
    assert (lidar.rays, lidar.bins, lidar.minimum_range, lidar.maximum_range) == (180, 20, 0.2, 7.0)
    assert lidar.noise == 0.01
    assert np.degrees(lidar.angles()[[0, -1]]) == pytest.approx([-90.0, 90.0])


def test_the_lab_has_ten_scenarios_with_the_separations_of_the_task() -> None:
    lab = load_map(LAB)
    assert len(lab.scenarios) == 10
    scenes = Scenes.of(lab, lab.scenarios)
    starts = np.array([scenario.start for scenario in lab.scenarios])
    assert (scenes.clearance(starts[:, :2], np.arange(10)) > lab.clearance.danger).all()
    for scenario in lab.scenarios:
        own = scenario.obstacles.circles
        assert sorted(own[:, 2]) == [0.21, 0.25, 0.5, 0.75]
        centres = np.concatenate([lab.obstacles.circles[:, :2], own[:, :2]])
        assert (np.abs(own[:, :2]) <= 4.0).all()
        for number in range(4, 8):
            assert np.hypot(*(np.delete(centres, number, 0) - centres[number]).T).min() > 1.799
        assert np.hypot(*(centres - scenario.start[:2]).T).min() > 1.799
        assert np.hypot(*(centres - scenario.goal).T).min() > 1.799


def test_the_script_in_the_repository_writes_the_lab_as_it_is(tmp_path: Path) -> None:
    script = tmp_path / "make_lab.py"
    script.write_bytes(Path("maps/make_lab.py").read_bytes())
    subprocess.run([sys.executable, script], check=True, env=os.environ | {"PYTHONPATH": str(Path.cwd())})
    assert (tmp_path / "lab.yaml").read_text(encoding="utf-8") == LAB.read_text(encoding="utf-8")
