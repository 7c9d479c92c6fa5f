"""The preset ``release``: the settings of the paper's published code, by method."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest

from tests.train.test_run import interrupted, tiny, weights
from viatool.errors import ConfigurationError
from viatool.train import TrainingMaps, epoch, make_configuration, train
from viatool.train.maps import load_maps
from viatool.train.run import begin_run
from viatool.world import load_map


def test_each_method_has_the_settings_with_which_it_was_run() -> None:
    via, td3, rcpo = (make_configuration("release", method=method) for method in ("via", "td3", "rcpo"))
    assert (via.multiplier_initial, via.multiplier_step, via.replay_capacity) == (1.0, 0.001, 500_000)
    assert (rcpo.multiplier_initial, rcpo.multiplier_step, rcpo.replay_capacity) == (0.0, 5e-7, 500_000)
    assert td3.replay_capacity == 5000
    assert {(one.quantiles, one.batch_size, one.var_step, one.cost_limit) for one in (via, td3, rcpo)} == {
        (128, 40, 0.1, 10.0)
    }
    assert (
        make_configuration("release", settings=["replay_capacity=9000"], method="td3").replay_capacity == 9000
    )
    assert make_configuration("paper", method="td3").replay_capacity == 200_000


def test_the_robot_may_drive_faster_than_the_map_says() -> None:
    maps = load_maps(make_configuration("release"))
    assert maps.robot.max_linear == 1.0
    assert maps.maps[0].robot.lidar is not None
    assert load_map("lab").robot.max_linear == 0.5


def test_goals_come_to_be_as_far_as_the_curriculum_ends() -> None:
    run = begin_run(tiny(curriculum_start=2.0, curriculum_end=8.0, curriculum_epochs=2, warmup_episodes=0))
    fleet, _ = run.robots()
    farthest = []
    for run.epoch in range(4):
        epoch._set_curriculum(run, fleet)
        generator = fleet.collectors[0].simulator.generator
        assert generator is not None
        farthest.append(generator.goal_distance[1])
    assert farthest == [2.0, 5.0, 8.0, 8.0]


@pytest.mark.parametrize("each", [3, 1])
def test_updates_by_episodes_are_as_many_as_episodes_bring_also_after_an_interruption(
    each: int, tmp_path: Path
) -> None:
    """Seeds share their updates; a part of an update that an epoch leaves over is taken in the next one."""
    changes = {
        "updates_per_episode": each,
        "learning_starts": 1,
        "replay_capacity": 5000,
        "tensorboard": False,
    }
    options = tiny(**changes, epochs=2, test_scenarios=1)
    whole = train(options, tmp_path / "whole")
    with (tmp_path / "whole" / "metrics.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    episodes = sum(int(row["episodes"]) for row in rows)
    assert int(rows[-1]["updates"]) == each * episodes // options.seeds
    assert weights(interrupted(options, tmp_path / "parts")) == weights(whole)


def test_a_checkpoint_may_be_chosen_on_the_fixed_scenarios(tmp_path: Path) -> None:
    """The ten of the lab: shares of them are tenths."""
    train(tiny(select_on="fixed", epochs=1, tensorboard=False, test_scenarios=1), tmp_path / "run")
    with (tmp_path / "run" / "metrics.csv").open(newline="") as stream:
        rates = [float(row["validation_collision_rate"]) for row in csv.DictReader(stream)]
    assert [10 * rate for rate in rates] == [pytest.approx(round(10 * rate)) for rate in rates]
    hall = TrainingMaps((load_map("lab.ros"),))
    with pytest.raises(
        ConfigurationError, match="no scenarios of its own, on which select_on: fixed chooses"
    ):
        begin_run(make_configuration(map="lab.ros", select_on="fixed"), hall)
