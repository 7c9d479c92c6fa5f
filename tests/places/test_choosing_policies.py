"""Places, cells over time and tubes of a policy that chooses among commands, against a plant that shares no code."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from tests.choosing import TABLE, choosing_specification, write_choosing
from tests.loop.plant import Plant
from viatool import load_map, load_policy
from viatool.loop.closed_loop import ClosedLoop
from viatool.loop.horizon import Horizon
from viatool.loop.tube import TubeFollower
from viatool.places import Lookahead, Resolution, SearchBudget, certify, passages
from viatool.safety.pieces import CommandPieces
from viatool.setting.setting import Setting

ROOM = load_map(Path("maps/room.yaml"))
SCENARIO, EPS = ROOM.scenarios[0], 0.02


@dataclass
class Choosing(Plant):
    """A robot that is sent the row of the table which is chosen."""

    def command(self, observations):
        return np.array(TABLE)[self.policy.run(observations.astype(np.float32)).argmax(axis=1)]


@pytest.fixture(scope="module")
def policy(tmp_path_factory):
    return load_policy(write_choosing(tmp_path_factory.mktemp("policy") / "choosing.onnx"))


@pytest.fixture(scope="module")
def robot(policy):
    return Choosing(policy, ROOM, SCENARIO, EPS)


def certified(policy, criterion, **asked):
    return certify(policy, ROOM, SCENARIO, eps=EPS, criterion=criterion, **asked)


def test_every_state_of_a_certified_cell_keeps_its_clearance(policy, robot):
    found = certified(policy, "braking", resolution=Resolution(0.08, 0), budget=SearchBudget(share=0.04))
    table = found.cell_table()
    rows = table["status"] == "certified"
    assert rows.sum() > 200
    margins = robot.margins(table["lower"][rows], table["upper"][rows], np.random.default_rng(0), 25_000)
    assert len(margins) > 10_000
    assert margins.min() > -1e-9


def lost(policy, robot, tries):
    """How many runs from cells fail within the intervals that are claimed, and how many intervals that are."""
    lookahead = Lookahead(4, for_ever=True, intervals=2)
    found = certified(policy, "swept", resolution=Resolution(0.25, 0), lookahead=lookahead).lasting
    claimed = np.minimum(found.intervals, 4)
    rows = np.flatnonzero(found.free & (claimed > 0))
    generator = np.random.default_rng(1)
    rows = generator.choice(rows, min(1000, len(rows)), replace=False)
    lower, upper = found.mesh.bounds(rows)
    failed, still = 0, np.zeros(len(rows))
    for _ in range(tries):
        states = lower + generator.choice([0.0, 0.5, 1.0], lower.shape) * (upper - lower)
        driving = robot.free(states[:, :3])
        for k in range(4):
            commands = robot.noisy_command(states, generator)
            path = robot.drive(states[:, :3], commands, ROOM.robot.control_interval, still)
            clear = (robot.away(path) > ROOM.clearance.collision - 1e-9).all(axis=1)
            failed += int((~clear & driving & (claimed[rows] > k)).sum())
            states = np.column_stack([path[:, -1], commands])
            driving &= np.hypot(*(states[:, :2] - SCENARIO.goal).T) >= found.lookahead.goal_radius
    return failed, claimed[rows]


def test_cells_last_as_long_as_their_runs_keep_their_clearance(policy, robot):
    failed, claimed = lost(policy, robot, 3)
    assert failed == 0
    assert len(claimed) > 900
    assert (claimed < 4).sum() > 50  # or else nothing comes near to anything


def test_a_command_that_is_not_followed_lets_cells_last_too_long(policy, robot, monkeypatch):
    """The mutant that follows the first of several possible commands alone."""
    follow = passages.step

    def first_of_each(loop, states, *, jumps):
        after = follow(loop, states, jumps=jumps)
        rows = np.unique(after.origin, return_index=True)[1]
        names = ("origin", "lower", "upper", "least", "most", "before_lower", "before_upper")
        return type(after)(
            start=after.start.select(rows), states=passages.select(after.states, rows),
            **{name: getattr(after, name)[rows] for name in names},
        )  # fmt: skip

    monkeypatch.setattr(passages, "step", first_of_each)
    assert lost(policy, robot, 3)[0] > 0


def test_runs_stay_in_their_tubes(policy, robot):
    """Of which every interval holds the states of all runs that have neither collided nor arrived."""
    loop = ClosedLoop.of(policy, Setting.of(policy, ROOM, EPS), SCENARIO)
    follower = TubeFollower(loop, 0.3, Horizon(8, 0.01, 0.01))
    generator = np.random.default_rng(2)
    poses = generator.uniform((-2.5, -2.5, -3.0), (2.5, 2.5, 3.0), (60, 3))
    poses = poses[robot.free(poses)][:24]
    before = np.array(TABLE)[generator.integers(5, size=len(poses))]
    tubes, worst, several = follower.follow(poses, before), -np.inf, 0
    still, ways = np.zeros(len(poses)), []
    for _ in range(40):
        states = np.column_stack([poses + 0.01 * generator.choice([-1.0, 1.0], poses.shape), before])
        alive, way = robot.free(states[:, :3]), []
        for k in range(8):
            commands = robot.noisy_command(states, generator)
            path = robot.drive(states[:, :3], commands, ROOM.robot.control_interval, still)
            alive &= (robot.away(path) > 0.0).all(axis=1) & np.isfinite(tubes.lower[:, k, 0])
            clear = (robot.away(path) > ROOM.clearance.collision).all(axis=1)
            assert (clear | ~alive | (tubes.steps <= k)).all()
            alive &= clear
            states = np.column_stack([path[:, -1], commands])
            out = np.maximum(tubes.lower[:, k] - states[:, :3], states[:, :3] - tubes.upper[:, k])
            worst = max(worst, float(out[alive].max(initial=-np.inf)))
            way.append(commands)
        ways.append(np.stack(way, axis=1))
    several = (np.ptp(np.stack(ways), axis=0) > 0).any(axis=(1, 2)).sum()
    assert worst < 1e-7
    assert several > 5  # or else no choice was open


def write_avoiding(path):
    """Write a policy that turns away from the goal's side as hard as it can: never straight ahead."""
    size = choosing_specification().observation_size
    weights = np.zeros((2, size))
    weights[:, 22] = [1.0, -1.0]
    tensor = numpy_helper.from_array(weights.astype(np.float32), "W")
    ends = [
        helper.make_tensor_value_info(name, TensorProto.FLOAT, ["batch", width])
        for name, width in (("observation", size), ("values", 2))
    ]
    node = helper.make_node("Gemm", ["observation", "W"], ["values"], transB=1)
    graph = helper.make_graph([node], "policy", ends[:1], ends[1:], [tensor])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    channel = {"name": "move", "kind": "choice", "axes": ["linear", "angular"]}
    channel["commands"] = [[0.0, 1.0], [0.0, -1.0]]
    helper.set_model_props(model, {"viatool.spec": choosing_specification(action=[channel]).to_json()})
    onnx.save(model, path)
    return load_policy(path)


