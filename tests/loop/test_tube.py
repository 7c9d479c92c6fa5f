from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.loop.noisy_runs import arc, runs, sensor_errors
from viatool import load_map, load_policy
from viatool.loop.closed_loop import ClosedLoop
from viatool.loop.horizon import Horizon
from viatool.loop.tube import TubeFollower
from viatool.setting.setting import Setting
from viatool.setting.wishes import Wishes
from viatool.simulate import roll_out
from viatool.world import Scenes

LAB, POLICY = load_map(Path("maps/lab.yaml")), load_policy(Path("policies/via.onnx"))
EPS, STEPS, RUNS = 0.01, 6, 400
TRAJECTORY = roll_out(POLICY, LAB, LAB.scenarios[:2], seed=0)
ROUNDING = 1e-7  # of a grazing ray, times what the policy makes of it


def loop(scenario=LAB.scenarios[0], eps=EPS, **horizon):
    loop = ClosedLoop.of(POLICY, Setting.of(POLICY, LAB, eps), scenario)
    return TubeFollower(loop, 0.5, Horizon(**({"steps": STEPS} | horizon)))


def states(episode, count):
    rows = np.flatnonzero(TRAJECTORY.episode == episode)
    rows = rows[np.linspace(0, len(rows) - 1, count).astype(int)]
    return TRAJECTORY.poses[rows], TRAJECTORY.observations[rows][:, 23:25]


