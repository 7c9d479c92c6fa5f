"""Robots that turn by more than a circle in one control interval: the chord of their arc points backwards."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.loop.plant import Plant
from tests.motion.toys import integrated
from viatool import load_map, load_policy
from viatool.errors import BoundsError
from viatool.loop.closed_loop import ClosedLoop
from viatool.loop.horizon import Horizon
from viatool.loop.tube import TubeFollower
from viatool.motion import twists
from viatool.places import Lookahead, Resolution, certify
from viatool.policy.network import Affine, Input, Network
from viatool.policy.writer import write_onnx
from viatool.setting.setting import Setting

VIA, ROOM = load_policy("policies/via.onnx"), load_map("maps/room.yaml")
SCENARIO, SECONDS, LIMIT, SPEED, EPS = ROOM.scenarios[0], 2.0, 4.0, 0.3, 0.001
WORLD = ROOM.with_robot(
    replace(ROOM.robot, max_angular=LIMIT, control_interval=SECONDS, min_linear=-SPEED, max_linear=SPEED)
).with_clearance(0.05, 0.1)
PREVIOUS = VIA.spec.columns("previous_angular")[0]


def policy_of(path, speed, turn, gain):
    """A policy that commands a speed, and a turn that depends on the turn before."""
    weight = np.zeros((2, VIA.input_size))
    weight[1, PREVIOUS] = gain
    action = [
        channel.model_copy(update={"lower": -limit, "upper": limit})
        for channel, limit in zip(VIA.spec.action, (SPEED, LIMIT), strict=True)
    ]
    spec = VIA.spec.model_copy(update={"control_interval": SECONDS, "action": action})
    bias = np.array([speed, turn], np.float32).astype(np.float64)
    write_onnx(Network((Input(VIA.input_size), Affine((0,), (weight,), bias))), spec, path)
    return load_policy(path)


def next_commands(policy, commands, generator):
    """What the deployed program commands after other commands, whatever the sensors err."""
    seen = np.zeros((len(commands), VIA.input_size), np.float32)
    seen[:, PREVIOUS] = commands[:, 1] + EPS * generator.choice([-1.0, 0.0, 1.0], len(commands))
    found = np.asarray(policy.run(seen), np.float64)
    return np.clip(found, [-SPEED, -LIMIT], [SPEED, LIMIT])


DRIVES = {
    "always the same": (SPEED, 4.0, 0.0),
    "to and fro": (SPEED, 3.9, -2.0),
    "more and more": (SPEED, 1.0, 1.125),
    "backward": (-SPEED, 3.7, -0.25),
}


def leaves(path, name, steps=6):
    """How far runs leave their tubes at most, and how many intervals the tubes have."""
    policy = policy_of(path / "policy.onnx", *DRIVES[name])
    loop = TubeFollower(
        ClosedLoop.of(policy, Setting.of(policy, WORLD, EPS), SCENARIO), 0.3, Horizon(steps, 0.001, 0.001)
    )
    generator = np.random.default_rng(0)
    start = generator.uniform((-1.5, -1.5, -3.0), (1.5, 1.5, 3.0), (12, 3))
    before = np.column_stack([np.full(12, DRIVES[name][0]), generator.uniform(-LIMIT, LIMIT, 12)])
    tubes, worst = loop.follow(start, before), -np.inf
    for _ in range(60):
        poses, commands = start + 0.001 * generator.choice([-1.0, 1.0], start.shape), before
        alive = np.ones(12, dtype=bool)
        for k in range(steps):
            commands = next_commands(policy, commands, generator)
            poses = integrated("differential", poses, commands, np.full(12, SECONDS), 20)
            alive &= np.isfinite(tubes.lower[:, k, 0])
            out = np.maximum(tubes.lower[:, k] - poses, poses - tubes.upper[:, k]).max(axis=1)
            worst = max(worst, float(out[alive].max(initial=-np.inf)))
    return worst, int(np.isfinite(tubes.lower[:, :, 0]).sum())


@pytest.mark.parametrize("name", DRIVES)
def test_tubes_hold_the_runs(tmp_path, name):
    worst, intervals = leaves(tmp_path, name)
    assert intervals > 40
    assert worst < 1e-7


def test_bounds_that_take_chords_to_point_never_backwards_contradict_the_forms(tmp_path, monkeypatch):
    monkeypatch.setattr(twists, "least_sinc", lambda half: np.maximum(np.sinc(half / np.pi), 0.0))
    with pytest.raises(BoundsError, match="states after an interval"):
        leaves(tmp_path, "to and fro")


@pytest.mark.parametrize("name", ["always the same", "backward"])
def test_cells_last_as_long_as_their_runs_keep_their_clearance(tmp_path, name):
    """`certify --steps --forever`: what is claimed of cells, driven from their corners with errors of the sensors."""
    policy = policy_of(tmp_path / "policy.onnx", *DRIVES[name])
    found = certify(
        policy, WORLD, SCENARIO, eps=EPS, criterion="swept", resolution=Resolution(0.5, 0),
        lookahead=Lookahead(steps=3, for_ever=True, intervals=2, goal_radius=0.3),
    ).lasting  # fmt: skip
    claimed = np.minimum(found.intervals, 3)
    rows = np.flatnonzero(found.free & (claimed > 0))
    generator, robot = np.random.default_rng(1), Plant(policy, WORLD, SCENARIO, EPS)
    rows = generator.choice(rows, min(1500, len(rows)), replace=False)
    assert len(rows) > 150
    lower, upper = found.mesh.bounds(rows)
    for _ in range(4):
        states = lower + generator.choice([0.0, 0.5, 1.0], lower.shape) * (upper - lower)
        poses, commands = states[:, :3], states[:, 3:]
        driving = robot.free(poses)
        for k in range(3):
            commands = next_commands(policy, commands, generator)
            ways = [integrated("differential", poses, commands, share * np.full(len(rows), SECONDS), 12)
                    for share in np.linspace(0.05, 1.0, 20)]  # fmt: skip
            clear = (robot.away(np.stack(ways, axis=1)) > WORLD.clearance.collision - 1e-9).all(axis=1)
            assert clear[driving & (claimed[rows] > k)].all()
            poses = ways[-1]
            driving &= np.hypot(*(poses[:, :2] - SCENARIO.goal).T) >= 0.3
