from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from viatool.errors import MapError
from viatool.world import ScenarioGenerator, Scenes, WorldMap, load_map


@pytest.fixture(scope="module")
def lab() -> WorldMap:
    return load_map("maps/lab.yaml")


@pytest.fixture(scope="module")
def generator(lab: WorldMap) -> ScenarioGenerator:
    assert lab.generator is not None
    return lab.generator


def test_drawn_scenarios_keep_the_separations_of_the_task(
    lab: WorldMap, generator: ScenarioGenerator
) -> None:
    batch = generator.draw_arrays(2000, np.random.default_rng(0))
    fixed = np.broadcast_to(lab.obstacles.circles[:, :2], (2000, 4, 2))
    centres = np.concatenate([fixed, batch.circles[..., :2]], axis=1)
    apart = np.linalg.norm(centres[:, :, None] - centres[:, None], axis=-1)
    apart[:, :4, :4] = np.inf  # the fixed ones stand where the paper puts them
    apart[:, range(8), range(8)] = np.inf
    assert apart.min() >= 1.8
    assert np.linalg.norm(centres - batch.starts[:, None, :2], axis=-1).min() >= 1.8
    assert np.linalg.norm(centres - batch.goals[:, None], axis=-1).min() >= 1.2
    assert np.linalg.norm(batch.starts[:, :2] - batch.goals, axis=-1).min() >= 1.2
    for places in (batch.circles[..., :2], batch.starts[:, :2], batch.goals):
        assert np.abs(places).max() <= 4.0
    assert batch.circles[0, :, 2].tolist() == [0.5, 0.25, 0.21, 0.75]
    scenes = Scenes(lab.arena, lab.obstacles, batch.circles, batch.edges())
    assert scenes.clearance(batch.starts[:, :2], np.arange(2000)).min() >= lab.clearance.danger


def test_places_and_headings_spread_over_everything(generator: ScenarioGenerator) -> None:
    batch = generator.draw_arrays(4000, np.random.default_rng(1))
    heading, _ = np.histogram(batch.starts[:, 2], bins=8, range=(-np.pi, np.pi))
    assert heading.min() > 400
    for places in (batch.starts, batch.goals, batch.circles[:, 3]):
        quadrant, *_ = np.histogram2d(places[:, 0], places[:, 1], bins=2, range=[[-4, 4], [-4, 4]])
        assert quadrant.min() > 300


def test_the_same_seed_draws_the_same_scenarios_however_many(generator: ScenarioGenerator) -> None:
    few, many = generator.draw(5, seed=3), generator.draw(600, seed=3)
    assert len(many) == 600
    for first, second in zip(few, many, strict=False):
        assert (first.name, first.start, first.goal) == (second.name, second.start, second.goal)
        assert (first.obstacles.circles == second.obstacles.circles).all()
    assert generator.draw(1, seed=4)[0].start != few[0].start


def test_random_boxes_are_turned_and_keep_out_of_the_walls(
    lab: WorldMap, generator: ScenarioGenerator
) -> None:
    boxes = replace(generator, radii=(), boxes=((2.0, 0.3), (1.0, 1.0)), area=(-4.85, -4.85, 4.85, 4.85))
    batch = boxes.draw_arrays(500, np.random.default_rng(2))
    assert batch.boxes.shape == (500, 2, 4, 2)
    assert np.abs(batch.boxes).max() <= 4.85
    sides = np.linalg.norm(batch.boxes[:, :, 1] - batch.boxes[:, :, 0], axis=-1)
    assert sides == pytest.approx(np.broadcast_to([2.0, 1.0], (500, 2)))
    scenario = batch.scenario(7, "seven")
    assert (scenario.obstacles.edges() == batch.edges()[7]).all()
    scenes = Scenes(lab.arena, lab.obstacles, batch.circles, batch.edges())
    assert scenes.clearance(batch.starts[:, :2], np.arange(500)).min() >= 0.5


def test_a_curriculum_limits_the_distance_of_the_goal(generator: ScenarioGenerator) -> None:
    batch = generator.with_goal_distance(1.5, 2.0).draw_arrays(300, np.random.default_rng(3))
    distance = np.linalg.norm(batch.starts[:, :2] - batch.goals, axis=-1)
    assert distance.min() >= 1.5
    assert distance.max() <= 2.0


def test_too_many_obstacles_are_an_error_and_not_an_endless_loop(generator: ScenarioGenerator) -> None:
    with pytest.raises(MapError, match="no room for its 30 obstacles"):
        replace(generator, radii=(0.5,) * 30).draw(1, seed=0)