def noisy(some, poses, previous, seed=0):
    """Poses (B, RUNS, K, 3) and commands (B, RUNS, K, 2) of runs from states."""
    generator = np.random.default_rng(seed)
    count, error = len(poses), some.horizon.pose_error
    z = generator.uniform(-1, 1, (count, RUNS, 3))
    z[:, : RUNS // 2] = np.sign(z[:, : RUNS // 2])
    starts = (poses[:, None] + z * error).reshape(-1, 3)
    errors = sensor_errors(generator, Setting.of(POLICY, LAB, EPS).radii, count * RUNS, some.horizon.steps)
    errors = errors.reshape(RUNS, count, *errors.shape[1:]).swapaxes(0, 1).reshape(errors.shape)
    scenario = next(s for s in LAB.scenarios if s.goal == tuple(some.loop.sensors.goal))
    found = runs(POLICY, LAB, scenario, (starts, np.repeat(previous, RUNS, axis=0)), errors)
    return tuple(part.reshape(count, RUNS, *part.shape[1:]) for part in found)


def earlier(happened):
    """Whether something has happened in an interval before, (B, RUNS, K)."""
    before = np.concatenate([np.zeros_like(happened[..., :1]), happened[..., :-1]], axis=2)
    return np.logical_or.accumulate(before, axis=2)


def arrived(found, goal, radius=0.5):
    return np.hypot(found[..., 0] - goal[0], found[..., 1] - goal[1]) < radius


def excess(tubes, found, goal):
    """How far runs that still drive leave their tubes, at most."""
    over = np.maximum(found - tubes.upper[:, None], tubes.lower[:, None] - found).max(axis=3)
    over = np.nan_to_num(over, nan=np.inf)  # a tube ends only where every run has arrived
    return float(over[~earlier(arrived(found, goal))].max())


@pytest.mark.parametrize(("episode", "error"), [(0, (0.0, 0.0)), (1, (0.01, 0.01))])
def test_noisy_runs_stay_in_their_tubes(episode, error):
    some = loop(LAB.scenarios[episode], position_error=error[0], heading_error=error[1])
    poses, previous = states(episode, 8)
    tubes = some.follow(poses, previous)
    assert excess(tubes, noisy(some, poses, previous)[0], LAB.scenarios[episode].goal) < ROUNDING
    assert np.nanmedian((tubes.upper - tubes.lower)[:, -1, 2]) < (0.15 if error == (0.0, 0.0) else 0.4)


def blind_to_errors(some):
    object.__setattr__(some.loop.sensors, "radii", None)


def blind_to_jumps(some):
    """As if every reading were linear in the pose."""
    sensors = some.loop.sensors

    class Linear(type(sensors)):
        def enclose(self, *sets, jumps):
            seen = super().enclose(*sets)
            forms = seen.forms
            return replace(seen, forms=replace(forms, rest=0.0 * forms.rest))

    object.__setattr__(some.loop, "sensors", Linear(**vars(sensors)))


def forgets_the_pose_error(some):
    object.__setattr__(some, "horizon", Horizon(STEPS))


@pytest.mark.parametrize("mutate", [blind_to_errors, blind_to_jumps, forgets_the_pose_error])
def test_noisy_runs_catch_tubes_that_leave_something_out(mutate):
    error = {"position_error": 0.01, "heading_error": 0.01} if mutate is forgets_the_pose_error else {}
    honest, mutant = loop(**error), loop(**error)
    poses, previous = states(0, 8)
    mutate(mutant)
    found, _ = noisy(honest, poses, previous)
    assert excess(mutant.follow(poses, previous), found, LAB.scenarios[0].goal) > 10 * ROUNDING


def early(some):
    """As if a part had arrived when one of its poses has."""
    object.__setattr__(some, "goal_radius", 0.55)


def test_tubes_end_where_every_run_has_arrived():
    some, goal = loop(steps=12), np.array(LAB.scenarios[0].goal)
    last = np.flatnonzero(TRAJECTORY.episode == 0)[-12::3]
    poses, previous = TRAJECTORY.poses[last], TRAJECTORY.observations[last][:, 23:25]
    tubes, (found, _) = some.follow(poses, previous), noisy(some, poses, previous)
    assert excess(tubes, found, goal) < ROUNDING
    assert np.isnan(tubes.lower[-1, -1]).all()
    assert tubes.safe.all()
    early(some)
    assert excess(some.follow(poses, previous), found, goal) == np.inf


@pytest.mark.parametrize("criterion", ["swept", "braking"])
def test_no_run_comes_nearer_than_the_clearance_of_its_tube(criterion):
    scenario = LAB.scenarios[0]
    poses, previous = states(0, 12)
    scenes = Scenes.of(LAB, [scenario])
    here = scenes.clearance(poses[:, :2], np.zeros(12, np.int64))
    world = LAB.with_clearance(
        float(np.median(here)) - 0.05, 5.0
    )  # some tubes begin, and some come, too near
    loop = ClosedLoop.of(POLICY, Setting.of(POLICY, world, EPS, Wishes(criterion)), scenario)
    some = TubeFollower(loop, 0.5, Horizon(STEPS))
    tubes, (found, commands) = some.follow(poses, previous), noisy(some, poses, previous)
    left = np.inf
    for share in (0.25, 0.5, 0.75, 1.0):  # of the interval, back from its end
        back = arc(found.reshape(-1, 3), commands.reshape(-1, 2), (share - 1.0) * LAB.robot.control_interval)
        there = scenes.clearance(back[:, :2], np.zeros(len(back), np.int64)).reshape(found.shape[:3])
        left = np.minimum(left, there)
    collides = left <= world.clearance.collision
    driving = ~(earlier(collides) | earlier(arrived(found, scenario.goal)))
    assert (left >= tubes.clearance[:, None] - ROUNDING)[driving].all()
    proved = np.arange(STEPS) < tubes.steps[:, None]
    assert not (collides & proved[:, None])[driving].any()
    assert 0 < tubes.safe.sum() <= (tubes.steps > 0).sum() < 12


def test_a_state_that_has_collided_is_not_safe():
    some = loop()
    poses = np.array([[4.7, 0.0, np.pi]])  # 15 cm from the wall, looking away from it
    assert some.follow(poses, np.zeros((1, 2))).steps[0] == 0
