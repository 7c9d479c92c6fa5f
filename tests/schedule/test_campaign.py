"""The driver of long work: budgets that are kept, what counts when the time is up, and what a checkpoint keeps."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.schedule.local_cluster import LocalCluster
from tests.schedule.work import SinceBegun, Sleep
from viatool.errors import ConfigurationError
from viatool.schedule import (
    NEVER,
    Campaign,
    Cluster,
    Deadline,
    Processes,
    Serial,
    Span,
    TimeUp,
    Work,
    check_time,
    within,
)


class Plain(Serial):
    """Does nothing but the work, in no time of its own."""

    def run(self, work, pieces, told=None):
        for piece in pieces:
            yield piece, work(piece.content)


class Hands:
    """A clock that only work moves."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now

    def spend(self, durations: Sequence[float]) -> Sequence[float]:
        """Take the time of every unit in four steps, as work that checks the time does."""
        for seconds in durations:
            for _ in range(4):
                check_time()
                self.now += seconds / 4.0
        return durations


@dataclass(frozen=True, eq=False)
class Units(Work[Any, Any]):
    """Units that are numbers, of which the function returns as many, in pieces of 64."""

    numbers: Sequence[float]
    does: Callable[[Sequence[float]], Sequence[float]] = list
    most: int = 64
    stage = "units"

    @property
    def function(self) -> Callable[[Any], Any]:
        return self.does

    def __len__(self) -> int:
        return len(self.numbers)

    def content(self, span: Span) -> Sequence[float]:
        return self.numbers[span.first : span.last]

    def at_once(self, workers: int) -> int:
        return self.most

    def whole(self, span: Span) -> bool:
        return span.first % self.most == 0 and span.last == min(span.first + self.most, len(self))

    def describe(self) -> Mapping[str, Any]:
        return {"units": len(self)}

    def to_arrays(self, part: Any) -> Mapping[str, Any]:
        return {"numbers": np.array(part)}

    def from_arrays(self, arrays: Mapping[str, Any]) -> Any:
        return arrays["numbers"].tolist()

    def join(self, parts: Sequence[Any]) -> Any:
        return [number for part in parts for number in part]


@settings(deadline=None, max_examples=40)
@given(
    unit=st.floats(1e-4, 0.05),
    spread=st.floats(0.0, 4.0),
    budget=st.floats(1.0, 500.0),
    most=st.sampled_from([1, 64, 512]),
    seed=st.integers(0, 99),
)
def test_a_budget_is_kept_within_a_fifth(unit, spread, budget, most, seed):
    """Whatever units take, as long as one takes no more than a twentieth of it."""
    count = min(3_000, int(2 * budget / unit))
    seconds = unit * np.exp(spread * np.random.default_rng(seed).normal(size=count))
    seconds = np.minimum(seconds, budget / 20.0)
    clock = Hands()
    found = Campaign(Plain()).carry_out(
        Units(seconds.tolist(), clock.spend, most), until=Deadline.after(budget, clock)
    )
    taken = clock.now - 100.0
    assert found.part == seconds[: found.units].tolist()
    assert taken <= 1.2 * budget
    assert taken >= 0.8 * budget or found.units == count


def test_without_a_budget_pieces_are_as_large_as_ever():
    sizes: list[int] = []
    work = Units(list(range(150)), lambda units: sizes.append(len(units)) or units)
    found = Campaign().carry_out(work)
    assert (found.units, sizes) == (150, [64, 64, 22])
    Campaign(chunk=10).carry_out(work)  # which would change what is found
    assert sizes[3:] == sizes[:3]


