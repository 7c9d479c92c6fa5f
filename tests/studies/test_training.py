"""The tasks of a comparison on real, tiny trainings: interrupted ones end in the same records."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from viatool.errors import ConfigurationError
from viatool.policy import load_policy
from viatool.studies.progress import Board
from viatool.studies.runner import run_tasks
from viatool.studies.study import Options
from viatool.studies.tasks import record_path
from viatool.studies.training import EvaluateSeed, TrainVariant, policy_path
from viatool.studies.variants import LAB, VIA

TINY = (
    "epochs=3",
    "epoch_steps=20",
    "robots=8",
    "updates_per_step=1",
    "warmup_episodes=4",
    "learning_starts=64",
    "batch_size=16",
    "critic_hidden=[8]",
    "replay_capacity=300",
    "horizon=20",
    "evaluation_interval=1",
    "evaluation_start=0",
    "validation_scenarios=4",
    "test_scenarios=2",
    "state_interval=1",
)
OPTIONS = Options(settings=TINY, seeds=2, scenarios=6)


class Killed(BaseException):
    """Stands for the end of the process."""


class Bomb(Board):
    """Ends the run when a task has come so far."""

    def __init__(self, fraction: float) -> None:
        super().__init__()
        self.fraction_of_end = fraction

    def put(self, task: str, message: Any) -> None:
        if message.fraction >= self.fraction_of_end:
            raise Killed


@pytest.fixture(scope="module")
def training() -> TrainVariant:
    return TrainVariant.of(LAB, VIA, OPTIONS)


@pytest.fixture(scope="module")
def whole(training: TrainVariant, tmp_path_factory: pytest.TempPathFactory) -> Path:
    output = tmp_path_factory.mktemp("whole")
    run_tasks([training, EvaluateSeed(training, 1, 6, 0.01)], output, Board())
    return output


def test_an_interrupted_training_is_resumed_and_gives_the_same_policies(
    training: TrainVariant, whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("viatool.schedule.progress._SECONDS_BETWEEN", 0.0)
    with pytest.raises(Killed):
        run_tasks([training], tmp_path, Bomb(0.5))
    assert (tmp_path / "lab" / "via-0.9" / "run" / "state.pt").exists()
    assert not record_path(tmp_path, training.name).exists()
    tasks = [training, EvaluateSeed(training, 1, 6, 0.01)]
    records = run_tasks(tasks, tmp_path, Board())
    for task in tasks:
        earlier = json.loads(record_path(whole, task.name).read_text(encoding="utf-8"))["result"]
        assert json.loads(json.dumps(records[task.name].result)) == earlier


def test_a_training_that_ended_without_a_record_is_not_repeated(
    training: TrainVariant, whole: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    record = record_path(whole, training.name)
    before = json.loads(record.read_text(encoding="utf-8"))["result"]
    record.unlink()
    for name in ("train", "resume"):
        monkeypatch.setattr(
            f"viatool.train.batches.{name}", lambda *_, **__: pytest.fail("it was trained again")
        )
    again = run_tasks([training], whole, Board())[training.name]
    assert json.loads(json.dumps(again.result)) == before


def test_an_interrupted_training_with_other_settings_is_refused(
    training: TrainVariant, tmp_path: Path
) -> None:
    run = tmp_path / "lab" / "via-0.9" / "run"
    run.mkdir(parents=True)
    other = training.configuration.model_copy(update={"epochs": 7})
    (run / "configuration.yaml").write_text(other.to_yaml(), encoding="utf-8")
    with pytest.raises(ConfigurationError, match="has different settings"):
        run_tasks([training], tmp_path, Board())


def test_an_evaluation_counts_states_episodes_and_costs(training: TrainVariant, whole: Path) -> None:
    found = json.loads(record_path(whole, "lab/via-0.9/seed-1").read_text(encoding="utf-8"))["result"]
    policy = load_policy(policy_path(whole, training.folder, 1))
    assert found["sha256"] == policy.sha256
    assert policy.spec is not None
    assert (policy.spec.training["seed"], policy.spec.training["epoch"]) == (1, found["epoch"])
    held_out = found["held_out"]
    assert held_out["task"]["episodes"] == len(held_out["costs"]) == 6
    assert held_out["task"]["average_cost"] == pytest.approx(sum(held_out["costs"]) / 6)
    assert held_out["safety_rate"]["overall"]["total"] == held_out["states"] > 6
    assert len(found["paths"]) == found["fixed"]["task"]["episodes"] == 10
    assert sum(len(path["states"]) for path in found["paths"]) == found["fixed"]["states"]
    for x, _, _, v_low, w_low, v_high, w_high in found["paths"][0]["states"]:
        assert abs(x) < 4.85
        assert 0.0 <= v_low <= v_high <= 0.5
        assert -1.0 <= w_low <= w_high <= 1.0


def test_every_variant_is_trained_with_its_method_and_level_and_the_limit_of_the_setting() -> None:
    from viatool.studies.variants import SETTINGS, VARIANTS

    for setting in SETTINGS.values():
        for variant in VARIANTS.values():
            options = TrainVariant.of(setting, variant, Options(settings=("batch_size=64",), seeds=4))
            home = TrainVariant.of(
                setting.home(variant), variant, Options(settings=("batch_size=64",), seeds=4)
            )
            same = {"cost_limit": options.configuration.cost_limit}
            assert home.configuration.model_copy(update=same) == options.configuration
            configuration = options.configuration
            assert (configuration.method, configuration.alpha) == (variant.method, variant.alpha)
            assert configuration.seeds == 4
            assert configuration.batch_size == 64
            assert configuration.checkpoint_interval == configuration.evaluation_interval
    assert TrainVariant.of(LAB, VIA, Options()).configuration.cost_limit == 10.0
