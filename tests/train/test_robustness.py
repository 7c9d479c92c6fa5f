"""What a user can run into: divergence, maps without a generator, other robots, other networks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from tests.needs import needs_pybullet
from tests.train.test_run import tiny
from viatool.errors import ViatoolError
from viatool.train import train
from viatool.train.run import TrainingRun
from viatool.world import load_map


def test_a_diverging_training_is_stopped_with_a_message(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(run: TrainingRun, *_: object) -> None:
        measured = _[-1]
        assert isinstance(measured, list)
        measured.append({"task_critic_loss": torch.tensor([1.0, float("nan")])})

    monkeypatch.setattr("viatool.train.epoch._learn", broken)
    with pytest.raises(ViatoolError, match="diverged in epoch 1: task_critic_loss is not finite"):
        train(tiny(tensorboard=False), tmp_path / "run")


def test_a_map_without_generator_is_trained_on_its_scenarios(tmp_path: Path) -> None:
    text = Path("maps/lab.yaml").read_text(encoding="utf-8")
    start, end = text.index("# Random scenarios"), text.index("# Drawn with seed")
    path = tmp_path / "fixed.yaml"
    path.write_text(text[:start] + text[end:], encoding="utf-8")
    result = train(tiny(map=str(path), epochs=1, tensorboard=False), tmp_path / "run")
    assert list(result.evaluation) == ["fixed"]


def test_another_robot_gets_commands_within_its_own_limits(tmp_path: Path) -> None:
    text = Path("maps/lab.yaml").read_text(encoding="utf-8")
    text = text.replace("max_linear: 0.5", "max_linear: 0.2").replace("max_angular: 1.0", "max_angular: 2.0")
    path = tmp_path / "slow.yaml"
    path.write_text(text.replace("bins: 20", "bins: 10"), encoding="utf-8")
    robot = load_map(path).robot
    assert (robot.max_linear, robot.max_angular, robot.lidar.bins) == (0.2, 2.0, 10)
    options = {"actor_hidden": (8,), "actor_activation": "tanh", "near_features": False}
    result = train(tiny(map=str(path), epochs=1, tensorboard=False, **options), tmp_path / "run")
    assert result.policy.input_size == 16
    actions = result.policy(np.random.default_rng(0).uniform(-9, 9, (500, 16)))
    assert (np.abs(actions - [0.1, 0.0]) <= [0.1 + 1e-9, 2.0 + 1e-9]).all()
    assert actions[:, 1].max() > 0.0 > actions[:, 1].min()


@needs_pybullet
def test_a_policy_is_trained_in_the_physics_engine(tmp_path: Path) -> None:
    few = {"seeds": 1, "robots": 2, "epochs": 1, "epoch_steps": 12, "learning_starts": 8, "horizon": 5}
    scenarios = {"validation_scenarios": 2, "test_scenarios": 2, "warmup_episodes": 2}
    options = tiny(engine="bullet", tensorboard=False, **few, **scenarios)
    result = train(options, tmp_path / "run")
    assert result.evaluation["held_out"]["episodes"] == 2
    assert result.policy.spec is not None
    assert result.policy.spec.training["configuration"]["engine"] == "bullet"
    again = train(options, tmp_path / "again")
    rows = np.random.default_rng(0).uniform(0, 3, (9, 26))
    assert np.array_equal(again.policy(rows), result.policy(rows))
