"""Many graphs attacked in worker processes, each of which may crash or hang without ending the run."""

from __future__ import annotations

import json
import multiprocessing
import signal
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

from tests.attack.graphs import random_graph
from tests.attack.strike import Effort, Finding, Outcome, strike_in_memory

SECONDS = 120.0
"""Longest processor time for one graph."""
HANG_SECONDS = 1800.0
"""Longest wait for one graph, on a machine that does other things as well."""


class TooSlow(BaseException):
    """One graph took longer than `SECONDS`; no `except Exception` may swallow it."""


def attacked(number: int, seed: int, effort: Effort, seconds: float = SECONDS) -> dict[str, Any]:
    """Attack one graph within its time; return what came of it, as JSON has it."""

    def give_up(*_: object) -> None:
        raise TooSlow

    graph = random_graph(number, seed)
    previous = signal.signal(signal.SIGPROF, give_up)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        outcome = strike_in_memory(graph, effort)
    except TooSlow:
        outcome = Outcome(
            number, "slow", findings=[Finding("slow", f"more than {seconds:g} s of processor time")]
        )
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, previous)
    return outcome.as_dict()


def _work(first: int, step: int, seed: int, effort: Effort, done: frozenset[int], sender: Connection) -> None:
    number = first
    with suppress(BrokenPipeError):  # the campaign has enough
        while True:
            if number not in done:
                sender.send(number)
                sender.send(attacked(number, seed, effort))
            number += step


@dataclass(eq=False)
class _Worker:
    """A process for every `step`-th graph."""

    first: int
    step: int
    process: Any = None
    receiver: Connection | None = None
    current: int | None = None
    since: float = 0.0


@dataclass(eq=False)
class Campaign:
    """A run over graphs 0, 1, ... until enough have been attacked.

    Parameters
    ----------
    seed : int
        Of all graphs.
    effort : Effort
        For each.
    graphs : int
        How many are to be attacked; those that are refused do not count.
    workers : int
        Processes.
    journal : Path
        One line of JSON for each graph; what it holds already is not done again.
    """

    seed: int
    effort: Effort
    graphs: int
    workers: int
    journal: Path
    _done: set[int] = field(default_factory=set)

    def run(self) -> Iterator[dict[str, Any]]:
        """Yield what came of each graph, those of the journal first."""
        enough = 0
        for outcome in self._stored():
            self._done.add(outcome["number"])
            enough += outcome["ended"] == "attacked"
            yield outcome
        if enough >= self.graphs:
            return
        workers = [_Worker(first, self.workers) for first in range(self.workers)]
        try:
            for worker in workers:
                self._start(worker)
            with self.journal.open("a") as journal:
                for outcome in self._received(workers):
                    journal.write(json.dumps(outcome) + "\n")
                    journal.flush()
                    yield outcome
                    enough += outcome["ended"] == "attacked"
                    if enough >= self.graphs:
                        return
        finally:
            for worker in workers:
                worker.process.kill()
                worker.process.join()

    def _stored(self) -> list[dict[str, Any]]:
        if not self.journal.exists():
            return []
        lines = self.journal.read_text().splitlines()
        return [json.loads(line) for line in lines if line.endswith("}")]

    def _start(self, worker: _Worker) -> None:
        context = multiprocessing.get_context("forkserver")
        worker.receiver, sender = context.Pipe(duplex=False)
        worker.process = context.Process(
            target=_work,
            args=(worker.first, worker.step, self.seed, self.effort, frozenset(self._done), sender),
            daemon=True,
        )
        worker.process.start()
        sender.close()
        worker.current, worker.since = None, time.monotonic()

    def _received(self, workers: list[_Worker]) -> Iterator[dict[str, Any]]:
        while True:
            ready = wait([w.receiver for w in workers if w.receiver is not None], timeout=10.0)
            for worker in workers:
                if worker.receiver in ready:
                    try:
                        message = worker.receiver.recv()  # type: ignore[union-attr]
                    except EOFError:
                        yield self._lost(worker, "crash")
                        continue
                    worker.since = time.monotonic()
                    if isinstance(message, int):
                        worker.current = message
                    else:
                        self._done.add(message["number"])
                        yield message
                elif time.monotonic() - worker.since > HANG_SECONDS:
                    worker.process.kill()
                    yield self._lost(worker, "hang")

    def _lost(self, worker: _Worker, kind: str) -> dict[str, Any]:
        """Note the graph on which a worker ended, and start another behind it."""
        worker.process.join()
        assert worker.current is not None, "a worker cannot start"
        number = worker.current
        self._done.add(number)
        detail = f"the process ended with code {worker.process.exitcode}"
        self._start(worker)
        return Outcome(number, kind, findings=[Finding(kind, detail)]).as_dict()
