from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.benchmarks.forever import CellList, Robots, attack
from tests.loop.plant import Plant
from viatool import load_map, load_policy
from viatool.errors import ConfigurationError
from viatool.loop.closed_loop import ClosedLoop
from viatool.places import Campaign, Lookahead, Resolution, certify, over_time
from viatool.places.forever import FOR_EVER, CellTransitions
from viatool.places.mesh import CellSet, Mesh, Ranges
from viatool.places.over_time import look_ahead
from viatool.places.passages import Passages
from viatool.places.passages import follow as passages
from viatool.policy.activations import activation
from viatool.policy.network import Activation, Affine, Input, Network
from viatool.policy.writer import write_onnx
from viatool.schedule import NEVER, Deadline, Processes

ROOM, VIA = load_map(Path("maps/room.yaml")), load_policy(Path("policies/via.onnx"))
SCENARIO = ROOM.scenarios[0]


def constant(path, speed, turn):
    """A policy that always commands the same; the robot takes a speed below 0 as 0."""
    size = VIA.input_size
    bias = np.array([speed, turn], np.float32).astype(np.float64)
    network = Network((Input(size), Affine((0,), (np.zeros((2, size)),), bias)))
    write_onnx(network, VIA.spec, path)
    return load_policy(path)


def lasting(policy, side=0.25, **asked):
    certificate = certify(
        policy, ROOM, SCENARIO, eps=0.01, criterion="swept", resolution=Resolution(side, 0),
        lookahead=Lookahead(**asked),
    )  # fmt: skip
    return certificate.lasting


def test_a_robot_that_turns_on_the_spot_is_safe_for_ever_wherever_it_is_free(tmp_path):
    """Also across theta = pi, where headings go round; it neither moves nor is anything left to rounding."""
    found = lasting(constant(tmp_path / "spin.onnx", -0.25, 0.75), for_ever=True, intervals=1)
    assert found.free.sum() > 1500
    np.testing.assert_array_equal(found.for_ever, found.free)


def true_intervals(states, speed, most):
    """After how many steps straight ahead a robot comes too near to something or to the goal; `most` if to none."""
    robot, goal = Plant(VIA, ROOM, SCENARIO, 0.01), np.array(SCENARIO.goal)
    found, done = np.full(len(states), most), np.zeros(len(states), bool)
    for number in range(most):
        for share in (0.25, 0.5, 0.75, 1.0):
            ahead = 0.1 * speed * (number + share)
            places = states[:, :2] + ahead * np.stack([np.cos(states[:, 2]), np.sin(states[:, 2])], axis=1)
            bad = (robot.away(np.column_stack([places, states[:, 2]])) <= 0.4) & ~done
            found[bad], done[bad] = number, True
        done |= np.hypot(*(places - goal).T) < 0.8
    return found


@pytest.fixture(scope="module")
def ahead(tmp_path_factory):
    return constant(tmp_path_factory.mktemp("policy") / "straight.onnx", 0.5, 0.0)


@pytest.fixture(scope="module")
def certificate(ahead):
    return certify(
        ahead, ROOM, SCENARIO, eps=0.01, criterion="swept", resolution=Resolution(0.25, 0),
        lookahead=Lookahead(steps=8, for_ever=True, intervals=4, goal_radius=0.8),
    )  # fmt: skip


@pytest.fixture(scope="module")
def straight(certificate):
    return certificate.lasting


@pytest.fixture
def look(ahead, certificate):
    """Look ahead again from what the certificate found for the next action."""

    def look(campaign=None, until=NEVER, **asked):
        return look_ahead(
            ClosedLoop.of(ahead, certificate.setting, SCENARIO), certificate.lattice, certificate.findings,
            SCENARIO.goal, replace(certificate.lasting.lookahead, **asked), campaign or Campaign(), until=until,
        )  # fmt: skip

    return look


def test_a_robot_that_drives_straight_lasts_as_long_as_its_way_is_free(straight):
    """Every state of a cell lasts at least as long as the cell, and no cell is far from its own worst corner."""
    generator = np.random.default_rng(0)
    rows = generator.choice(np.flatnonzero(straight.free), 1000, replace=False)
    rows = np.concatenate([rows, np.flatnonzero(straight.for_ever)])
    lower, upper = straight.mesh.bounds(rows)
    robot, lasts = Plant(VIA, ROOM, SCENARIO, 0.01), np.full(len(rows), 60)
    for _ in range(24):
        states = lower + generator.choice([0.0, 0.5, 1.0], lower.shape) * (upper - lower)
        true = true_intervals(states, 0.5, 60)
        free = robot.free(states[:, :3])
        lasts = np.where(free, np.minimum(lasts, true), lasts)
    claimed = np.minimum(straight.intervals[rows], 60)
    assert (claimed <= lasts).all()
    assert (straight.intervals[rows] == FOR_EVER).sum() >= 4
    short = (lasts > 0) & (lasts <= 8)
    assert short.sum() > 100
    assert (lasts - claimed)[short].mean() < 2.5  # a cell is five steps wide


