"""A whole run, small enough for a test: it repeats bit for bit, records itself and exports what it learnt."""

from __future__ import annotations

import csv
import json
import random
import subprocess
import sys
import time
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
import torch

from viatool.errors import ConfigurationError
from viatool.policy import load_policy
from viatool.train import TrainingConfiguration, TrainingResult, make_configuration, resume, train
from viatool.train.export import export_actor, export_checkpoint
from viatool.train.networks import HiddenActivation, Weights
from viatool.train.observation import make_scaling, make_specification
from viatool.world import load_map

TINY = {
    "seeds": 2,
    "epochs": 3,
    "epoch_steps": 25,
    "robots": 8,
    "updates_per_step": 2,
    "warmup_episodes": 4,
    "learning_starts": 64,
    "batch_size": 16,
    "critic_hidden": (16,),
    "replay_capacity": 300,
    "horizon": 20,
    "evaluation_interval": 1,
    "evaluation_start": 0.0,
    "validation_scenarios": 6,
    "final_scenarios": 6,
    "finalists": 3,
    "test_scenarios": 8,
    "checkpoint_interval": 2,
    "state_interval": 1,
    "curriculum_start": 3.0,
    "curriculum_epochs": 2,
    "multiplier_initial": 0.1,
    "multiplier_step": 0.001,
}


