from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from viatool.world import Obstacles, Scenario, load_map, unreachable_scenarios, wall_polygons


@pytest.mark.parametrize("name", ["lab", "office", "corridor-grid", "warehouse-grid"])
def test_every_goal_of_the_repository_can_be_reached(name: str) -> None:
    assert unreachable_scenarios(load_map(f"maps/{name}.yaml")).tolist() == []


@pytest.mark.parametrize(("gap", "expected"), [(0.5, [1]), (0.9, [])])
def test_a_gap_is_a_way_only_if_the_clearance_fits(gap: float, expected: list[int]) -> None:
    lab = load_map("maps/lab.yaml")
    walls = wall_polygons([[-4.85, 0.0], [0.0 - 0.5 * gap, 0.0]], 1e-6)
    walls += wall_polygons([[0.5 * gap, 0.0], [4.85, 0.0]], 1e-6)
    both = Obstacles(polygons=walls)
    inside = Scenario("same side", (0.0, 1.0, 0.0), (-1.0, 2.0), both)
    across = Scenario("across", (0.0, 1.0, 0.0), (0.0, -2.0), both)
    world = replace(lab, obstacles=Obstacles(np.zeros((0, 3))), scenarios=(inside, across))
    assert unreachable_scenarios(world).tolist() == expected
