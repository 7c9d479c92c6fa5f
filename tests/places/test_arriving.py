"""`certify --arrive`: which cells reach the goal for certain, which only stay safe, and which of these stand still."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.benchmarks.forever import Arriving, Robots, drive_to_goal
from viatool import load_map, load_policy
from viatool.loop.closed_loop import ClosedLoop
from viatool.places import Campaign, Lookahead, Resolution, certify, forever, over_time
from viatool.places.forever import CellTransitions
from viatool.places.mesh import CellSet, Mesh, Ranges
from viatool.places.over_time import look_ahead
from viatool.places.passages import Passages, follow
from viatool.policy.network import Affine, Input, Network
from viatool.policy.writer import write_onnx
from viatool.schedule import NEVER, Deadline, Processes

VIA = load_policy(Path("policies/via.onnx"))
MISSION = load_policy(Path("policies/via-mission.onnx"))
EPS, RADIUS = 0.01, 0.45
CHAMBER = """
schema_version: 1
name: chamber
arena: {shape: box, center: [0.0, 0.0], size: [1.8, 1.8]}
obstacles: []
robot:
  name: turtlebot3
  min_linear: 0.0
  max_linear: 0.5
  max_angular: 1.0
  deceleration: 1.0
  control_interval: 0.1
  footprint: {shape: point}
  lidar:
    {field_of_view: 3.141592653589793, rays: 180, bins: 20, minimum_range: 0.2, maximum_range: 7.0, noise: 0.01}
clearance: {collision: 0.3, danger: 0.4}
scenarios:
  - {name: middle, start: [-0.5, -0.5, 0.8], goal: [0.0, 0.0]}