class Lines:
    """A progress that remembers."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self.fractions: list[float] = []

    def __call__(self, stage: str, done: float, total: float, line: str = "", /) -> None:
        if line:
            self.lines.append(line)
        else:
            self.fractions.append(done / total)


def tiny(**changes: object) -> TrainingConfiguration:
    return make_configuration("quick", None, (), **(TINY | changes))


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> tuple[TrainingResult, Lines]:
    progress = Lines()
    return train(tiny(), tmp_path_factory.mktemp("runs") / "first", progress), progress


def test_the_same_seed_repeats_bit_for_bit(run: tuple[TrainingResult, Lines], tmp_path: Path) -> None:
    first, _ = run
    second = train(tiny(tensorboard=False), tmp_path / "second")
    again, once = (result.run_directory / "metrics.csv" for result in (second, first))
    assert again.read_bytes() == once.read_bytes()
    assert weights(second) == weights(first)
    other = train(tiny(seed=1, tensorboard=False), tmp_path / "third")
    assert weights(other) != weights(first)


def interrupted(options: TrainingConfiguration, folder: Path) -> TrainingResult:
    """Train, stop after the first epoch, and go on."""

    def stop(stage: str, done: float, total: float, line: str = "", /) -> None:
        if line.startswith("epoch   1"):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(options, folder, stop)
    return resume(folder)


def weights(result: TrainingResult) -> list[bytes]:
    rows = np.random.default_rng(0).uniform(-1, 5, (50, 26))
    return [result.policy(rows).tobytes()]


def test_a_run_directory_holds_all_that_tells_where_the_policy_comes_from(
    run: tuple[TrainingResult, Lines],
) -> None:
    directory = run[0].run_directory
    names = sorted(path.name for path in directory.iterdir())
    assert names == [
        "checkpoints",
        "configuration.yaml",
        "evaluation.json",
        "metrics.csv",
        "policy.onnx",
        "tensorboard",
        "versions.json",
    ]
    assert sorted(path.name for path in (directory / "checkpoints").iterdir()) == [
        "epoch_0002.pt",
        "epoch_0003.pt",
    ]
    assert make_configuration("paper", directory / "configuration.yaml") == tiny()
    assert json.loads((directory / "versions.json").read_text())["torch"]
    assert any((directory / "tensorboard").iterdir())


def test_metrics_have_a_row_for_each_epoch_and_seed(run: tuple[TrainingResult, Lines]) -> None:
    with (run[0].run_directory / "metrics.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [row["epoch"] for row in rows] == ["1", "1", "2", "2", "3", "3"]
    assert [row["seed"] for row in rows] == ["0", "1"] * 3
    last = {name: float(value) for name, value in rows[-1].items()}
    assert last["steps"] == 3 * 25 * 8
    assert last["episodes"] >= 8
    assert 0.0 <= last["var"] <= 9.0
    for name in ("task_critic_loss", "cost_critic_loss", "action_cost", "validation_success_rate"):
        assert np.isfinite(last[name]), name


def test_progress_reaches_the_end_and_says_a_line_for_each_epoch(run: tuple[TrainingResult, Lines]) -> None:
    progress = run[1]
    assert progress.fractions == sorted(progress.fractions)
    assert progress.fractions[-1] == 1.0
    assert len(progress.lines) == 3
    assert "validation" in progress.lines[-1]


def test_the_policy_takes_physical_observations_and_gives_commands_within_the_limits(
    run: tuple[TrainingResult, Lines],
) -> None:
    policy = load_policy(run[0].policy_path)
    assert (policy.input_size, policy.output_size) == (26, 2)
    rng = np.random.default_rng(0)
    actions = policy(rng.uniform(-5.0, 7.0, (1000, 26)))
    assert (actions >= [-1e-9, -1.0 - 1e-9]).all()
    assert (actions <= [0.5 + 1e-9, 1.0 + 1e-9]).all()


def test_the_specification_tells_channels_units_limits_and_training(
    run: tuple[TrainingResult, Lines],
) -> None:
    result = run[0]
    spec = result.policy.spec
    assert spec is not None
    kinds = [channel.kind for channel in spec.observation]
    assert kinds == [
        "lidar",
        "goal_distance",
        "goal_cosine",
        "goal_sine",
        "previous_linear",
        "previous_angular",
        "budget",
    ]
    budget = spec.channel("budget").value
    assert budget is not None
    assert 0.0 <= budget <= 9.0
    assert [(channel.name, channel.lower, channel.upper) for channel in spec.action] == [
        ("v", 0.0, 0.5),
        ("omega", -1.0, 1.0),
    ]
    assert spec.training["method"] == "via"
    assert spec.training["seed"] == result.seed
    assert spec.training["configuration"]["epochs"] == 3


def test_the_normaliser_is_the_scaling_of_the_training(run: tuple[TrainingResult, Lines]) -> None:
    scaling = make_scaling(load_map("maps/lab.yaml").robot, 10.0)
    middle = np.concatenate([np.full(20, 2.0), [3.0, 0.0, 0.0, 0.25, 0.0, 0.0]])
    assert scaling.offset.tolist() == middle.tolist()
    inputs = scaling.normalise(middle[None, :-1] + 1.0, np.array([5.0]))
    np.testing.assert_allclose(inputs[0].numpy(), [0.5] * 20 + [1 / 3, 1, 1, 4, 1, 0.5], rtol=1e-6)
    np.testing.assert_allclose(scaling.physical_action(np.array([[-1.0, 1.0]])), [[0.0, 1.0]])


def test_evaluation_counts_every_scenario_once(run: tuple[TrainingResult, Lines]) -> None:
    evaluation = run[0].evaluation
    assert {name: metrics["episodes"] for name, metrics in evaluation.items()} == {"fixed": 10, "held_out": 8}
    for metrics in evaluation.values():
        rates = [metrics[f"{outcome}_rate"] for outcome in ("success", "collision", "timeout")]
        assert sum(rates) == pytest.approx(1.0)
    assert "held_out" in "\n".join(run[0].lines())


def test_a_run_never_overwrites_an_earlier_one(run: tuple[TrainingResult, Lines]) -> None:
    with pytest.raises(ConfigurationError, match="holds an earlier run"):
        train(tiny(), run[0].run_directory)


def test_a_checkpoint_becomes_a_policy(run: tuple[TrainingResult, Lines], tmp_path: Path) -> None:
    checkpoint = run[0].run_directory / "checkpoints" / "epoch_0003.pt"
    policies = [export_checkpoint(checkpoint, tmp_path / f"{seed}.onnx", seed=seed) for seed in (0, 1)]
    rows = np.random.default_rng(0).uniform(0, 2, (20, 26))
    assert not np.allclose(policies[0](rows), policies[1](rows))
    for given in (load_map("lab"), "maps/lab.yaml"):  # the file is the same wherever the map is found
        again = export_checkpoint(checkpoint, tmp_path / "again.onnx", seed=0, map_path=given)
        assert again.sha256 == policies[0].sha256
    best = export_checkpoint(checkpoint, tmp_path / "best.onnx")
    assert any(np.array_equal(best(rows), policy(rows)) for policy in policies)
    with pytest.raises(ConfigurationError, match="seed 2"):
        export_checkpoint(checkpoint, tmp_path / "none.onnx", seed=2)
    assert not (tmp_path / "none.onnx").exists()


def test_a_foreign_file_is_no_checkpoint(tmp_path: Path) -> None:
    path = tmp_path / "epoch_0001.pt"
    path.write_text("not a checkpoint")
    with pytest.raises(ConfigurationError, match="cannot read the checkpoint"):
        export_checkpoint(path, tmp_path / "policy.onnx")
    with pytest.raises(ConfigurationError, match="cannot read the checkpoint"):
        export_checkpoint(tmp_path / "missing.pt", tmp_path / "policy.onnx")


@pytest.mark.parametrize("activation", get_args(HiddenActivation))
def test_an_actor_of_any_activation_is_exported(activation: HiddenActivation, tmp_path: Path) -> None:
    robot = load_map("maps/lab.yaml").robot
    actor = Weights((26, 12, 2), 1, activation).draw(torch.Generator().manual_seed(0), 3.0)
    specification = make_specification(robot, 0.0, {})
    policy = export_actor(actor, make_scaling(robot, 10.0), specification, tmp_path / "actor.onnx")
    assert policy(np.zeros((1, 26))).shape == (1, 2)  # the export itself compares with torch


class Killed(Exception):  # noqa: N818  # an event, not an error
    """Stands for the end of the process."""


@pytest.mark.parametrize("moment", [10, 60])
def test_a_killed_run_goes_on_as_if_it_had_never_stopped(
    run: tuple[TrainingResult, Lines], tmp_path: Path, moment: int
) -> None:
    class Bomb(Lines):
        def __call__(self, stage: str, done: float, total: float, line: str = "", /) -> None:
            super().__call__(stage, done, total, line)
            if len(self.fractions) == moment:
                raise Killed

    with pytest.raises(Killed):
        train(tiny(tensorboard=False), tmp_path / "killed", Bomb())
    assert (tmp_path / "killed" / "state.pt").exists() == (moment > 25)
    (tmp_path / "killed" / "checkpoints").mkdir(exist_ok=True)
    for draft in (".state-ab_3defg.pt", "checkpoints/.epoch_0002-abcdefgh.pt"):
        (tmp_path / "killed" / draft).write_text("half of it")
    finished = resume(tmp_path / "killed")
    assert weights(finished) == weights(run[0])
    assert not list((tmp_path / "killed").rglob(".*"))
    rows = [
        (directory / "metrics.csv").read_bytes() for directory in (tmp_path / "killed", run[0].run_directory)
    ]
    assert rows[0] == rows[1]


def test_a_run_whose_process_is_killed_goes_on(tmp_path: Path) -> None:
    options = tiny(epochs=6, tensorboard=False)
    (tmp_path / "options.yaml").write_text(options.to_yaml(), encoding="utf-8")
    directory = tmp_path / "killed"
    command = [sys.executable, "-m", "viatool", "train", "--config", str(tmp_path / "options.yaml")]
    process = subprocess.Popen([*command, "--output", str(directory), "--quiet"])
    while not (directory / "state.pt").exists():
        assert process.poll() is None
        time.sleep(0.01)
    time.sleep(random.uniform(0.0, 0.1))  # any moment will do
    process.kill()  # SIGKILL: nothing can be tidied up
    process.wait()
    assert not (directory / "evaluation.json").exists()
    assert weights(resume(directory)) == weights(train(options, tmp_path / "whole"))


def test_td7_resumes_with_its_priorities_and_codes(tmp_path: Path) -> None:
    options = tiny(method="td7", hard_target_interval=7, tensorboard=False)
    whole = train(options, tmp_path / "whole")

    class Bomb(Lines):
        def __call__(self, stage: str, done: float, total: float, line: str = "", /) -> None:
            if done / total > 0.7:
                raise Killed

    with pytest.raises(Killed):
        train(options, tmp_path / "killed", Bomb())
    assert weights(resume(tmp_path / "killed")) == weights(whole)


def test_only_an_unfinished_run_can_be_resumed(run: tuple[TrainingResult, Lines], tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="is finished"):
        resume(run[0].run_directory)
    with pytest.raises(ConfigurationError, match="no training run"):
        resume(tmp_path)


@pytest.mark.parametrize("method", ["td3", "td7", "rcpo", "sac-lag", "wcsac", "cvar-cpo"])
def test_every_method_trains_and_exports(method: str, tmp_path: Path) -> None:
    result = train(tiny(method=method, epochs=1, seeds=1, tensorboard=False), tmp_path / method)
    spec = result.policy.spec
    assert spec is not None
    assert spec.training["method"] == method
    budget = spec.channel("budget").value
    assert budget is not None
    assert (budget == 0.0) or method == "cvar-cpo"
    with (result.run_directory / "metrics.csv").open(newline="") as stream:
        (row,) = csv.DictReader(stream)
    assert (float(row["multiplier"]) == 0.0) == (method in ("td3", "td7"))