def test_what_lies_between_two_commands_is_not_followed(tmp_path, monkeypatch):
    """A policy that turns left or right lasts for two headings, not for all between them."""
    policy = write_avoiding(tmp_path / "policy.onnx")
    loop = ClosedLoop.of(policy, Setting.of(policy, ROOM, EPS), SCENARIO)
    towards = np.arctan2(*(np.array(SCENARIO.goal)[::-1] - 0.0))
    follower = TubeFollower(loop, 0.3, Horizon(1))
    mesh_cell = np.array([[0.0, 0.0, towards]])
    parts = follower.beginning(mesh_cell, np.zeros((1, 2)))
    after = passages.step(loop, passages.states_of(parts.cells))
    assert sorted(after.lower[:, 1]) == sorted(after.upper[:, 1]) == [-1.0, 1.0]
    assert (after.states.rest[:, 2] < 1e-9).all()
    apart = CommandPieces.of_parts.__func__

    def together(cls, *given):
        pieces = apart(cls, *given)
        return cls(np.arange(pieces.count), *pieces.hull(), pieces.count)

    monkeypatch.setattr(CommandPieces, "of_parts", classmethod(together))
    after = passages.step(loop, passages.states_of(parts.cells))
    assert (after.lower[:, 1], after.upper[:, 1]) == (-1.0, 1.0)