def test_more_steps_are_never_more_cells_and_for_ever_is_among_all(straight):
    counts = [number for _, number in straight.by_steps()]
    assert counts == sorted(counts, reverse=True)
    assert counts[0] > counts[-1] >= straight.for_ever.sum() > 0
    table = straight.cell_table()
    assert (table["steps"] == -1).sum() == straight.for_ever.sum()


def loop(leads, exempt, kept=None):
    """Cells in a row, each leading to the cells from the first to the last of a pair."""
    count = len(leads)
    cells = Mesh(np.zeros(5), np.ones(5), np.array([count, 1, 1, 1, 1]))
    ends = np.zeros((2, count, 5), np.int16)
    ends[:, :, 0] = np.array(leads).T
    kept = np.ones(count, np.int16) if kept is None else np.array(kept, np.int16)
    owner = np.flatnonzero(~np.array(exempt))
    ranges = [Ranges(ends[0][owner], ends[1][owner])]
    return CellTransitions(cells, np.array(exempt), Passages(owner, ranges, kept[owner], kept[owner]))


def test_what_leads_out_of_the_set_is_removed_until_nothing_does():
    """0 stays; 1 leads to 0; 2 to 3, 3 to 4, 4 has no proof; 5 reaches the goal 6; 7 may lead to 6 or out by 8."""
    leads = [(0, 0), (0, 0), (3, 3), (4, 4), (0, 0), (6, 6), (0, 0), (6, 8), (4, 4)]
    found = loop(leads, [False] * 6 + [True] + [False] * 2, kept=[1, 1, 1, 1, 0, 1, 1, 1, 1])
    held = found.for_ever()
    np.testing.assert_array_equal(held, [True, True, False, False, False, True, False, False, False])
    steps = found.intervals(5, held)
    np.testing.assert_array_equal(steps[[2, 3, 4, 7, 8]], [2, 1, 0, 2, 1])
    assert (steps[[0, 1, 5, 6]] == FOR_EVER).all()


def test_sums_tell_what_ranges_a_set_covers():
    generator = np.random.default_rng(0)
    cells = Mesh(np.zeros(5), np.ones(5), np.array([5, 4, 6, 1, 3]))
    mask = generator.random(len(cells)) < 0.93
    first = generator.integers(0, cells.count, (800, 5))
    last = first + generator.integers(0, 3, (800, 5))
    plain = [0, 1, 3, 4]
    last[:, plain] = np.minimum(last[:, plain], cells.count[plain] - 1)
    ranges = Ranges(first.astype(np.int16), last.astype(np.int16))
    covers, share = CellSet(cells, mask).covers(ranges), CellSet(cells, mask).share(ranges)
    members = mask.reshape(tuple(cells.count))
    for low, high, found, part in zip(first, last, covers, share, strict=True):
        index = [np.arange(a, b + 1) % n for a, b, n in zip(low, high, cells.count, strict=True)]
        assert members[np.ix_(*index)].all() == found
        assert members[np.ix_(*index)].mean() == pytest.approx(part)


def test_ranges_hold_every_state_between_their_ends():
    generator = np.random.default_rng(1)
    cells = Mesh(np.array([-2, -2, -np.pi, 0, -1.0]), np.array([0.1, 0.1, np.pi / 7, 0.25, 0.5]),
                 np.array([40, 40, 14, 2, 4]))  # fmt: skip
    index = generator.integers(0, cells.count, (4000, 5))
    lower = cells.origin + index * cells.size  # on borders, where rounding decides
    upper = np.minimum(lower + generator.choice([0.0, 1.0, 1.5], (4000, 5)) * cells.size, [2, 2, 9, 0.5, 1.0])
    lower[:, 2] += 2 * np.pi * generator.integers(-1, 2, 4000)
    upper[:, 2] = np.maximum(lower[:, 2], upper[:, 2])
    found = cells.ranges(lower, upper)
    begin, end = cells.origin + found.first * cells.size, cells.origin + (found.last + 1) * cells.size
    turns = np.round((lower[:, 2] - begin[:, 2]) / (2 * np.pi)) * 2 * np.pi
    begin[:, 2] += turns
    end[:, 2] += turns
    whole = found.last[:, 2] - found.first[:, 2] >= cells.count[2] - 1
    assert (begin <= lower + 1e-12)[:, [0, 1, 3, 4]].all()
    assert (end >= upper - 1e-12)[:, [0, 1, 3, 4]].all()
    assert ((begin[:, 2] <= lower[:, 2] + 1e-12) | whole).all()
    assert ((end[:, 2] >= upper[:, 2] - 1e-12) | whole).all()


