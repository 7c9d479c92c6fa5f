"""Seeds in several batches: each is a run like any other, whoever trains it, and the best policy of all is kept."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest
import torch

from tests.train.test_run import Lines, tiny
from viatool.errors import ConfigurationError
from viatool.schedule import Processes
from viatool.train import TrainingResult, holds_progress, resume_seeds, train, train_seeds

OPTIONS = tiny(seeds=3, seed=7, tensorboard=False, state_interval=1)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[TrainingResult, Lines]:
    progress = Lines()
    folder = tmp_path_factory.mktemp("runs") / "whole"
    return train_seeds(OPTIONS, folder, batch=2, progress=progress), progress


def content(folder: Path) -> dict[str, bytes]:
    """Return the files that do not tell how long they took."""
    files = (
        path for path in folder.rglob("*") if path.is_file() and path.suffix in (".onnx", ".csv", ".yaml")
    )
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


def test_each_batch_is_a_run_like_any_other(whole: tuple[TrainingResult, Lines], tmp_path: Path) -> None:
    folder = whole[0].run_directory
    alone = train(OPTIONS.model_copy(update={"seeds": 1, "seed": 8}), tmp_path / "alone")
    assert content(folder / "batch-1") == content(alone.run_directory)
    first = OPTIONS.model_copy(update={"seeds": 2})
    assert (folder / "batch-0" / "configuration.yaml").read_text() == first.to_yaml()
    assert not (folder / "batch-2").exists()


def test_the_best_policy_of_all_batches_is_kept(whole: tuple[TrainingResult, Lines]) -> None:
    result, folder = whole[0], whole[0].run_directory
    records = [json.loads((folder / f"batch-{k}" / "evaluation.json").read_text()) for k in (0, 1)]
    assert result.batch is not None
    best = records[result.batch]
    assert best["score"] == max(record["score"] for record in records)
    assert (result.seed, result.epoch) == (best["seed"], best["epoch"])
    assert result.policy_path.read_bytes() == (folder / f"batch-{result.batch}" / "policy.onnx").read_bytes()
    assert json.loads((folder / "evaluation.json").read_text())["batch"] == result.batch
    assert result.evaluation["held_out"] == best["held_out"]
    assert f"of batch {result.batch} after" in "\n".join(result.lines())


def test_progress_is_of_the_whole_run(whole: tuple[TrainingResult, Lines]) -> None:
    progress = whole[1]
    assert progress.fractions == sorted(progress.fractions)
    assert all(0.0 <= fraction <= 1.0 for fraction in progress.fractions)
    assert [line[:8] for line in progress.lines] == ["batch 0:"] * 3 + ["batch 1:"] * 3


def test_workers_change_nothing_and_a_killed_run_goes_on(
    whole: tuple[TrainingResult, Lines], tmp_path: Path
) -> None:
    folder, options = tmp_path / "run", tmp_path / "options.yaml"
    options.write_text(OPTIONS.to_yaml(), encoding="utf-8")
    command = [
        sys.executable,
        "-m",
        "viatool",
        "train",
        "--config",
        str(options),
        "--batch",
        "2",
        "--workers",
        "2",
    ]
    process = subprocess.Popen([*command, "--output", str(folder), "--quiet"], start_new_session=True)
    while not any((folder / f"batch-{k}" / "state.pt").exists() for k in (0, 1)):
        assert process.poll() is None
        time.sleep(0.01)
    process.kill()
    process.wait()
    assert not (folder / "evaluation.json").exists()
    while workers_live(process.pid):
        time.sleep(0.1)
    result = resume_seeds(folder)  # whoever goes on with it
    assert content(folder) == content(whole[0].run_directory)
    assert (result.batch, result.seed) == (whole[0].batch, whole[0].seed)
    with pytest.raises(ConfigurationError, match="is finished"):
        resume_seeds(folder)


def workers_live(group: int) -> bool:
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True


def test_one_batch_is_the_run_that_it_always_was(tmp_path: Path) -> None:
    options = tiny(epochs=1, tensorboard=False)
    result = train_seeds(options, tmp_path / "seeds")
    assert result.batch is None
    assert content(result.run_directory) == content(train(options, tmp_path / "run").run_directory)


def test_a_used_folder_is_refused(whole: tuple[TrainingResult, Lines], tmp_path: Path) -> None:
    folder = whole[0].run_directory
    for again in (train_seeds, train):
        with pytest.raises(ConfigurationError, match="holds an earlier run"):
            again(OPTIONS, folder)
    with pytest.raises(ConfigurationError, match="no training run"):
        resume_seeds(tmp_path)
    (tmp_path / "batches.yaml").write_text("batch: 2")
    with pytest.raises(ConfigurationError, match=r"batches\.yaml does not say what is trained"):
        resume_seeds(tmp_path)


def test_trainings_side_by_side_in_one_process_use_one_thread_each() -> None:
    from viatool.train.trainer import _reproducible_torch

    before = torch.get_num_threads()
    first, second = _reproducible_torch(), _reproducible_torch()
    first.__enter__()
    second.__enter__()
    first.__exit__(None, None, None)
    assert torch.get_num_threads() == 1
    second.__exit__(None, None, None)
    assert torch.get_num_threads() == before


def test_an_idle_worker_is_explained(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Idle(Processes):
        def run(self, *_: object) -> object:
            raise KeyboardInterrupt

    progress = Lines()
    with pytest.raises(KeyboardInterrupt):
        train_seeds(OPTIONS, tmp_path / "run", scheduler=Idle(2), progress=progress)
    assert progress.lines == ["1 of 2 workers have a batch of seeds, see --batch"]


def test_a_run_without_a_saved_state_says_that_it_begins_anew(tmp_path: Path) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(OPTIONS, tmp_path, interrupt)
    assert not holds_progress(tmp_path)
    progress = Lines()
    resume_seeds(tmp_path, progress=progress)
    assert "begins anew at epoch 1" in progress.lines[0]
    assert holds_progress(tmp_path)
