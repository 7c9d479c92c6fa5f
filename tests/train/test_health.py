"""A run that goes wrong says so, its curves are drawn while it runs, and what its policy fails in at the end."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from click.testing import CliRunner
from PIL import Image

from tests.train.test_run import TINY, tiny
from viatool.cli import main
from viatool.train import failing_scenarios, make_configuration, train
from viatool.train.collection import make_task, shaping_reward
from viatool.train.curves import draw_curves, sparkline
from viatool.train.health import complaints, largest_return
from viatool.train.updates import saturated_share
from viatool.world import Robot

OPTIONS = make_configuration(seeds=2, epochs=40)
LARGEST = largest_return(OPTIONS, Robot())
FINE = {"success_rate": 0.5, "saturated_share": 0.2, "task_value": 5.0}


def rows(epochs: int, *seeds: dict[str, float]) -> list[dict[str, float]]:
    return [
        {"epoch": epoch, "seed": seed, **FINE, **changes}
        for epoch in range(1, epochs + 1)
        for seed, changes in enumerate(seeds)
    ]


def test_a_run_that_learns_has_nothing_to_complain_of() -> None:
    assert complaints(rows(40, {}, {}), OPTIONS, LARGEST) == {}
    assert complaints([], OPTIONS, LARGEST) == {}


def test_that_no_seed_arrives_is_said_after_a_quarter_of_the_run_and_not_before() -> None:
    flat = {"success_rate": 0.01}
    assert "flat" not in complaints(rows(9, flat, flat), OPTIONS, LARGEST)
    assert "after 10 epochs no seed arrives" in complaints(rows(10, flat, flat), OPTIONS, LARGEST)["flat"]
    assert "flat" not in complaints(rows(10, flat, {}), OPTIONS, LARGEST)


def test_saturated_actors_and_critics_that_promise_too_much_are_named() -> None:
    found = complaints(rows(3, {}, {"saturated_share": 0.95}), OPTIONS, LARGEST)
    assert found.keys() == {"saturated"}
    assert found["saturated"].startswith("seed 1 commands the ends of its range")
    found = complaints(rows(3, {"task_value": -3 * LARGEST}, {"task_value": 3 * LARGEST}), OPTIONS, LARGEST)
    assert found.keys() == {"values"}
    assert found["values"].startswith("the critics of seeds 0, 1 predict")
    assert complaints(rows(3, {}, {"task_value": float("nan")}), OPTIONS, LARGEST) == {}


def test_no_episode_returns_more_than_the_largest_return() -> None:
    """The rewards of a step at their worst and at their best, over very long episodes with a goal or a collision."""
    robot, task = Robot(), make_task(OPTIONS)
    discounts = OPTIONS.discount ** np.arange(2000)
    moved = robot.control_interval * np.hypot(robot.max_linear, OPTIONS.shaping_lookahead * robot.max_angular)
    best = OPTIONS.shaping * moved * discounts.sum() + task.goal_reward
    worst = (
        -OPTIONS.shaping * moved - task.turn_penalty * robot.max_angular - task.proximity_penalty * task.proximity_range
        - OPTIONS.steering_penalty * 2 * robot.max_angular - OPTIONS.standing_penalty
    ) * discounts.sum() + task.collision_reward  # fmt: skip
    assert OPTIONS.reward_scale * max(best, -worst) <= LARGEST
    far = shaping_reward(
        OPTIONS.shaping, OPTIONS.discount, np.array([1.0]), np.array([1.0 - moved]), np.array([False])
    )
    assert far[0] <= OPTIONS.shaping * (moved + (1 - OPTIONS.discount))


def test_the_saturated_share_is_that_of_commands_near_the_ends() -> None:
    raw = torch.tensor([[[0.0, 3.0], [-2.7, 2.6]]])
    assert saturated_share(raw).tolist() == [0.5]


def test_a_line_of_blocks() -> None:
    assert sparkline([0.0, 0.5, 1.0], 10, 1.0) == "▁▅█"
    assert sparkline([2.0, 4.0], 10) == "▅█"
    assert sparkline([0.0, 0.0], 10) == "▁▁"
    assert sparkline([np.nan, 1.0, np.nan], 10, 1.0) == " █ "
    assert sparkline([np.nan], 10) == " "
    assert sparkline(np.linspace(0, 1, 100), 4, 1.0) == "▂▄▅▇"


def test_a_run_draws_its_curves_warns_and_shows_its_failures(tmp_path: Path) -> None:
    settings = [f"--set={name}={json.dumps(value)}" for name, value in TINY.items() if name != "seeds"]
    more = [
        "--set=epochs=5",
        "--set=tensorboard=false",
        "--set=learning_rate=1e-6",
        "--set=saturation_penalty=0",
    ]
    more += ["--seeds", "2", "--watch", "--output", str(tmp_path / "run")]
    result = CliRunner().invoke(main, ["train", *settings, *more])
    assert result.exit_code == 0, result.output
    curves = draw_curves(tmp_path / "run" / "metrics.csv")
    assert [line.split()[0] for line in curves][:2] == ["success", "collisions"]
    for line in curves:
        assert line in result.output
    assert result.output.count("warning: after 5 epochs no seed arrives") == 1
    record = json.loads((tmp_path / "run" / "evaluation.json").read_text())
    ((world_map, scenarios),) = failing_scenarios(tmp_path / "run")
    assert len(scenarios) == len(record["failures"]) == round(8 * (1 - record["held_out"]["success_rate"]))
    picture = tmp_path / "run" / f"failures-{world_map.name}.png"
    assert f"failures    {picture}" in result.output
    with Image.open(picture) as drawn:
        assert min(drawn.size) > 500


def test_failures_are_those_of_the_test_and_not_of_other_scenarios(tmp_path: Path) -> None:
    train(tiny(tensorboard=False, epochs=1), tmp_path / "run")
    record = json.loads((tmp_path / "run" / "evaluation.json").read_text())
    ((world_map, scenarios),) = failing_scenarios(tmp_path / "run")
    assert world_map.generator is not None
    drawn = world_map.generator.draw(8, 2_000_003)
    numbers = [number for _, number in record["failures"]]
    assert [one.start for one in scenarios] == [drawn[number].start for number in numbers]


@pytest.mark.parametrize("missing", ["success_rate", "task_value", "saturated_share"])
def test_what_was_not_measured_is_no_complaint(missing: str) -> None:
    told = [{name: value for name, value in row.items() if name != missing} for row in rows(20, {}, {})]
    assert complaints(told, OPTIONS, LARGEST).keys() <= {"flat"}