def test_units_that_take_long_count_as_often_as_others():
    """The sums over what counts are those of a fair sample: the last piece is finished, not cut off."""
    clock, generator = Hands(), np.random.default_rng(0)
    surplus, cut = [], []
    for _ in range(3000):
        slow = generator.random(600) < 0.1
        seconds = np.where(slow, 0.02, 0.001)
        until = Deadline.after(0.4, clock)
        found = Campaign(Plain()).carry_out(Units(seconds.tolist(), clock.spend), until=until)
        surplus.append(slow[: found.units].sum() - 0.1 * found.units)
        ended = np.searchsorted(np.cumsum(seconds), 0.4)  # what a hard end at the deadline would leave
        cut.append(slow[:ended].sum() - 0.1 * ended)
    error = np.std(surplus) / np.sqrt(len(surplus))
    assert abs(np.mean(surplus)) < 3.0 * error
    assert np.mean(cut) < -5.0 * error  # so the test can tell


def test_what_is_cut_off_does_not_count_nor_anything_after_it():
    clock = Hands()
    seconds = [*[0.01] * 20, 100.0, *[0.01] * 500]
    found = Campaign().carry_out(Units(seconds, clock.spend), until=Deadline.after(1.0, clock))
    assert 0 < found.units <= 20
    assert clock.now - 100.0 < 30.0  # a step of that unit


class Backwards(Serial):
    """Gives out the answers of pieces in the wrong order."""

    def run(self, work, pieces, told=None):
        yield from reversed(list(super().run(work, [piece for piece in pieces if piece is not None])))


def test_enough_is_said_of_the_first_pieces_alone():
    """So what is found does not depend on the order in which pieces are done."""
    work = Units(list(range(1000)))
    enough = lambda parts: sum(map(len, parts)) >= 100  # noqa: E731
    found = [Campaign(each).carry_out(work, enough=enough) for each in (Serial(), Backwards())]
    assert found[0] == found[1]
    assert found[0].units == 128


def test_only_pieces_that_are_the_same_in_every_run_are_kept(tmp_path):
    clock = Hands()
    seconds = [0.01] * 1000
    work = Units(seconds, clock.spend)
    first = Campaign(checkpoint=tmp_path).carry_out(work, until=Deadline.after(5.0, clock))
    assert 400 < first.units < 600
    spans = {path.name for path in tmp_path.glob("units-*")}
    assert "units-00000128-00000192.npz" in spans
    assert all(int(name[6:14]) % 64 == 0 and int(name[15:23]) % 64 == 0 for name in spans)
    again: list[int] = []
    rest = Units(seconds, lambda units: again.append(len(units)) or units)
    whole = Campaign(checkpoint=tmp_path, resume=True).carry_out(rest)
    assert (whole.part, whole.units) == (seconds, 1000)
    assert sum(again) == 1000 - 64 * len(spans)


def test_a_deadline_travels_to_other_processes():
    there = pickle.loads(pickle.dumps(Deadline.after(5.0)))
    assert there.left == pytest.approx(5.0, abs=0.5)
    assert there.moved(0.1).left == pytest.approx(5.5, abs=0.5)
    assert pickle.loads(pickle.dumps(NEVER)).left == np.inf
    with within(Deadline.after(0.0)), pytest.raises(TimeUp):
        check_time()
    check_time()


def test_workers_stop_in_time(tmp_path):
    clock = SinceBegun(tmp_path / "begun")
    found = Campaign(Processes(2)).carry_out(
        Units(list(range(100_000)), Sleep(0.01, clock)), until=Deadline.after(3.0, clock)
    )
    assert 0 < found.units < 3000
    assert found.part == list(range(found.units))


def test_a_cluster_stops_in_time(tmp_path):
    clock = SinceBegun(tmp_path / "begun")
    with LocalCluster(tmp_path, workers=2) as cluster:
        found = Campaign(Cluster(cluster.address)).carry_out(
            Units(list(range(100_000)), Sleep(0.01, clock)), until=Deadline.after(3.0, clock)
        )
    assert 0 < found.units < 3000
    assert found.part == list(range(found.units))


def test_nothing_is_resumed_without_a_checkpoint():
    with pytest.raises(ConfigurationError, match="nothing is there to resume from"):
        Campaign(resume=True)
