"""Missions that are not proved come back: episodes begin at their starts, and where their proofs ended."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from tests.hall import MAP
from tests.missions.dodging import write_dodging_policy
from tests.train.test_collection import driver
from tests.train.test_run import Lines, tiny, weights
from viatool import load_map, load_policy
from viatool.errors import ConfigurationError
from viatool.missions import Mission, MissionLimits, mission
from viatool.train import TrainingMaps, TrainingResult, make_configuration, resume, train
from viatool.train.collection import Collector
from viatool.train.feedback import EACH, Feedback, begin_again, find_feedback
from viatool.train.methods import METHODS
from viatool.train.networks import Weights
from viatool.train.observation import make_scaling
from viatool.train.run import begin_run
from viatool.world import ScenarioBatch, Scenes, WorldMap

LAB = load_map("maps/lab.yaml")
FED = {"mission_feedback": 0.5, "mission_scenarios": 1, "mission_parts": 20, "mission_interval": 1}


def some(count: int, seed: int = 3) -> ScenarioBatch:
    assert LAB.generator is not None
    return LAB.generator.draw_arrays(count, np.random.default_rng(seed))


def collector(share: float, feedback: Feedback | None, robots: int = 300, noise: float = 0.5) -> Collector:
    options = make_configuration(
        seeds=2,
        robots=robots,
        noise_lowest=0.0,
        noise_highest=noise,
        mission_feedback=share,
        mission_scenarios=1,
        shaping_path="straight",
    )
    scaling, method = make_scaling(LAB.robot, 10.0), METHODS["via"](options)
    return Collector(options, LAB, scaling, method, np.zeros(2), 0, feedback)


def at(starts: np.ndarray, poses: np.ndarray) -> np.ndarray:
    """Tell which poses (E, 3) are among some starts."""
    return np.asarray((poses[:, None] == starts).all(axis=2).any(axis=1))


def test_a_share_of_the_episodes_begins_where_missions_of_its_seed_failed() -> None:
    fed = some(8)
    robots = collector(0.3, Feedback(fed, np.array([5, 3])))
    again, simulator = robots.repeated, robots.simulator
    assert (again == at(fed.starts, simulator.poses)).all()
    for half, starts in ((slice(300), fed.starts[:5]), (slice(300, None), fed.starts[5:])):
        assert 0.2 < again[half].mean() < 0.4
        assert (again[half] == at(starts, simulator.poses[half])).all()
        assert at(simulator.poses[half], starts).all()  # every one of them is driven
    goals = fed.goals[(simulator.poses[again][:, None] == fed.starts).all(axis=2).argmax(axis=1)]
    np.testing.assert_array_equal(simulator.goals[again], goals)
    robot = int(np.flatnonzero(again)[0])
    row = int((simulator.poses[robot] == fed.starts).all(axis=1).argmax())
    np.testing.assert_array_equal(simulator.own_obstacles(robot).circles, fed.circles[row])


def test_a_seed_whose_missions_are_all_proved_drives_new_ones_alone() -> None:
    robots = collector(1.0, Feedback(some(5), np.array([0, 5])))
    assert not robots.repeated[:300].any()
    assert robots.repeated[300:].all()


def test_what_is_fed_back_later_counts_from_the_next_episodes_on() -> None:
    robots = collector(1.0, None, robots=4)
    before = robots.simulator.poses.copy()
    robots.feed_back(Feedback(some(2), np.array([1, 1])))
    np.testing.assert_array_equal(robots.simulator.poses, before)
    assert not robots.repeated.any()
    robots.simulator.reset(np.ones(8, dtype=bool))
    assert robots.simulator.repeated.all()


def test_the_constraint_sees_episodes_of_the_task_alone() -> None:
    """Robots without noise: where all of them drive again, none of their episodes counts for u and lambda."""
    for feedback, counts in ((None, True), (Feedback(some(8), np.array([4, 4])), False)):
        robots = collector(1.0, feedback, robots=4, noise=0.0)
        for _ in range(300):
            _, episodes = robots.step(driver_of_two(), np.zeros(2))
            if len(episodes):
                break
        assert len(episodes)
        assert (episodes.steady == counts).all()


def driver_of_two() -> Weights:
    one = driver(0.4)
    two = Weights(one.sizes, 2)
    with torch.no_grad():
        for own, every in zip(two.layers, one.layers, strict=True):
            own.copy_(every.expand_as(own))
    return two


def failed(tmp_path: Path) -> tuple[Mission, ScenarioBatch, WorldMap]:
    (tmp_path / "hall.yaml").write_text(MAP, encoding="utf-8")
    hall = replace(load_map(tmp_path / "hall.yaml"), generator=None)
    policy = load_policy(write_dodging_policy(tmp_path / "policy.onnx"))
    found = mission(
        policy, hall, eps=0.01, start_error=(0.02, 0.02), limits=MissionLimits(300, parts=5, finer=0)
    )
    first = found.missions[0]
    assert first.verdict == "unknown"
    batch = ScenarioBatch(
        np.array([first.scenario.start]),
        np.array([first.scenario.goal]),
        np.zeros((1, 0, 3)),
        np.zeros((1, 0, 4, 2)),
    )
    return first, batch, hall


def test_entries_are_the_start_and_where_the_proof_ended(tmp_path: Path) -> None:
    first, batch, hall = failed(tmp_path)
    entries = begin_again(first, batch, hall, 0.0, 0.5)
    assert len(entries) == EACH
    start = (entries.starts == batch.starts).all(axis=1)
    assert EACH // 2 <= start.sum() < EACH
    tube = first.proof.tube
    last = tube.step == first.proof.tube.step.max()
    for pose in entries.starts[~start]:
        assert ((tube.lower[last, :3] <= pose) & (pose <= tube.upper[last, :3])).all(axis=1).any()
    assert (entries.goals == batch.goals).all()


def test_no_entry_comes_too_near_or_has_arrived(tmp_path: Path) -> None:
    first, batch, hall = failed(tmp_path)
    wide = begin_again(first, batch, hall, 100.0, 0.5)
    assert (wide.starts == batch.starts).all()
    arrived = begin_again(first, batch, hall, 0.0, 100.0)
    assert (arrived.starts == batch.starts).all()


def test_what_is_found_repeats_and_survives_being_saved() -> None:
    options = make_configuration(
        seeds=2, mission_scenarios=2, mission_parts=5, mission_feedback=0.5, horizon=20
    )
    scaling = make_scaling(LAB.robot, 10.0)
    actor = scaling.actor((4,), 2, "relu").draw(torch.Generator().manual_seed(1))
    (once, shares), (again, _), (other, _) = (
        find_feedback(actor, np.zeros(2), LAB, scaling, options, epoch, 2) for epoch in (1, 1, 2)
    )
    assert shares.tolist() == [0.0, 0.0]
    assert once.counts.tolist() == [2 * EACH, 2 * EACH]
    saved = Feedback.of_state(once.state())
    for name in ("starts", "goals", "circles", "boxes"):
        own = getattr(once.batch, name)
        np.testing.assert_array_equal(own, getattr(again.batch, name))
        np.testing.assert_array_equal(own, getattr(saved.batch, name))
    assert not np.isin(once.batch.goals, other.batch.goals).any()
    scenes = Scenes(LAB.arena, LAB.obstacles, once.batch.circles, once.batch.edges())
    kept = scenes.footprint_clearance(once.batch.starts, LAB.robot.footprint, np.arange(len(once.batch)))
    assert (kept > LAB.clearance.collision).all()
    assert len(np.unique(once.batch.starts, axis=0)) > 4  # ends of runs that are late, beside the starts


class Killed(Exception):  # noqa: N818  # not an error
    pass


class Bomb(Lines):
    def __call__(self, stage: str, done: float, total: float, line: str = "", /) -> None:
        if done / total > 0.7:
            raise Killed


def table(result: TrainingResult) -> list[dict[str, str]]:
    with (result.run_directory / "metrics.csv").open(newline="") as stream:
        return list(csv.DictReader(stream))


@pytest.mark.parametrize("interval", [1, 2])
def test_a_run_feeds_back_and_resumes_as_if_never_interrupted(interval: int, tmp_path: Path) -> None:
    """States are saved after every epoch, or after every second one, between which robots stay on their way."""
    options = tiny(**FED, epochs=4, state_interval=interval, tensorboard=False)
    whole = train(options, tmp_path / "whole")
    rates = [row.get("proved_mission_rate") for row in table(whole)]
    assert rates == ["0"] * 6 + [""] * 2  # after the last epoch there is nothing to feed back to
    with pytest.raises(Killed):
        train(options, tmp_path / "killed", Bomb())
    again = resume(tmp_path / "killed")
    assert table(again) == table(whole)
    assert weights(again) == weights(whole)
    without = train(tiny(epochs=4, state_interval=interval, tensorboard=False), tmp_path / "without")
    first, later = slice(0, 2), slice(2, None)
    rewards = [[row["episode_reward"] for row in table(one)] for one in (whole, without)]
    assert rewards[0][first] == rewards[1][first]
    assert rewards[0][later] != rewards[1][later]


def test_a_map_that_draws_no_scenarios_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="no generator, of whose scenarios mission_feedback"):
        begin_run(
            make_configuration(mission_feedback=0.5, mission_scenarios=1),
            TrainingMaps((replace(LAB, generator=None),)),
        )
