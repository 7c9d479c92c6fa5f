"""What ends a chunk for good ends the command with code 3 and one message that names it; what is done is kept."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner

from tests.hall import MAP, write_policy
from viatool.cli import main
from viatool.safety.pieces import judge_pieces
from viatool.schedule import Processes
from viatool.verification import examination

ROOT = Path(__file__).resolve().parents[2]
VERIFY = (
    "verify",
    "policies/via.onnx",
    "--map",
    "maps/lab.yaml",
    "--eps",
    "0.01",
    "--only-contested",
    "--seed",
    "4",
)
POSES = ("--poses", "random:2000")  # two blocks

DEADLY = """
import os, signal
from viatool.verification.examination import StateExamination
examine = StateExamination.examine
def deadly(self, block):
    if block.first == 1024:
        os.kill(os.getpid(), signal.SIGKILL)
    return examine(self, block)
StateExamination.examine = deadly
"""


def assert_explained(code: int, error: str, *words: str) -> None:
    assert code == 3
    lines = [line for line in error.splitlines() if not line.startswith("states: ")]
    assert len(lines) == 2
    assert lines[0].startswith("error: states 1,024 to 1,999: ")
    assert lines[1].startswith("hint: ")
    for word in words:
        assert word in lines[0]


@pytest.mark.parametrize(
    ("command", "job", "words"),
    [
        (
            ["train", "--workers", "2"],
            "viatool.train.train_seeds",
            "nothing is saved yet in '{0}'; --resume {0} begins anew",
        ),
        (
            ["reproduce", "table2", "--workers", "2"],
            "viatool.studies.reproduction.reproduce",
            "finished tasks and begun trainings are kept in '{0}'; continue with the same command",
        ),
    ],
    ids=["train", "reproduce"],
)
def test_who_interrupts_is_told_how_to_go_on(
    command: list[str], job: str, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: object, scheduler: object, **__: object) -> None:
        assert isinstance(scheduler, Processes)
        raise KeyboardInterrupt

    monkeypatch.setattr(job, interrupted)
    run = CliRunner().invoke(main, [*command, "--output", str(tmp_path)])
    assert (run.exit_code, run.stdout) == (130, "")
    assert words.format(tmp_path) in run.stderr.splitlines()


@pytest.mark.parametrize(
    ("accident", "words"),
    [
        (ZeroDivisionError("by zero"), ["internal error: ZeroDivisionError: by zero"]),
        (MemoryError(), ["out of memory"]),
    ],
    ids=["defect", "memory"],
)
def test_a_chunk_that_fails_is_named_and_the_others_are_kept(
    accident: Exception, words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    blocks = []

    def fail(case: object, *arguments: object) -> object:
        blocks.append(case)
        if len(blocks) == 2:
            raise accident
        return judge_pieces(case, *arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(examination, "judge_pieces", fail)
    checkpoint = ("--checkpoint", str(tmp_path / "run"))
    run = CliRunner().invoke(main, [*VERIFY, *POSES, *checkpoint])
    assert_explained(run.exit_code, run.stderr, *words)
    assert [path.name for path in (tmp_path / "run").glob("units-*")] == ["units-00000000-00000001.npz"]
    monkeypatch.setattr(examination, "judge_pieces", judge_pieces)
    reports = [tmp_path / "resumed.json", tmp_path / "whole.json"]
    for report, more in zip(reports, ((*checkpoint, "--resume"), ()), strict=True):
        done = CliRunner().invoke(main, [*VERIFY, *POSES, *more, "--quiet", "--output", f"json:{report}"])
        assert done.exit_code == 0, done.output
    resumed, whole = (json.loads(report.read_text(encoding="utf-8")) for report in reports)
    assert resumed | {"seconds": 0} == whole | {"seconds": 0}


def test_a_chunk_that_kills_every_worker_is_named(tmp_path: Path) -> None:
    """As when the system ends a process because memory ran out."""
    (tmp_path / "sitecustomize.py").write_text(DEADLY, encoding="utf-8")
    command = [
        sys.executable,
        "-m",
        "viatool",
        *VERIFY,
        *POSES,
        "--workers",
        "2",
        "--checkpoint",
        str(tmp_path / "run"),
    ]
    path = os.pathsep.join((str(tmp_path), str(ROOT)))
    run = subprocess.run(
        command, cwd=ROOT, env={**os.environ, "PYTHONPATH": path}, capture_output=True, text=True, check=False
    )
    assert run.stdout == "", run.stderr
    assert_explained(run.returncode, run.stderr, "the worker process died", "memory ran out")
    kept = {path.name for path in (tmp_path / "run").glob("units-*")}
    assert "units-00000000-00000001.npz" in kept  # though its worker died as well
    assert "units-00000001-00000002.npz" not in kept


def test_an_interrupted_mission_leaves_what_it_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from viatool.missions.work import MissionExamination

    write_policy(tmp_path / "policy.onnx")
    (tmp_path / "map.yaml").write_text(MAP, encoding="utf-8")
    examine, asked = MissionExamination.examine, []

    def interrupted(self: MissionExamination, scenario: object) -> object:
        asked.append(scenario)
        if len(asked) == 2:
            raise KeyboardInterrupt
        return examine(self, scenario)  # type: ignore[arg-type]

    monkeypatch.setattr(MissionExamination, "examine", interrupted)
    report = tmp_path / "missions.json"
    words = [
        "mission",
        tmp_path / "policy.onnx",
        "--map",
        tmp_path / "map.yaml",
        "--eps",
        "0",
        "--time-limit",
        "1",
    ]
    run = CliRunner().invoke(main, [*map(str, words), "-o", f"json:{report}"])
    assert run.exit_code == 130, run.output
    assert run.stderr.endswith("interrupted\n")
    assert "the run was interrupted before it was done" in " ".join(run.stdout.split())
    done, left = json.loads(report.read_text())["missions"]
    assert done["driven"] > 0
    assert (left["verdict"], left["driven"]) == ("unknown", 0)
    asked.clear()
    asked.append(None)  # now the first one is interrupted, and nothing is known
    report.unlink()
    run = CliRunner().invoke(main, [*map(str, words), "-o", f"json:{report}"])
    assert (run.exit_code, run.stdout) == (130, "")
    assert not report.exists()


def test_who_interrupts_a_training_with_a_saved_state_can_go_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: object, **__: object) -> None:
        (tmp_path / "batch-1").mkdir()
        (tmp_path / "batch-1" / "state.pt").touch()
        raise KeyboardInterrupt

    monkeypatch.setattr("viatool.train.train_seeds", interrupted)
    run = CliRunner().invoke(main, ["train", "--output", str(tmp_path)])
    assert f"what is trained is kept in '{tmp_path}'; continue with --resume {tmp_path}" in run.stderr


def test_a_training_that_goes_on_refuses_options_of_a_new_one(tmp_path: Path) -> None:
    asked = ("--preset", "quick", "--set", "epochs=3", "--map", "lab", "--workers", "2", "--quiet")
    run = CliRunner().invoke(main, ["train", "--resume", str(tmp_path), *asked])
    assert run.exit_code == 2
    assert "error: --preset, --set, --map: a run that goes on" in run.stderr


@pytest.mark.skipif(os.name == "nt", reason="pipes of POSIX")
@pytest.mark.parametrize("command", [["inspect", "via"], ["--help"], ["train", "--help"]])
def test_a_closed_pipe_is_no_failed_gate(command: list[str]) -> None:
    read, write = os.pipe()
    os.close(read)
    try:
        run = subprocess.run(
            [sys.executable, "-m", "viatool", *command], stdout=write, stderr=subprocess.PIPE, text=True
        )
    finally:
        os.close(write)
    assert (run.returncode, run.stderr) == (141, "")
