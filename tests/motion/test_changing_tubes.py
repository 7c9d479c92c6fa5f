"""Tubes of robots whose motion has a state: runs with adversarial errors stay inside, and keep their clearance."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from tests.motion import changing_plant as plant
from tests.motion.changing_square import COLLISION, EPS, INTERVAL, ROBOTS, left_over
from tests.motion.test_changing_successor import motion
from viatool import verify
from viatool.errors import BoundsError
from viatool.loop import successor
from viatool.loop.closed_loop import ClosedLoop
from viatool.loop.horizon import Horizon
from viatool.loop.tube import TubeFollower
from viatool.motion.signals import IntegratedSignal
from viatool.setting.setting import Setting
from viatool.simulate.places import Places
from viatool.verification.witness_file import load_witnesses, replay, witness_document

STEPS, STARTS, RUNS = 4, 40, 60
SLACK = 1e-4
"""Metres by which the small steps of the plant may err."""
GOAL, RADIUS = np.array([1.5, 1.5]), 0.5
each = pytest.mark.parametrize("robot", ROBOTS.values(), ids=ROBOTS)


def follower(robot, folder, **horizon):
    setting = Setting.of(robot.policy(folder), robot.world(folder), EPS)
    loop = ClosedLoop.of(setting.commanding(robot.policy(folder)), setting, setting.scenarios[0])
    return TubeFollower(loop, RADIUS, Horizon(STEPS, **horizon))


def starts(robot, seed=0):
    """Poses, motions and by how much these may be others: many at the limits."""
    generator = np.random.default_rng(seed)
    poses = generator.uniform((-1.2, -1.2, -np.pi), (1.2, 1.2, np.pi), (STARTS, 3))
    low, high = plant.motion_of(plant.robot_of(robot.name)).state_range
    share = generator.random((STARTS, len(low)))
    return poses, low + share * (high - low), 0.02 * generator.random((STARTS, len(low)))


def driven(robot, folder, begin, pose_error=0.0, seed=0):
    """Poses (B, RUNS, K, PIECES + 1, 3) and motions (B, RUNS, K, S) at the ends of runs with errors."""
    generator, policy = np.random.default_rng(seed), robot.policy(folder)
    poses, before, apart = (np.repeat(part, RUNS, axis=0) for part in begin)
    poses = poses + pose_error * generator.choice([-1.0, 1.0], poses.shape)
    before = before + apart * generator.choice([-1.0, 1.0], apart.shape)
    held_error = generator.choice([-1.0, 1.0], (len(poses), 6 + len(robot.measured)))
    ways, motions = [], []
    for _ in range(STEPS):
        seen = robot.observed(poses, before)
        drawn = generator.choice([-1.0, 1.0], seen.shape)
        error = np.where(np.arange(len(poses))[:, None] % 2, held_error, drawn)
        raw = policy.run(np.float32(seen + 0.9999 * EPS * error))
        way = robot.path(poses, raw, before)
        before = motion(robot.name, np.hstack([robot.clipped(raw), before]), INTERVAL)
        poses = way[:, -1]
        ways.append(way)
        motions.append(before)
    shape = (STARTS, RUNS, STEPS)
    ways, motions = np.stack(ways, axis=1), np.stack(motions, axis=1)
    return ways.reshape(*shape, -1, 3), motions.reshape(*shape, -1)


def driving(ways):
    """Which runs have neither arrived nor collided before an interval, (B, RUNS, K)."""
    near = np.hypot(*np.moveaxis(ways[:, :, :, -1, :2] - GOAL, 3, 0)) < RADIUS
    ended = near | (left_over(ways).min(axis=3) <= COLLISION)
    first = np.hypot(*np.moveaxis(ways[:, :, 0, 0, :2] - GOAL, 2, 0)) < RADIUS
    before = np.concatenate([first[:, :, None], ended[:, :, :-1]], axis=2)
    return ~np.logical_or.accumulate(before, axis=2)


def excess(tubes, ways, goes=None):
    """How far runs that still drive leave their tubes at most."""
    ends, goes = ways[:, :, :, -1], driving(ways) if goes is None else goes
    over = np.maximum(ends - tubes.upper[:, None], tubes.lower[:, None] - ends).max(axis=3)
    return float(np.nan_to_num(over, nan=np.inf)[goes].max())


@each
def test_noisy_runs_stay_in_their_tubes_and_keep_their_clearance(robot, tmp_path):
    """2,400 runs from boxes of poses and motions, each over four intervals."""
    some, begin = follower(robot, tmp_path, position_error=0.01, heading_error=0.01), starts(robot)
    tubes, (ways, _) = some.follow(*begin), driven(robot, tmp_path, begin, 0.01)
    goes = driving(ways)
    assert excess(tubes, ways, goes) < SLACK
    left = left_over(ways).min(axis=3)
    assert (left >= tubes.clearance[:, None] - SLACK)[goes].all()
    proved = np.arange(STEPS) < tubes.steps[:, None]
    assert not ((left <= COLLISION - SLACK) & proved[:, None])[goes].any()
    assert 0 < tubes.safe.sum() < STARTS


@pytest.mark.parametrize("name", ["second_order_linear", "second_order_angular", "second_order"])
def test_tubes_are_about_as_wide_as_runs_spread(name, tmp_path):
    robot = ROBOTS[name]
    poses, before, apart = starts(robot)
    begin = poses, before, 0.0 * apart
    tubes, (ways, _) = follower(robot, tmp_path).follow(*begin), driven(robot, tmp_path, begin)
    spread = np.ptp(ways[:, :, :, -1], axis=1)[:, -1]
    wide = (tubes.upper - tubes.lower)[:, -1]
    there = driving(ways).all(axis=(1, 2))
    assert np.nanmedian(wide[there] / np.maximum(spread[there], 1e-9), axis=0).max() < 5.0


def blind_to_errors(some, patch):
    object.__setattr__(some.loop.sensors, "radii", None)


def velocity_that_is_not_carried(some, patch):
    right = successor._after

    def wrong(rules, states, *given):
        found = right(rules, states, *given)
        found.centre[:, 3:], found.slope[:, :, 3:], found.rest[:, 3:] = states.centre[:, 3:], 0.0, 0.0
        found.slope[:, : states.slope.shape[1], 3:] = states.slope[:, :, 3:]
        return found

    patch.setattr(successor, "_after", wrong)
    patch.setattr(
        IntegratedSignal,
        "reached",
        lambda self, lower, upper, time: (lower[:, self.state], upper[:, self.state]),
    )


def velocity_as_it_was_measured(some, patch):
    """As if the state at the beginning were known exactly."""
    right = TubeFollower.follow
    patch.setattr(TubeFollower, "follow", lambda self, poses, before, apart: right(self, poses, before))


def motion_of_a_robot_that_stands(some, patch):
    right = ClosedLoop.given_in

    def wrong(self, cells, lower, upper):
        return right(
            self,
            replace(
                cells, previous_lower=0.0 * cells.previous_lower, previous_upper=0.0 * cells.previous_upper
            ),
            lower,
            upper,
        )

    patch.setattr(ClosedLoop, "given_in", wrong)


@pytest.mark.parametrize("name", ["second_order_linear", "second_order"])
@pytest.mark.parametrize(
    "mutate",
    [
        blind_to_errors,
        velocity_that_is_not_carried,
        velocity_as_it_was_measured,
        motion_of_a_robot_that_stands,
    ],
)
def test_noisy_runs_catch_tubes_that_leave_something_out(mutate, name, tmp_path, monkeypatch):
    robot = ROBOTS[name]
    some, begin = follower(robot, tmp_path), starts(robot)
    ways, _ = driven(robot, tmp_path, begin)
    mutate(some, monkeypatch)
    try:
        found = some.follow(*begin)
    except BoundsError:
        return  # what is known of a set contradicts itself
    assert excess(found, ways) > 10 * SLACK


@each
def test_a_horizon_is_verified_and_what_is_unsafe_is_replayed(robot, tmp_path):
    world, policy = robot.world(tmp_path), robot.policy(tmp_path)
    found = verify(policy, world, eps=EPS, places=Places(count=60), horizon=3)
    crashes, verdict = found.horizon.crashes, found.horizon.verdict
    assert {"safe", "unsafe"} <= set(verdict)
    poses, motions = crashes.poses, crashes.motions
    for k in range(2):
        held = np.hstack([crashes.actions[:, k], motions[:, k]])
        after = plant.path(robot.name, poses[:, k], held, np.full(len(held), INTERVAL), pieces=400)[:, -1]
        np.testing.assert_allclose(poses[:, k + 1, :2], after[:, :2], atol=1e-5)
        np.testing.assert_allclose(motions[:, k + 1], motion(robot.name, held, INTERVAL), atol=1e-12)
    for k in range(3):
        some = crashes.step >= k
        off = crashes.observations[some, k] - robot.observed(poses[some, k], motions[some, k])
        assert np.abs(off).max(initial=0.0) < EPS * (1.0 + 1e-5)
    path = tmp_path / "witnesses.json"
    path.write_text(json.dumps(witness_document(found)))
    again = replay(policy, world, load_witnesses(path))
    assert len(again.violates) == len(found.witnesses) + len(crashes)
    assert again.violates.all()


def test_what_nobody_knows_the_motion_of_is_not_safe(tmp_path):
    robot = ROBOTS["second_order_linear"]
    some = follower(robot, tmp_path)
    poses, before, _ = starts(robot)
    before[:] = np.nan
    with pytest.raises(BoundsError):
        some.follow(poses, before)
