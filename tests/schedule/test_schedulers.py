"""Work in this process and in others: complete, in spite of dying workers, and with errors that name the piece."""

from __future__ import annotations

import os
import time

import pytest

from tests.schedule.work import Chain, QuickAtFirst, Square, in_order, pieces, report, squares, where
from viatool.errors import ConfigurationError, EnclosureError, ViatoolError, WorkError
from viatool.schedule import Piece, Processes, Serial, Span, open_scheduler
from viatool.schedule.parcel import checked

SCHEDULERS = [Serial(), Processes(2)]


@pytest.mark.parametrize("scheduler", SCHEDULERS, ids=["serial", "processes"])
class TestEveryScheduler:
    def test_every_piece_is_done_once(self, scheduler):
        assert in_order(scheduler.run(Square(), pieces(95))) == squares(100)

    def test_no_work_is_fine(self, scheduler):
        assert list(scheduler.run(Square(), [])) == []

    def test_an_error_of_the_work_keeps_its_kind_and_names_the_piece(self, scheduler):
        with pytest.raises(EnclosureError) as caught:
            in_order(scheduler.run(Square(35, "refuse"), pieces(60)))
        assert (caught.value.message, caught.value.hint) == ("numbers 30 to 39: no bounds", "smaller eps")

    def test_pieces_may_wait_for_answers(self, scheduler):
        chain = Chain(4)
        for _, (answer,) in scheduler.run(Square(), chain):
            chain.answers.append(answer)
        assert chain.answers == [2, 4, 16, 256, 65536]

    def test_what_a_piece_reports_is_told_before_its_answer(self, scheduler):
        told = []
        for piece, _ in scheduler.run(
            report, pieces(20), lambda piece, message: told.append((piece.name, message))
        ):
            first, second = [message for name, message in told if name == piece.name]
            assert (first.fraction, first.stage) == (0.1, f"at {piece.span.first}")
            assert (second.fraction, second.line) == (1.0, f"squared {piece.content}")

    @pytest.mark.parametrize(
        ("accident", "message"), [("crash", "ZeroDivisionError: by zero"), ("exhaust", "out of memory")]
    )
    def test_an_accident_names_the_piece(self, scheduler, accident, message):
        with pytest.raises(WorkError, match=rf"numbers 30 to 39: .*{message}"):
            in_order(scheduler.run(Square(35, accident), pieces(60)))


def test_workers_are_other_processes_with_one_thread_each(monkeypatch):
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    seen = set(in_order(Processes(2).run(where, pieces(200))))
    assert os.getpid() not in {process for process, _ in seen}
    assert {threads for _, threads in seen} == {"1"}


def test_a_killed_worker_costs_nothing_but_time(tmp_path):
    work = Square(35, "kill", str(tmp_path / "killed"))
    assert in_order(Processes(2).run(work, pieces(95))) == squares(100)
    assert (tmp_path / "killed").exists()


def test_a_piece_that_always_kills_is_named_and_the_others_are_done():
    done = []
    with pytest.raises(WorkError, match="numbers 30 to 39: the worker process died") as caught:
        done.extend(piece.span.first for piece, _ in Processes(2).run(Square(35, "kill"), pieces(50)))
    assert "memory" in caught.value.message
    assert 30 not in done


def test_leaving_early_ends_the_workers_at_once():
    run = Processes(1).run(QuickAtFirst(), pieces(200))
    next(run)
    started = time.monotonic()
    run.close()
    assert time.monotonic() - started < 45.0  # the piece at hand alone takes a minute


@pytest.mark.parametrize("workers", [0, -1, 1.5, "many"])
def test_no_workers_are_refused(workers):
    with pytest.raises(ConfigurationError):
        open_scheduler(workers)


def test_the_scheduler_fits_the_request():
    assert isinstance(open_scheduler(), Serial)
    assert open_scheduler(3).workers == 3
    assert open_scheduler("auto").workers >= 1


def _kinds(kind=ViatoolError):
    return [kind, *(each for below in kind.__subclasses__() for each in _kinds(below))]


@pytest.mark.parametrize("kind", _kinds(), ids=lambda kind: kind.__name__)
def test_every_kind_of_error_is_raised_again_with_the_name_of_its_piece(kind):
    with pytest.raises(kind, match=r"^states 1 to 5: it is crooked\nhint: bend it"):
        checked(Piece(Span(1, 5), "states 1 to 5", None), kind("it is crooked", "bend it"))