"""


@pytest.fixture(scope="module")
def chamber(tmp_path_factory):
    path = tmp_path_factory.mktemp("map") / "chamber.yaml"
    path.write_text(CHAMBER)
    return load_map(path)


def written(path, *nodes):
    """A policy that observes what via-mission.onnx does, which is nothing of the command before."""
    write_onnx(Network((Input(MISSION.input_size), *nodes)), MISSION.spec, path)
    return load_policy(path)


def constant(path, speed, turn):
    """A policy that always commands the same; the robot takes a speed below 0 as 0."""
    bias = np.array([speed, turn], np.float32).astype(np.float64)
    return written(path, Affine((0,), (np.zeros((2, MISSION.input_size)),), bias))


def homing(path):
    """A policy that turns to its goal, and drives the faster the better it heads for it; it sees no obstacle."""
    names = [channel.name for channel in MISSION.spec.observation]
    ends = np.cumsum([channel.size for channel in MISSION.spec.observation])
    column = dict(zip(names, ends - 1, strict=True))
    seen = np.zeros((2, MISSION.input_size))
    seen[0, column["goal_cosine"]], seen[1, column["goal_sine"]] = 0.5, 2.0
    return written(path, Affine((0,), (seen,), np.zeros(2)))


def asked(policy, chamber, side, **lookahead):
    return certify(
        policy, chamber, eps=EPS, criterion="swept", resolution=Resolution(side),
        lookahead=Lookahead(arrive=True, goal_radius=RADIUS, **lookahead),
    )  # fmt: skip


def again(policy, certificate, campaign=None, until=NEVER, **changed):
    """Look ahead again from what the certificate found for the next action."""
    loop = ClosedLoop.of(policy, certificate.setting, certificate.scenario)
    return look_ahead(
        loop, certificate.lattice, certificate.findings, certificate.scenario.goal,
        replace(certificate.lasting.lookahead, **changed), campaign or Campaign(), until=until,
    )  # fmt: skip


@pytest.fixture(scope="module")
def home(chamber, tmp_path_factory):
    policy = homing(tmp_path_factory.mktemp("policy") / "homing.onnx")
    return policy, asked(policy, chamber, 0.1, intervals=4)


@pytest.fixture
def followed_once(home, monkeypatch):
    """What cells lead to does not change with what is made of it, so it is found once."""
    monkeypatch.setattr(over_time, "follow", kept_follow)


FOLLOWED = {}


def kept_follow(loop, mesh, cells, **more):
    key = (cells.tobytes(), more["side"].tobytes(), more["intervals"])
    if key not in FOLLOWED:
        FOLLOWED[key] = follow(loop, mesh, cells, **more)
    return FOLLOWED[key]


def test_every_run_from_cells_that_arrive_does_so_in_time_and_keeps_its_clearance(home, chamber):
    """4,000 runs by a simulator that shares no code, from corners of cells, under errors at their limits."""
    policy, certificate = home
    found = certificate.lasting
    assert found.arriving.sum() > 500
    assert not (found.arriving & ~found.for_ever).any()
    assert len(np.unique(found.arrives[found.arriving])) > 10
    told = drive(policy, chamber, found.cell_table())
    assert told["violations"] == told["late"] == 0
    assert told["runs"] == 4000


def drive(policy, chamber, table, runs=4000):
    robots = Robots(policy, chamber, chamber.scenarios[0], EPS, steps=3)
    return drive_to_goal(robots, Arriving(table), runs, RADIUS, np.random.default_rng(0))


def ranges_of_middles(monkeypatch):
    """A range counts as covered where its middle is."""

    def covers(self, ranges):
        middle = ((ranges.first.astype(int) + ranges.last) // 2).astype(np.int16)
        return honest(self, Ranges(middle, middle))

    honest = CellSet.covers
    monkeypatch.setattr(CellSet, "covers", covers)


def a_larger_goal(monkeypatch):
    honest = over_time._within
    monkeypatch.setattr(over_time, "_within", lambda mesh, goal, radius: honest(mesh, goal, radius + 0.1))


def one_interval_less(monkeypatch):
    honest = CellTransitions.arrival
    monkeypatch.setattr(CellTransitions, "arrival", lambda self: np.maximum(honest(self) - 1, 0))


@pytest.mark.parametrize(
    "fault",
    [ranges_of_middles, a_larger_goal, one_interval_less],
    ids=lambda one: one.__name__,
)
def test_planted_faults_are_seen_by_the_runs(home, chamber, fault, followed_once, monkeypatch):
    policy, certificate = home
    fault(monkeypatch)
    told = drive(policy, chamber, again(policy, certificate).cell_table())
    assert told["late"] + told["violations"] > 0


def test_intervals_are_those_of_the_slowest_start_of_a_cell(chamber, tmp_path):
    """Straight ahead, where what is true is known; the goal counts at the ends of intervals."""
    policy = constant(tmp_path / "straight.onnx", 0.5, 0.0)
    found = asked(policy, chamber, 0.1, intervals=4).lasting
    rows = np.flatnonzero(found.arriving)
    assert len(rows) > 100
    lower, upper = found.mesh.bounds(rows)
    generator, robots = np.random.default_rng(0), Robots(policy, chamber, chamber.scenarios[0], EPS, steps=2)
    slowest = np.zeros(len(rows), int)
    for _ in range(32):
        states = lower + generator.choice([0.0, 0.5, 1.0], lower.shape) * (upper - lower)
        took = np.full(len(rows), 99)
        for number in range(1, 40):
            ahead = 0.05 * number
            places = states[:, :2] + ahead * np.stack([np.cos(states[:, 2]), np.sin(states[:, 2])], axis=1)
            took = np.where((took == 99) & (np.hypot(*places.T) < RADIUS), number, took)
        slowest = np.maximum(slowest, np.where(robots.free(states[:, :3]), took, 0))
    assert (slowest <= found.arrives[rows]).all()
    assert (found.arrives[rows] - slowest).mean() < 3.0  # a cell is two intervals wide
    np.testing.assert_array_equal(found.for_ever, found.arriving)  # whoever misses the goal meets a wall


def test_who_moves_and_who_stands_is_told_apart(chamber, tmp_path):
    """A robot that spins never stands; one that stands is safe, and no more; a crawl counts as standing."""
    for name, command, moves in (
        ("spin", (0.0, 0.75), True), ("right", (-1.0, -0.0101), True), ("stand", (0.0, 0.0), False),
        ("creep", (0.0, 0.0099), False),
    ):  # fmt: skip
        found = asked(constant(tmp_path / f"{name}.onnx", *command), chamber, 0.2, intervals=1).lasting
        assert not found.arriving.any()
        assert found.for_ever.sum() > 300
        np.testing.assert_array_equal(found.moving, found.for_ever & moves)
        np.testing.assert_array_equal(found.standing, found.for_ever & (not moves))


def test_who_moves_now_and_stands_later_does_not_count_as_moving(monkeypatch):
    """0 stands; 1 moves and leads to 0; 2 and 3 move and lead to each other; 4 moves, and leads to 5, which arrives."""
    leads = [0, 0, 3, 2, 5, 6, 6]
    ends = np.zeros((2, 6, 5), np.int16)
    ends[:, :, 0] = leads[:6]
    moved = np.array([0, 1, 1, 1, 1, 0], np.int16)
    goal = np.arange(7) == 6
    cells = Mesh(np.zeros(5), np.ones(5), np.array([7, 1, 1, 1, 1]))
    loops = CellTransitions(cells, goal, Passages(np.arange(6), [Ranges(*ends)], np.ones(6, np.int16), moved))
    np.testing.assert_array_equal(loops.arrival(), [0, 0, 0, 0, 2, 1, 0])
    np.testing.assert_array_equal(np.flatnonzero(loops.moving(loops.arrival() > 0)), [2, 3])
    np.testing.assert_array_equal(np.flatnonzero(loops.for_ever()), [0, 1, 2, 3, 4, 5])


class Plain:
    """The sets by their definitions, over lists and sets of numbers: shares nothing with summed tables."""

    def __init__(self, ranges, kept, moved, owner, exempt, wide):
        self.parts = {cell: [] for cell in range(len(exempt))}
        for row, cell in enumerate(owner):
            leads = [
                {number % wide if turned else number for number in range(first, last + 1)}
                for first, last, turned in ranges[row]
            ]
            self.parts[int(cell)].append((leads, int(kept[row]), int(moved[row])))
        self.exempt = {cell for cell in range(len(exempt)) if exempt[cell]}

    def arrival(self):
        within = [set(self.exempt)]
        for number in range(1, 200):
            within.append(
                within[-1]
                | {
                    cell
                    for cell, parts in self.parts.items()
                    if parts
                    and all(
                        any(
                            i < min(kept, number) and leads[i] <= within[number - 1 - i]
                            for i in range(len(leads))
                        )
                        for leads, kept, _ in parts
                    )
                }
            )
        count = {}
        for number, cells in enumerate(within):
            for cell in cells - self.exempt:
                count.setdefault(cell, number)
        return count

    def greatest(self, done, moving):
        members = {cell for cell, parts in self.parts.items() if parts} | done
        while True:
            kept_in = {
                cell
                for cell in members
                if cell in done
                or all(
                    any(
                        i < (min(kept, moved) if moving else kept) and leads[i] <= members
                        for i in range(len(leads))
                    )
                    for leads, kept, moved in self.parts[cell]
                )
            }
            if kept_in == members:
                return members - done
            members = kept_in


def random_loops(seed, count=60, depth=3):
    """Cells around a circle (headings go round), with one to three parts, drifting on by a few cells."""
    generator = np.random.default_rng(seed)
    exempt = generator.random(count) < 0.12
    owner = np.sort(np.concatenate([np.flatnonzero(~exempt), generator.choice(count, 15)]))
    owner = owner[~exempt[owner]]
    drift = generator.integers(0, 3, (len(owner), depth)).cumsum(axis=1)
    first = (owner[:, None] + drift) % count
    last = first + generator.integers(0, 3, first.shape)
    kept = generator.integers(1, depth + 1, len(owner)).astype(np.int16)
    moved = np.minimum(kept, generator.integers(0, depth + 3, len(owner))).astype(np.int16)
    mesh = Mesh(np.zeros(5), np.ones(5), np.array([1, 1, count, 1, 1]))
    ranges = []
    for index in range(depth):
        ends = np.zeros((2, len(owner), 5), np.int16)
        ends[0, :, 2], ends[1, :, 2] = first[:, index], last[:, index]
        ranges.append(Ranges(*ends))
    plain = [
        [(int(a), int(b), True) for a, b in zip(low, high, strict=True)]
        for low, high in zip(first, last, strict=True)
    ]
    loops = CellTransitions(mesh, exempt, Passages(owner, ranges, kept, moved))
    return loops, Plain(plain, kept, moved, owner, exempt, count)


def agree(seed):
    """Whether the sets of random cells are those of their definitions."""
    loops, plain = random_loops(seed)
    arrives, expected = loops.arrival(), plain.arrival()
    arriving = {int(cell) for cell in np.flatnonzero(arrives)}
    same = {cell: int(arrives[cell]) for cell in arriving} == expected
    same &= {int(cell) for cell in np.flatnonzero(loops.for_ever())} == plain.greatest(plain.exempt, False)
    moving = {int(cell) for cell in np.flatnonzero(loops.moving(arrives > 0))}
    return same and moving == plain.greatest(plain.exempt | set(expected), True), len(expected), len(moving)


def test_sets_of_random_cells_are_those_of_their_definitions():
    told = [agree(seed) for seed in range(60)]
    assert all(same for same, _, _ in told)
    assert sum(arriving for _, arriving, _ in told) > 500
    assert sum(moving for _, _, moving in told) > 30


@pytest.mark.parametrize("fault", ["part", "level", "kept", "moved"])
def test_planted_faults_change_the_sets_of_random_cells(fault, monkeypatch):
    if fault == "part":  # one part of several suffices

        class Numpy:
            def __getattr__(self, name):
                return getattr(np, name)

            class subtract:  # noqa: N801 - stands for numpy's
                @staticmethod
                def at(parts, rows, amount):
                    parts[rows] = 0

        monkeypatch.setattr(forever, "np", Numpy())
    else:
        honest = CellTransitions._leads

        def leads(self, rows, sets, lasts):
            if fault == "level":
                sets = [sets[0]] * len(sets)
            if fault == "moved":
                lasts = self.passages.kept
            if fault == "kept":
                lasts = np.full_like(lasts, 3)
            return honest(self, rows, sets, lasts)

        monkeypatch.setattr(CellTransitions, "_leads", leads)
    assert not all(agree(seed)[0] for seed in range(60))


def test_cells_have_no_sides_for_a_command_before_on_which_nothing_depends(chamber):
    for policy, delay, slices in ((MISSION, 0.0, [1, 1]), (MISSION, 0.05, [2, 2]), (VIA, 0.0, [2, 2])):
        found = certify(
            policy, chamber, eps=EPS, criterion="swept", delay=delay, resolution=Resolution(0.5, 1)
        )
        np.testing.assert_array_equal(Mesh.of(found.lattice).count[3:], slices)


def test_workers_and_kept_work_change_nothing(home, tmp_path, monkeypatch):
    policy, certificate = home
    monkeypatch.setattr(over_time.FollowWork, "piece", 2000)
    whole = certificate.lasting
    shared = again(policy, certificate, Campaign(Processes(2), checkpoint=tmp_path / "kept"))

    def nothing_is_followed_again(*given, **more):
        raise AssertionError

    monkeypatch.setattr(over_time, "follow", nothing_is_followed_again)
    resumed = again(policy, certificate, Campaign(checkpoint=tmp_path / "kept", resume=True))
    for name in ("arrives", "moves", "intervals"):
        np.testing.assert_array_equal(getattr(shared, name), getattr(whole, name))
        np.testing.assert_array_equal(getattr(resumed, name), getattr(whole, name))


class Looks:
    """A clock that goes on by a second with every look at it."""

    def __init__(self):
        self.now = 0.0

    def __call__(self):
        self.now += 1.0
        return self.now


@pytest.mark.parametrize("seconds", [300.0, 900.0])
def test_what_was_not_followed_in_time_is_not_claimed(home, seconds, followed_once, monkeypatch):
    policy, certificate = home
    monkeypatch.setattr(over_time.FollowWork, "piece", 100)
    found, whole = again(policy, certificate, until=Deadline.after(seconds, Looks())), certificate.lasting
    assert not (found.arriving & ~whole.arriving).any()
    assert not (found.arriving & ~found.for_ever).any()
    assert (found.arrives[found.arriving] >= whole.arrives[found.arriving]).all()
    assert found.arriving.sum() < whole.arriving.sum()
