"""Tasks are done once, go on after an interruption, and never mix with other settings."""

from __future__ import annotations

import io
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.studies.small import Count
from viatool.errors import ConfigurationError, ViatoolError
from viatool.schedule import Message, open_scheduler
from viatool.studies.progress import Board, Lines, open_board
from viatool.studies.runner import find_records, run_tasks
from viatool.studies.tasks import record_path

ROOT = Path(__file__).resolve().parents[2]


def attempts(output: Path) -> list[str]:
    return (output / "log").read_text(encoding="utf-8").split()


def test_a_finished_task_is_not_done_again(tmp_path: Path) -> None:
    first = run_tasks([Count("a")], tmp_path, Board())
    second = run_tasks([Count("a"), Count("b")], tmp_path, Board())
    assert attempts(tmp_path) == ["a", "b"]
    assert first["small/a"] == second["small/a"]
    assert second["small/b"].result == {"sum": 6}


@pytest.mark.parametrize("content", ["", "{", "[]", '{"task": "small/a"}', "null", "\x00"])
def test_a_damaged_record_is_made_anew(tmp_path: Path, content: str) -> None:
    whole = run_tasks([Count("a")], tmp_path, Board())
    record_path(tmp_path, "small/a").write_text(content)
    assert run_tasks([Count("a")], tmp_path, Board())["small/a"].result == whole["small/a"].result
    assert attempts(tmp_path) == ["a", "a"]


def test_a_record_of_other_settings_is_refused_and_kept(tmp_path: Path) -> None:
    run_tasks([Count("a")], tmp_path, Board())
    with pytest.raises(ConfigurationError, match="upto 3, not 4"):
        run_tasks([Count("a", 4)], tmp_path, Board())
    assert find_records([Count("a")], tmp_path)["small/a"].result == {"sum": 6}


@pytest.mark.parametrize("workers", [1, 2])
def test_a_failure_stops_only_what_needs_it(tmp_path: Path, workers: int) -> None:
    tasks = [
        Count("bad", fails=True),
        Count("child", needed=("small/bad",)),
        Count("grandchild", needed=("small/child",)),
        Count("good"),
        Count("heir", needed=("small/good",)),
    ]
    with pytest.raises(ViatoolError, match=r"1 task\(s\) failed and 3 remain .*small/bad: it does not work"):
        run_tasks(tasks, tmp_path, Board(), scheduler=open_scheduler(workers))
    assert sorted(find_records(tasks, tmp_path)) == ["small/good", "small/heir"]
    assert sorted(attempts(tmp_path)) == ["bad", "good", "heir"]


def test_tasks_wait_for_what_they_need_and_records_are_told_as_they_come(tmp_path: Path) -> None:
    seen: list[list[str]] = []
    tasks = [Count("b", needed=("small/a",)), Count("a")]
    run_tasks(tasks, tmp_path, Board(), finished=lambda records: seen.append(list(records)))
    assert seen == [[], ["small/a"], ["small/a", "small/b"]]


def test_only_one_process_works_in_a_folder(tmp_path: Path) -> None:
    def again(records: object) -> None:
        with pytest.raises(ConfigurationError, match="another viatool is working in"):
            run_tasks([Count("b")], tmp_path, Board())

    run_tasks([Count("a")], tmp_path, Board(), finished=again)
    assert attempts(tmp_path) == ["a"]


PROGRAM = """
import sys
from pathlib import Path
from tests.studies.small import Count
from viatool.schedule import open_scheduler
from viatool.studies.progress import Board
from viatool.studies.runner import run_tasks
if __name__ == "__main__":
    tasks = [Count("a"), Count("slow", 400, seconds=0.02), Count("b")]
    run_tasks(tasks, Path(sys.argv[1]), Board(), scheduler=open_scheduler(int(sys.argv[2])))
"""


@pytest.mark.parametrize("workers", [1, 2])
def test_after_a_kill_the_same_tasks_end_in_the_same_records(tmp_path: Path, workers: int) -> None:
    output, script = tmp_path / "output", tmp_path / "program.py"
    script.write_text(PROGRAM, encoding="utf-8")
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    process = subprocess.Popen([sys.executable, script, str(output), str(workers)], env=environment)
    state = output / "small" / "slow" / "state"
    wait_for(state.exists)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    reached = wait_until_still(state)  # a worker ends with its parent
    assert 0 < reached < 400
    tasks = [Count("a"), Count("slow", 400), Count("b")]
    records = run_tasks(tasks, output, Board())
    assert [record.result["sum"] for record in records.values()] == [6, 80_200, 6]
    assert attempts(output).count("a") == 1
    assert attempts(output).count("slow") == 2


def wait_for(happened: object, seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    assert callable(happened)
    while not happened():
        assert time.monotonic() < end, "it did not happen in time"
        time.sleep(0.02)


def wait_until_still(state: Path) -> int:
    last = -1
    while (now := int(state.read_text())) != last:
        last = now
        time.sleep(1.5)  # a worker looks for its parent every second
    return last


def test_records_are_plain_json_with_all_that_a_result_depends_on(tmp_path: Path) -> None:
    run_tasks([Count("a")], tmp_path, Board())
    content = json.loads(record_path(tmp_path, "small/a").read_text(encoding="utf-8"))
    assert content["task"] == "small/a"
    assert content["parameters"] == {"upto": 3, "fails": False}
    assert content["result"] == {"sum": 6}
    assert len(content["finished"]) == len("2026-11-25")


def test_the_time_left_follows_the_work_that_is_done(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = [0.0]
    monkeypatch.setattr(time, "monotonic", lambda: clock[0])
    board = Board()
    board.begin([Count("a"), Count("b"), Count("c"), Count("d")], 5)
    assert board.time_left() == ""
    clock[0] = 60.0
    board.put("small/a", Message("", 0.5, 1.0))
    assert board.fraction() == pytest.approx(0.125)
    assert board.time_left() == ", about 7 min left"


def test_a_pipe_gets_a_line_for_each_finished_task(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from rich.console import Console

    run_tasks([Count("a"), Count("b")], tmp_path, Lines(Console(width=100)))
    lines = capsys.readouterr().out.splitlines()
    assert [line.partition(":")[0] for line in lines] == ["[1/2] small/a", "[2/2] small/b"]


def test_a_terminal_gets_bars_with_the_time_left(tmp_path: Path) -> None:
    from rich.console import Console

    screen = io.StringIO()
    with open_board(Console(file=screen, force_terminal=True, width=120, highlight=False)) as board:
        run_tasks([Count("a"), Count("b", 2, seconds=0.6)], tmp_path, board)
    shown = screen.getvalue()
    assert "[1/2] small/a" in shown
    assert "small/b at 1" in shown
    assert "of 2 tasks, about" in shown
