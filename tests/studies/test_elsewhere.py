"""A study ends in the same records whoever does its tasks, and whatever happens to them."""

from __future__ import annotations

import json
import signal
from collections.abc import Callable, Sequence
from pathlib import Path

import psutil
import pytest

from tests.schedule.local_cluster import LocalCluster, wait_for
from tests.studies.test_training import TINY
from viatool.schedule import Cluster, Message, Processes, Scheduler, Serial
from viatool.studies.progress import Board
from viatool.studies.runner import run_tasks
from viatool.studies.study import Options
from viatool.studies.tasks import Task, record_path
from viatool.studies.training import EvaluateSeed, TrainVariant, policy_path
from viatool.studies.variants import LAB, TD3, VIA

OPTIONS = Options(settings=(*TINY, "epochs=4", "epoch_steps=30"), seeds=2, scenarios=6)


@pytest.fixture(scope="module")
def tasks() -> Sequence[Task]:
    trainings = [TrainVariant.of(LAB, variant, OPTIONS) for variant in (TD3, VIA)]
    return [*trainings, EvaluateSeed(trainings[1], 1, 6, 0.01)]


@pytest.fixture(scope="module")
def whole(tasks: Sequence[Task], tmp_path_factory: pytest.TempPathFactory) -> Path:
    output = tmp_path_factory.mktemp("whole")
    run_tasks(tasks, output, Board(), scheduler=Serial())
    return output


class Accident(Board):
    """Does something when a training is under way."""

    def __init__(self, happens: Callable[[], None]) -> None:
        super().__init__()
        self.happens, self.happened, self.seen = happens, False, set[str]()

    def put(self, task: str, message: Message) -> None:
        self.seen.add(task)
        if task.endswith("train") and not self.happened:
            self.happened = True
            self.happens()


def assert_same(
    scheduler: Scheduler, board: Accident, tasks: Sequence[Task], whole: Path, output: Path
) -> None:
    run_tasks(tasks, output, board, scheduler=scheduler)
    assert board.happened
    assert board.seen == {task.name for task in tasks}
    for task in tasks:
        found, expected = (
            json.loads(record_path(folder, task.name).read_text(encoding="utf-8"))["result"]
            for folder in (output, whole)
        )
        assert found == expected
    one, other = (policy_path(folder, f"lab/{VIA.name}", 1) for folder in (output, whole))
    assert one.read_bytes() == other.read_bytes()
    assert files(output / "lab") == files(whole / "lab")


def files(folder: Path) -> list[str]:
    """Return the names of all files but the drafts that a kill may leave."""
    found = (path for path in folder.rglob("*") if not path.name.startswith("."))
    return sorted(path.relative_to(folder).as_posix() for path in found)


@pytest.mark.slow
def test_processes_of_which_one_is_killed(tasks: Sequence[Task], whole: Path, tmp_path: Path) -> None:
    def kill() -> None:
        wait_for(lambda: any(tmp_path.rglob("*.pt")))  # there is something to go on from
        workers = [p for p in psutil.Process().children() if "popen_loky" in " ".join(p.cmdline())]
        workers[0].send_signal(signal.SIGKILL)

    assert_same(Processes(2), Accident(kill), tasks, whole, tmp_path)


@pytest.mark.slow
def test_a_cluster_of_which_a_worker_is_killed_and_that_sees_no_files_of_this_machine(
    tasks: Sequence[Task], whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("viatool.schedule.folder._mark", lambda folder: "a mark that is nowhere")
    (tmp_path / "cluster").mkdir()
    with LocalCluster(tmp_path / "cluster", workers=2) as cluster:
        assert_same(
            Cluster(cluster.address), Accident(cluster.workers[0].kill), tasks, whole, tmp_path / "output"
        )
