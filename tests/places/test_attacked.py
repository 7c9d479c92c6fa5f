"""Certified cells attacked by driving at corners of the error model, a few of tests/benchmarks/certified_corners.py."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tests.benchmarks import certified_corners as corners
from viatool import load_map, load_policy
from viatool.world import Obstacles

ROOM = load_map("maps/room.yaml")
WORLD = replace(ROOM, obstacles=ROOM.obstacles + Obstacles(corners.POSTS))
POLICY = load_policy("policies/via.onnx")


def left(case, asked):
    """What drives leave, from cells that are certified with the errors that are asked about."""
    scenario = WORLD.scenarios[0]
    cells = corners.certified(POLICY, WORLD, scenario, asked, 0.006, 0.08, 0)
    assert len(cells[0]) > 5
    return corners.attack(POLICY, WORLD, scenario, case, cells, 1500, 0)


@pytest.mark.parametrize("name", ["sensors, pose", "missing", "all"])
def test_no_drive_from_a_certified_cell_comes_too_near(name):
    found = left(corners.CASES[name], corners.CASES[name])
    assert len(found) == 1500
    assert found.min() >= -corners.corners.MARGIN


@pytest.mark.parametrize("name", ["moving", "all"])
def test_drives_find_cells_that_are_certified_without_the_errors(name):
    assert (left(corners.CASES[name], {}) < -corners.corners.MARGIN).any()
