"""``viatool reproduce``: a whole study with trainings of a second."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from viatool.cli import main

TINY = {
    "epoch_steps": 20,
    "robots": 8,
    "updates_per_step": 1,
    "warmup_episodes": 4,
    "learning_starts": 64,
    "batch_size": 16,
    "critic_hidden": "[8]",
    "replay_capacity": 300,
    "horizon": 20,
    "evaluation_interval": 1,
    "evaluation_start": 0,
    "validation_scenarios": 4,
    "test_scenarios": 2,
}


def reproduce(output: Path, *arguments: str) -> Result:
    settings = [word for name, value in TINY.items() for word in ("--set", f"{name}={value}")]
    fixed = ["--seeds", "2", "--epochs", "1", "--scenarios", "5", "--output", str(output)]
    return CliRunner().invoke(main, ["reproduce", *arguments, *fixed, *settings])


def test_a_study_is_run_once_and_its_page_rendered_again(tmp_path: Path) -> None:
    run = reproduce(tmp_path / "runs", "table2", "--results", str(tmp_path / "results"))
    assert run.exit_code == 0, run.output
    assert run.stdout.splitlines() == [str(tmp_path / "results" / "table2.md")]
    assert "[9/9]" in run.stderr
    page = (tmp_path / "results" / "table2.md").read_bytes()
    assert b"Partial" not in page
    data = json.loads((tmp_path / "results" / "data" / "table2.json").read_text())
    assert list(data["variants"]) == ["via-0.1", "via-0.5", "via-0.9"]
    assert data["configuration"]["cost_limit"] == 10
    assert all(len(found["values"]["cost"]) == 2 for found in data["variants"].values())
    again = reproduce(tmp_path / "runs", "table2", "--results", str(tmp_path / "results"))
    assert again.stderr.splitlines() == ["9 of 9 tasks are finished already"]
    (tmp_path / "results" / "table2.md").unlink()
    only = CliRunner().invoke(
        main, ["reproduce", "table2", "--render-only", "--results", str(tmp_path / "results")]
    )
    assert only.exit_code == 0, only.output
    assert (tmp_path / "results" / "table2.md").read_bytes() == page


def test_other_settings_in_the_same_folder_are_refused(tmp_path: Path) -> None:
    record = tmp_path / "lab" / "via-0.1" / "train.json"
    record.parent.mkdir(parents=True)
    content = {"task": "", "parameters": {"epochs": 99}, "result": {}, "seconds": 1, "finished": ""}
    record.write_text(json.dumps(content))
    run = reproduce(tmp_path, "table2")
    assert run.exit_code == 2
    assert "epochs 99, not 1" in run.stderr
    assert "choose another --output" in run.stderr


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["table9"], "table9"),
        ([], "STUDY"),
        (["table1", "--preset", "none", "--output", "x"], "there is no preset 'none'"),
        (["table1", "--render-only", "--output", "nowhere"], "run viatool reproduce table1 first"),
    ],
)
def test_what_cannot_be_run_is_explained(arguments: list[str], message: str) -> None:
    run = CliRunner().invoke(main, ["reproduce", *arguments])
    assert run.exit_code == 2
    assert message in run.stderr
