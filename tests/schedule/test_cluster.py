"""Work on a real Dask cluster of separate processes: workers and the scheduler may die, and versions may differ."""

from __future__ import annotations

import time

import pytest

from tests.schedule.local_cluster import LocalCluster, wait_for
from tests.schedule.work import Chain, Endless, Square, in_order, pieces, report, squares
from viatool.errors import ConfigurationError, EnclosureError, WorkError
from viatool.schedule import Cluster, open_scheduler


@pytest.fixture(autouse=True)
def patience(monkeypatch):
    """Wait longer than a user would: tests share their machine."""
    monkeypatch.setattr("viatool.schedule.cluster._CONNECT_SECONDS", 120.0)
    monkeypatch.setattr("viatool.schedule.cluster._WORKER_SECONDS", 120.0)


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    with LocalCluster(tmp_path_factory.mktemp("cluster"), workers=2) as cluster:
        yield cluster


def test_every_piece_is_done_once(cluster):
    scheduler = open_scheduler(address=cluster.address)
    assert in_order(scheduler.run(Square(), pieces(295))) == squares(300)
    assert scheduler.workers == 2


def test_pieces_may_wait_for_answers_and_report_before_they_give_them(cluster):
    chain = Chain(3)
    for _, (answer,) in Cluster(cluster.address).run(Square(), chain):
        chain.answers.append(answer)
    assert chain.answers == [2, 4, 16, 256]
    told = []
    run = Cluster(cluster.address).run(report, pieces(20), lambda *news: told.append(news))
    assert in_order(run) == squares(20)
    assert {(piece.name, message.line) for piece, message in told} >= {
        (piece.name, f"squared {piece.content}") for piece in pieces(20)
    }


def test_work_that_nobody_waits_for_any_more_ends(cluster, tmp_path):
    sign = tmp_path / "sign"

    def leave(*_):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        list(Cluster(cluster.address).run(Endless(str(sign)), pieces(10), leave))

    def ended():
        before = sign.read_text()
        time.sleep(0.5)
        return sign.read_text() == before

    wait_for(ended, 20.0)
    assert int(sign.read_text()) < 1000


def test_a_scheduler_file_names_the_cluster_as_well(cluster):
    assert in_order(Cluster(str(cluster.file)).run(Square(), pieces(20))) == squares(20)


def test_an_error_of_the_work_keeps_its_kind_and_names_the_piece(cluster):
    with pytest.raises(EnclosureError, match="numbers 30 to 39: no bounds"):
        in_order(Cluster(cluster.address).run(Square(35, "refuse"), pieces(60)))


def test_an_accident_that_does_not_happen_again_is_tried_again(cluster, tmp_path):
    work = Square(35, "crash", str(tmp_path / "crashed"))
    assert in_order(Cluster(cluster.address).run(work, pieces(60))) == squares(60)
    assert (tmp_path / "crashed").exists()


def test_an_accident_that_does_names_the_piece(cluster):
    with pytest.raises(WorkError, match="numbers 30 to 39: internal error: ZeroDivisionError"):
        in_order(Cluster(cluster.address).run(Square(35, "crash"), pieces(60)))


def test_a_cluster_that_is_not_there_is_refused(monkeypatch):
    monkeypatch.setattr("viatool.schedule.cluster._CONNECT_SECONDS", 0.3)
    with pytest.raises(ConfigurationError, match=r"no Dask scheduler answers at tcp://127\.0\.0\.1:9"):
        open_scheduler(address="tcp://127.0.0.1:9")


def test_a_scheduler_file_that_does_not_come_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr("viatool.schedule.cluster._FILE_SECONDS", 0.3)
    with pytest.raises(
        ConfigurationError, match=r"no scheduler file '.*none\.json' has appeared within 0\.3 s"
    ):
        open_scheduler(address=str(tmp_path / "none.json"))


def test_a_cluster_without_workers_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("viatool.schedule.cluster._WORKER_SECONDS", 0.3)
    with (
        LocalCluster(tmp_path, workers=0) as cluster,
        pytest.raises(ConfigurationError, match="has no worker") as caught,
    ):
        open_scheduler(address=cluster.address)
    assert f"dask worker {cluster.address}" in caught.value.hint


def test_a_cluster_loses_a_worker_and_then_its_scheduler(tmp_path, monkeypatch):
    with LocalCluster(tmp_path, workers=2) as cluster:
        scheduler = Cluster(cluster.address)
        wait_for(lambda: scheduler.connect() is None and scheduler.workers == 2)
        run = scheduler.run(Square(seconds=0.1), pieces(400))
        first = next(run)
        cluster.workers[0].kill()
        assert in_order([first, *run]) == squares(400)
        assert scheduler.workers == 1

        with monkeypatch.context() as changed:
            changed.setattr("viatool.__version__", "99.0")
            with pytest.raises(
                ConfigurationError, match=r"tcp://.* of the cluster has viatool .* instead of 99\.0"
            ):
                open_scheduler(address=cluster.address)

        run = scheduler.run(Square(seconds=0.2), pieces(400))
        next(run)
        cluster.scheduler.kill()
        with pytest.raises(WorkError, match=r"the connection to the scheduler tcp://.* was lost") as caught:
            list(run)
        assert "--resume" in caught.value.hint