def test_cells_of_leaves_are_as_the_leaves_say():
    certificate = certify(
        VIA, ROOM, SCENARIO, eps=0.01, criterion="swept", resolution=Resolution(0.5, 1),
        lookahead=Lookahead(steps=1, intervals=1),
    )  # fmt: skip
    found, units = certificate.lasting, certificate.units
    names = ("blocked", "uncontested", "certified", "refuted", "unknown")
    status = found.mesh.statuses(certificate.lattice, certificate.findings)
    np.testing.assert_array_equal(np.bincount(status, minlength=5), [units[name] for name in names])
    lower, upper = found.mesh.bounds(np.arange(len(found.mesh)))
    middle, reach = 0.5 * (lower + upper)[:, :3], 0.5 * np.hypot(*(upper - lower)[:, :2].T)
    solid = Plant(VIA, ROOM, SCENARIO, 0.01).away(middle) + reach < 0.4
    assert solid.any()
    assert not found.free[solid].any()
    safe = np.isin(found.status, (1, 2)) & found.free
    assert (found.intervals[safe] >= 1).all()
    assert not found.intervals[found.free & ~safe].any()


def test_a_coarser_cell_is_as_bad_as_the_worst_leaf_in_it(certificate):
    fine, coarse = Mesh.of(certificate.lattice), Mesh.of(certificate.lattice, 1)
    status = fine.statuses(certificate.lattice, certificate.findings).reshape(8, 2, 8, 2, 16, 2)
    np.testing.assert_array_equal(
        coarse.statuses(certificate.lattice, certificate.findings), status.max(axis=(1, 3, 5)).ravel()
    )
    assert len(np.unique(status)) > 2


def test_workers_change_nothing(look, monkeypatch):
    monkeypatch.setattr(over_time.FollowWork, "piece", 500)
    alone, shared = look(intervals=1), look(Campaign(Processes(2)), intervals=1)
    np.testing.assert_array_equal(shared.intervals, alone.intervals)


def test_cells_that_were_followed_are_kept_and_not_followed_again(tmp_path, look, straight, monkeypatch):
    monkeypatch.setattr(over_time.FollowWork, "piece", 500)
    first = look(Campaign(checkpoint=tmp_path / "kept"))
    kept = sorted((tmp_path / "kept").glob("follow-*/units-*"))
    assert len(kept) > 4
    kept[1].unlink()
    followed = []
    monkeypatch.setattr(
        over_time, "follow", lambda *given, **more: followed.append(len(given[2])) or passages(*given, **more)
    )
    again = look(Campaign(checkpoint=tmp_path / "kept", resume=True))
    assert followed == [500]
    for found in (first, again):
        np.testing.assert_array_equal(found.intervals, straight.intervals)


class Looks:
    """A clock that goes on by a second with every look at it."""

    def __init__(self):
        self.now = 0.0

    def __call__(self):
        self.now += 1.0
        return self.now


@pytest.mark.parametrize(
    "seconds",
    [
        400.0,
        1000.0,
        pytest.param(700.0, marks=pytest.mark.slow),  # other moments of the same rounds
        pytest.param(1300.0, marks=pytest.mark.slow),
    ],
)
def test_what_was_not_followed_in_time_is_not_claimed(look, straight, seconds, monkeypatch):
    monkeypatch.setattr(over_time.FollowWork, "piece", 50)
    found = look(until=Deadline.after(seconds, Looks()))
    assert (found.intervals <= straight.intervals).all()
    assert (found.intervals < straight.intervals).any()
    assert (found.intervals[found.free] > 0).any()
    assert not (found.for_ever & ~straight.for_ever).any()


@pytest.mark.parametrize(
    ("asked", "words"),
    [({"steps": -1}, "counted"), ({"intervals": 0}, "followed"), ({"goal_radius": -1.0}, "radius")],
)
def test_what_cannot_be_asked_is_refused(asked, words):
    with pytest.raises(ConfigurationError, match=words):
        Lookahead(**asked)


def test_robots_do_not_leave_the_set_under_errors_chosen_to_do_harm(tmp_path):
    """A policy that stands still where something is near: 3,000 steps by a simulator that shares no code."""
    size = VIA.input_size
    slower = np.zeros((20, size))
    slower[np.arange(20), np.arange(20)] = -1.0
    network = Network(
        (
            Input(size),
            Affine((0,), (slower,), np.full(20, 1.0)),
            Activation(1, activation("Relu"), 20),
            Affine((2,), (np.array([[-1.0] * 20, [0.0] * 20]),), np.array([0.5, 0.5])),
        )
    )
    write_onnx(network, VIA.spec, tmp_path / "careful.onnx")
    policy = load_policy(tmp_path / "careful.onnx")
    found = lasting(policy, side=0.125, for_ever=True, intervals=1)
    assert found.for_ever.sum() > 1000
    robots, cells = Robots(policy, ROOM, SCENARIO, 0.01, steps=5), CellList(found.cell_table())
    assert len(cells) == found.for_ever.sum()
    told = attack(robots, cells, 3000, 150, 8, 1, 0.5, np.random.default_rng(0))
    assert told["violations"] == told["escapes"] == 0
    half = found.cell_table()
    half["steps"] = np.where(np.arange(len(half["steps"])) % 2, half["steps"], 0)
    assert attack(robots, CellList(half), 300, 150, 8, 1, 0.5, np.random.default_rng(0))["escapes"] > 0
