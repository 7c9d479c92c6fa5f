"""Several maps: robots and scenarios are shared out among them, one policy is for one robot."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from tests.train.test_run import interrupted, tiny, weights
from viatool.errors import ConfigurationError
from viatool.train import TrainingMaps, load_configuration, make_configuration, train
from viatool.train.maps import load_maps
from viatool.train.run import begin_run
from viatool.world import load_map
from viatool.world.robot import ROBOTS

LAB, OFFICE = load_map("lab"), load_map("office")
BOTH = {"map": ("lab", "office"), "curriculum_epochs": 0}


def test_robots_and_scenarios_are_shared_out() -> None:
    maps = TrainingMaps((LAB, OFFICE, LAB))
    assert maps.shares(8) == (3, 3, 2)
    assert [(world.name, len(scenarios)) for world, scenarios in maps.draw(2, 0)] == [
        ("lab", 1),
        ("office", 1),
    ]
    assert maps.names == ("lab-1", "office", "lab-3")


def test_the_robots_of_every_map_drive_among_its_own_obstacles_and_learn_as_one() -> None:
    run = begin_run(tiny(**BOTH, robots=5, warmup_episodes=0))
    fleet, _ = run.robots()
    assert [(one.world_map.name, len(one.noise)) for one in fleet.collectors] == [
        ("lab", 2 * 3),
        ("office", 2 * 2),
    ]
    transition, _ = fleet.step(run.actor, run.var)
    assert transition.observation.shape[:2] == transition.reward.shape == (2, 5)
    assert torch.equal(
        transition.observation[:, 3:], fleet.start_observation[:, 3:]
    )  # no episode ends at once
    for one, world in zip(fleet.collectors, (LAB, OFFICE), strict=True):
        x_min, y_min, x_max, y_max = world.bounds
        poses = one.simulator.poses
        assert ((poses[:, :2] > (x_min, y_min)) & (poses[:, :2] < (x_max, y_max))).all()
    assert (np.abs(fleet.collectors[1].simulator.poses[:, 0]) > LAB.bounds[2]).any()  # beyond the lab


def test_a_list_of_one_map_is_that_map() -> None:
    steps = []
    for one in ("lab", ("lab",)):
        run = begin_run(tiny(map=one))
        fleet, _ = run.robots()
        steps.append(fleet.step(run.actor, run.var)[0].next_observation)
    assert torch.equal(*steps)


def test_a_run_on_two_maps_is_tested_on_each_and_goes_on_after_an_interruption(tmp_path: Path) -> None:
    options = tiny(**BOTH, epochs=2, tensorboard=False, finalists=1, evaluation_start=1.0, test_scenarios=2)
    whole = train(options, tmp_path / "whole")
    evaluation = json.loads((tmp_path / "whole" / "evaluation.json").read_text())
    names = ("fixed", "held_out", "lab fixed", "lab held_out", "office fixed", "office held_out")
    assert {name: evaluation[name]["episodes"] for name in names} == dict(
        zip(names, (20, 4, 10, 2, 10, 2), strict=True)
    )
    for kind in ("fixed", "held_out"):
        parts = [evaluation[f"{name} {kind}"]["collision_rate"] for name in ("lab", "office")]
        assert evaluation[kind]["collision_rate"] == pytest.approx(np.mean(parts))
    assert load_configuration(tmp_path / "whole" / "configuration.yaml") == options
    assert weights(interrupted(options, tmp_path / "parts")) == weights(whole)


def test_one_policy_is_for_one_robot(tmp_path: Path) -> None:
    slow = replace(OFFICE, robot=replace(OFFICE.robot, max_linear=0.3))
    with pytest.raises(
        ConfigurationError, match=r"robot of map .*office.* is not that of .*lab.*: max_linear"
    ):
        TrainingMaps((LAB, slow))


def test_a_known_robot_drives_on_every_map_in_place_of_theirs() -> None:
    maps = load_maps(make_configuration(map=("lab", "office"), robot="jackal"))
    for mine, theirs in zip(maps.maps, (LAB, OFFICE), strict=True):
        assert mine.robot.max_linear == ROBOTS["jackal"].max_linear
        assert mine.robot.lidar is not None
        assert mine.robot.control_interval == theirs.robot.control_interval
    with pytest.raises(ConfigurationError, match="unknown robot 'tank'"):
        load_maps(make_configuration(robot="tank"))


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"map": ()}, "at least one map"),
        ({"map": ("lab", "lab")}, "none twice"),
        ({"map": ("lab", "office"), "robots": 1}, "robots 1 is less than the 2 maps"),
        ({"map": ("lab", "office"), "mission_scenarios": 1}, "mission_scenarios 1 is less than the 2 maps"),
    ],
)
def test_what_cannot_be_shared_out_is_refused(given: dict[str, object], said: str) -> None:
    with pytest.raises(ConfigurationError, match=said):
        make_configuration(**given)
