"""Robots whose motors lag, among things that move: against runs in fine steps, and things that go straight at them."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from tests.motion.actuated_runs import H
from tests.motion.test_actuated import drive
from tests.safety.brute_force import FOOTPRINTS, place, random_world, rim_of
from tests.safety.cases import make_cases
from tests.safety.test_varying import NEAR, RUNS, placed_runs
from viatool.motion.actuated import STANDING, ActuatedMotion
from viatool.safety import find_contested
from viatool.safety.judgement import prove
from viatool.safety.moving import moving_obstacles
from viatool.safety.scene_poses import Movers
from viatool.safety.varying import enclose_varying
from viatool.uncertainty import ErrorModel
from viatool.uncertainty.error_model import ObstacleTerms

SPEED = 0.8


def obstacles_of(world):
    circles = [shapely.Point(x, y).buffer(r, quad_segs=64) for x, y, r in world.obstacles.circles]
    return shapely.union_all([*circles, *map(shapely.Polygon, world.obstacles.polygons)])


def excess(seed, terms, name, kinematics="differential"):
    """By how much a bound exceeds what a thing leaves that goes straight at a run of its cell until that stands."""
    footprint = FOOTPRINTS[name]
    world, placed, course, cells, runs, poses = placed_runs(seed, kinematics, terms, footprint)
    cells.lower[:, cells.axes], cells.upper[:, cells.axes] = 0.0, 1.0
    movers = Movers(moving_obstacles(world, [None], ObstacleTerms(speed=SPEED)), np.zeros(RUNS, int))
    least = enclose_varying(cells, placed.among([movers]), course, footprint).least
    things, worst = obstacles_of(world), -np.inf
    rim = rim_of(footprint)
    fast = np.hypot(runs.velocity[..., 0], runs.velocity[..., 1]) + rim * np.abs(runs.velocity[..., 2])
    for run in range(RUNS):
        counts = np.flatnonzero((fast[run] > STANDING) & (np.arange(fast.shape[1]) < runs.counts[run]))[::3]
        if len(counts):
            away = shapely.distance(place(poses[run, counts], footprint), things)
            away = away - (footprint.radius if footprint.kind == "circle" else 0.0)
            left = np.maximum(away - SPEED * H * counts, 0.0)  # nothing is nearer than contact
            worst = max(worst, (least[run] - left).max())
    return worst


ALL = ("lag", "limits", "gain", "slip", "jitter", "delay", "brake")


@pytest.mark.parametrize(
    ("terms", "name"),
    [(("lag", "brake"), "circle"), (("lag",), "square"), pytest.param(ALL, "square", marks=pytest.mark.slow)],
)
def test_nothing_comes_nearer_than_the_bound_of_a_robot_that_lags(terms, name):
    assert excess(0, terms, name) <= NEAR


def longest_moving(seed, terms, rim=0.2):
    """By how many seconds runs move longer than is said of them, at most."""
    runs, course = drive(seed, "differential", terms, rim)
    fast = np.hypot(runs.velocity[..., 0], runs.velocity[..., 1]) + rim * np.abs(runs.velocity[..., 2])
    moves = (fast > STANDING) & (np.arange(fast.shape[1]) < runs.counts[:, None])
    last = H * (moves.shape[1] - moves[:, ::-1].argmax(axis=1))
    return float(np.where(moves.any(axis=1), last - course.stands, -np.inf).max())


STANDS = ActuatedMotion.stands.func


def _without_a_tail(self):
    return self.end - 3.0 * self._brake_lag if self.machine.deceleration is not None else self.end


@pytest.mark.parametrize("terms", [("lag", "brake"), ALL])
def test_robots_that_lag_stand_when_it_is_said(terms):
    assert max(longest_moving(seed, terms) for seed in range(1)) <= 2.0 * H


def test_the_time_until_robots_stand_is_needed(monkeypatch):
    """A brake without a lag would be over sooner."""
    monkeypatch.setattr(ActuatedMotion, "stands", property(_without_a_tail))
    assert max(longest_moving(seed, ("lag", "brake"), 0.0) for seed in range(1)) > 5.0 * H


def test_the_time_until_robots_stand_counts_the_tail():
    """A fast robot with long lags is still moving when its tail begins; that of profiles ends by another clock."""
    world = random_world(3, FOOTPRINTS["circle"])
    errors = ErrorModel.model_validate({"actuation": {"linear": {"lag": [0.0, 0.6]}}})
    case, *_ = make_cases(world, "braking", 0, count=5, errors=errors, interval=0.1)
    motion = case.motion
    tail = motion.end - 0.6
    assert (motion.stands > tail).all()
    # own solution of v' = -min(b, v / tau) from the greatest speed
    v, seconds, step = float(np.abs(case.rules.upper[0])), 0.1, 1e-4
    while v > STANDING:
        v -= step * min(case.rules.deceleration, v / 0.6)
        seconds += step
    assert (motion.stands >= seconds - 1e-3).all()
    assert (STANDS(motion) > _without_a_tail(motion) + 1.2).all()
    np.testing.assert_array_equal(motion.counted(np.arange(5), motion.end), motion.stands)
    np.testing.assert_array_equal(motion.select(np.arange(2, 4)).stands, motion.stands[2:4])


@pytest.mark.parametrize("criterion", ["swept", "braking"])
def test_a_longer_lag_proves_no_more_among_things_that_move(criterion):
    world, before = random_world(1, FOOTPRINTS["circle"], control_interval=0.25), None
    for lag in (0.0, 0.02, 0.1, 0.3):
        errors = ErrorModel.model_validate({"actuation": {"linear": {"relative": 1e-9, "lag": [0.0, lag]}}})
        case, lower, upper = make_cases(world, criterion, 1, errors=errors, reach=0.8)
        case.under_way[:] = np.clip([0.3, 0.1], case.rules.lower, case.rules.upper)
        movers = Movers(moving_obstacles(world, [None], ObstacleTerms(speed=0.4)), np.zeros(len(lower), int))
        case = type(case)(
            case.rules, case.observing.among([movers]), case.under_way, case.velocity, case.begun
        )
        found = prove(case, lower, upper, 0.1).proved
        settled = ~find_contested(case).collision
        if before is not None:
            assert not (found & ~before[0]).any()
            assert not (settled & ~before[1]).any()
        before = found, settled
    assert before[0].any()
