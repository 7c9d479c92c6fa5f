"""`certify --arrive --finer N`: blocks of cells that are followed as one, and halved where they lead nearly home."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.benchmarks.forever import Arriving, Robots, drive_to_goal
from tests.places.test_arriving import (
    EPS,
    RADIUS,
    Looks,
    chamber,
    drive,
    homing,
)
from viatool.errors import ConfigurationError
from viatool.loop.closed_loop import ClosedLoop
from viatool.places import Campaign, Lookahead, Resolution, certify, over_time, passages
from viatool.places.blocks import Blocks
from viatool.places.forever import CellTransitions
from viatool.places.mesh import CellSet, Mesh, Ranges
from viatool.places.over_time import look_ahead
from viatool.places.passages import Passages
from viatool.schedule import NEVER, Deadline

__all__ = ["chamber"]  # a fixture
MESH = Mesh(np.zeros(5), np.ones(5), np.array([8, 4, 8, 1, 2]))


@pytest.fixture(scope="module")
def home(chamber, tmp_path_factory):
    policy = homing(tmp_path_factory.mktemp("policy") / "homing.onnx")
    return policy, certify(
        policy, chamber, eps=EPS, criterion="swept", resolution=Resolution(0.2),
        lookahead=Lookahead(arrive=True, goal_radius=RADIUS, intervals=4, finer=1),
    )  # fmt: skip


def again(home, campaign=None, until=NEVER, **changed):
    policy, certificate = home
    loop = ClosedLoop.of(policy, certificate.setting, certificate.scenario)
    return look_ahead(
        loop, certificate.lattice, certificate.findings, certificate.scenario.goal,
        replace(certificate.lasting.lookahead, **changed), campaign or Campaign(), until=until,
    )  # fmt: skip


def test_finer_cells_arrive_from_more_places_and_every_run_is_in_time(home, chamber):
    """4,000 runs by a simulator that shares no code; blocks that are not halved are larger than what the others are."""
    found = home[1].lasting
    coarse = again(home, finer=0)
    assert found.mesh.size[0] == coarse.mesh.size[0] / 2
    assert found.arriving.sum() * found.unit > 1.2 * coarse.arriving.sum() * coarse.unit
    assert not (found.arriving & ~found.for_ever).any()
    told = drive(home[0], chamber, found.cell_table())
    assert told["violations"] == told["late"] == 0


def half_is_enough(monkeypatch):
    """A range counts as covered of which half is."""
    monkeypatch.setattr(CellSet, "covers", lambda self, ranges: self.share(ranges) >= 0.5)


def a_cell_is_dropped(monkeypatch):
    """Ranges lack their last cell along each axis."""
    honest = Mesh.ranges

    def ranges(self, lower, upper):
        found = honest(self, lower, upper)
        return Ranges(found.first, np.maximum(found.first, found.last - 1))

    monkeypatch.setattr(Mesh, "ranges", ranges)


def unproved_intervals(monkeypatch):
    """Of blocks that are not certified the first interval counts as proved, and the others too."""
    monkeypatch.setattr(
        ClosedLoop, "holds", lambda self, cells, lower, upper: np.ones(len(cells), dtype=bool)
    )


def parts_are_dropped(monkeypatch):
    """Of the parts of a cell the first is followed in place of all."""
    honest = passages._cut

    def cut(lower, upper, parts):
        each, ends = int(np.prod(parts)), honest(lower, upper, parts)
        return tuple(np.repeat(end[::each], each, axis=0) for end in ends)

    monkeypatch.setattr(passages, "_cut", cut)


@pytest.mark.parametrize(
    "fault",
    [half_is_enough, a_cell_is_dropped, unproved_intervals, parts_are_dropped],
    ids=lambda one: one.__name__,
)
def test_planted_faults_are_seen_by_the_runs(home, chamber, fault, monkeypatch):
    fault(monkeypatch)
    told = drive(home[0], chamber, again(home).cell_table())
    assert told["late"] + told["violations"] > 0


def test_errors_that_are_left_out_are_seen_by_the_runs(home, chamber):
    """What is proved for errors of 0.01 does not hold for 0.5, and the runs show it."""
    robots = Robots(home[0], chamber, chamber.scenarios[0], 0.5, steps=3)
    cells = Arriving(home[1].lasting.cell_table())
    told = drive_to_goal(robots, cells, 1000, RADIUS, np.random.default_rng(0))
    assert told["late"] > 0


def test_work_that_is_kept_changes_nothing(home, tmp_path, monkeypatch):
    whole = home[1].lasting
    shared = again(home, Campaign(checkpoint=tmp_path / "kept"))
    monkeypatch.setattr(over_time, "follow", None)  # nothing is followed again
    resumed = again(home, Campaign(checkpoint=tmp_path / "kept", resume=True))
    for name in ("arrives", "moves", "intervals"):
        np.testing.assert_array_equal(getattr(shared, name), getattr(whole, name))
        np.testing.assert_array_equal(getattr(resumed, name), getattr(whole, name))


def test_what_was_not_followed_in_time_is_not_claimed(home, monkeypatch):
    monkeypatch.setattr(over_time.FollowWork, "piece", 100)
    whole = home[1].lasting
    for seconds in (60.0, 200.0):
        found = again(home, until=Deadline.after(seconds, Looks()))
        assert not (found.arriving & ~whole.arriving).any()
        assert found.arriving.sum() < whole.arriving.sum()


@pytest.mark.parametrize(("arrive", "finer"), [(True, 4), (True, -1), (False, 1)])
def test_what_cannot_be_asked_is_refused(arrive, finer):
    with pytest.raises(ConfigurationError, match="halved"):
        Lookahead(for_ever=True, arrive=arrive, finer=finer)


def test_blocks_are_cubes_of_cells_along_the_pose():
    blocks = Blocks.over(MESH, 4)
    assert len(blocks) == 2 * 1 * 2 * 2
    np.testing.assert_array_equal(np.sort(blocks.cells), np.arange(len(MESH)))
    index = np.stack(np.unravel_index(blocks.select([3]).cells, MESH.count))
    np.testing.assert_array_equal(np.ptp(index, axis=1), [3, 3, 3, 0, 0])
    lower, upper = blocks.bounds()
    np.testing.assert_array_equal(upper - lower, np.tile([4, 4, 4, 1, 1], (8, 1)))
    halves = blocks.halved()
    for block in range(8):
        some = halves.select(slice(8 * block, 8 * block + 8))
        np.testing.assert_array_equal(np.sort(some.cells), np.sort(blocks.select([block]).cells))
    mask = np.zeros(len(MESH), bool)
    mask[halves.select([5]).cells] = True
    np.testing.assert_array_equal(halves.every(mask), np.arange(64) == 5)
    assert not blocks.every(mask).any()


def random_blocks(seed):
    """Blocks of one cell and of eight with up to two parts, that drift along x; and what they consist of."""
    generator = np.random.default_rng(seed)
    mesh = Mesh(np.zeros(5), np.ones(5), np.array([16, 2, 4, 1, 1]))
    blocks = Blocks.over(mesh, 2)
    cut = generator.random(len(blocks)) < 0.4
    blocks = Blocks.join(blocks.select(~cut), blocks.select(cut).halved())
    side = np.ones(len(mesh), np.int8)
    side[blocks.first] = blocks.side
    exempt = np.arange(len(mesh)) // 8 >= 14
    exempt |= generator.random(len(mesh)) < 0.05
    rows = np.concatenate([np.arange(len(blocks)), generator.choice(len(blocks), 10)])
    rows = rows[~blocks.every(exempt)[rows]]
    first = np.stack(np.unravel_index(blocks.first[rows], mesh.count), axis=1)
    ranges, leads = [], []
    for _ in range(2):
        first = first + generator.integers(0, 2, first.shape) * [2, 0, 0, 0, 0]
        last = first + (blocks.side[rows] - 1)[:, None] * [1, 1, 1, 0, 0]
        ends = [np.minimum(end, mesh.count - 1) for end in (first, last)]
        ranges.append(Ranges(*(end.astype(np.int16) for end in ends)))
        leads.append(ends)
    kept = generator.integers(0, 3, len(rows)).astype(np.int16)
    passages = Passages(blocks.first[rows], ranges, kept, np.minimum(kept, 1))
    return CellTransitions(mesh, exempt, passages, side), blocks, rows, leads


def by_definition(loops, blocks, rows, leads):
    """How many intervals each cell takes to arrive, by sets of numbers."""
    count, kept = loops.mesh.count, loops.passages.kept
    members = [{int(cell) for cell in blocks.select([block]).cells} for block in range(len(blocks))]

    def numbers(low, high):
        return {int(np.ravel_multi_index(tuple(low + more), count)) for more in np.ndindex(*(high - low + 1))}

    lies = [[numbers(low[row], high[row]) for low, high in leads] for row in range(len(rows))]
    within, found = [{int(cell) for cell in np.flatnonzero(loops.exempt)}], {}
    for number in range(1, 60):
        there = [
            any(i < min(kept[row], number) and lies[row][i] <= within[number - 1 - i] for i in range(2))
            for row in range(len(rows))
        ]
        all_there = [
            block
            for block in set(rows.tolist())
            if all(there[row] for row in range(len(rows)) if rows[row] == block)
        ]
        new = set().union(*(members[block] for block in all_there)) - within[-1]
        found |= dict.fromkeys(new, number)
        within.append(within[-1] | new)
    return found


def test_sets_of_random_blocks_are_those_of_their_definition():
    several = 0
    for seed in range(12):
        loops, *known = random_blocks(seed)
        arrives, expected = loops.arrival(), by_definition(loops, *known)
        assert {int(cell): int(arrives[cell]) for cell in np.flatnonzero(arrives)} == expected
        spread = loops.spread(loops.exempt)
        np.testing.assert_array_equal(spread, (arrives > 0) | loops.exempt)
        np.testing.assert_array_equal(loops.spread(loops.exempt), loops.spread(spread))
        assert not ((arrives > 0) & ~loops.for_ever()).any()
        hopeful = loops.hopeful(spread, 0.5)
        assert set(hopeful.first) <= set(loops.passages.owner)
        assert not hopeful.every(spread).any()
        several += len(set(expected.values())) > 2
    assert several > 3


@pytest.mark.parametrize("fault", ["one part", "one cell", "larger"])
def test_planted_faults_change_the_sets_of_random_blocks(fault, monkeypatch):
    """One part of several is enough; a cell of a block is not told; a block takes that of twice its side with it."""
    honest = CellTransitions._whole

    def whole(self, parts, owner):
        found = self.blocks(np.unique(owner)) if fault == "one part" else honest(self, parts, owner)
        if fault == "larger":
            found = Blocks(found.mesh, found.first, np.full(len(found), 2, np.int8))
        return found.select(slice(None, -1)) if fault == "one cell" else found

    monkeypatch.setattr(CellTransitions, "_whole", whole)
    if fault == "larger":
        cells = Blocks.cells.fget
        monkeypatch.setattr(Blocks, "cells", property(lambda self: np.unique(cells(self) % len(self.mesh))))
    differs = 0
    for seed in range(12):
        loops, *known = random_blocks(seed)
        arrives = loops.arrival()
        differs += {int(c): int(arrives[c]) for c in np.flatnonzero(arrives)} != by_definition(loops, *known)
    assert differs
