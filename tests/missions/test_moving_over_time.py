"""Things that move or roam over time: what an oracle drives past them stays in its sets and keeps their clearance."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

import viatool
from tests.hall import MAP
from tests.loop.noisy_runs import arc, sensor_errors
from tests.missions.test_motors_over_time import in_tube
from tests.sight.ray_oracle import outlines, ranges
from viatool.errors import ConfigurationError
from viatool.loop import elapsed
from viatool.loop.closed_loop import ClosedLoop
from viatool.loop.elapsed import loop_after
from viatool.missions import MissionLimits
from viatool.sets.forms import PoseBoxes
from viatool.setting.setting import Setting
from viatool.setting.wishes import Wishes
from viatool.uncertainty import ErrorModel
from viatool.world import Scenes

EPS, ROUNDING, RUNS, LIMIT = 0.005, 1e-6, 600, 9.0
CART = np.array([0.5, -0.7, 0.2])
WITH_CART = MAP.replace(
    "scenarios:", "  - {name: cart, shape: circle, center: [0.5, -0.7], radius: 0.2}\nscenarios:"
)
SPEED, ROAM = 0.05, 0.25
TERMS = {
    "named": {"named": {"cart": SPEED}},
    "speed": {"speed": SPEED, "named": {}},
    "roams": {"roams": {"cart": ROAM}},
}


@pytest.fixture(scope="module")
def hall(tmp_path_factory):
    path = tmp_path_factory.mktemp("hall") / "hall.yaml"
    path.write_text(WITH_CART, encoding="utf-8")
    return viatool.load_map(path)


def cart_seen(poses, places, lidar):
    """Ranges (R, rays) to discs of the cart's radius at places (R, 2), each run its own."""
    bearing = poses[:, 2, None] + lidar.angles()
    away = places - poses[:, :2]
    along = away[:, :1] * np.cos(bearing) + away[:, 1:] * np.sin(bearing)
    aside = (away**2).sum(axis=1)[:, None] - along**2
    met = (aside <= CART[2] ** 2) & (along > 0.0)
    return np.where(met, along - np.sqrt(np.maximum(CART[2] ** 2 - aside, 0.0)), np.inf)


def wandering(generator, kind, seconds):
    """Where carts (R, 2) are after seconds: some go straight, some jump about, as far as they may."""
    angle = np.where(np.arange(RUNS) % 3 == 0, generator.uniform(-np.pi, np.pi, RUNS), STEADY)
    angle = np.where(np.arange(RUNS) % 3 == 1, -np.pi / 2, angle)  # straight at the path
    far = ROAM if kind == "roams" else SPEED * seconds
    if kind != "roams":
        angle = np.where(np.arange(RUNS) % 3 == 0, STEADY, angle)
    return CART[:2] + far * np.stack([np.cos(angle), np.sin(angle)], axis=1)


STEADY = np.random.default_rng(7).uniform(-np.pi, np.pi, RUNS)


def drive(dodging, hall, kind, steps):
    """Poses (R, K, 3), and what each run keeps of everything between, (R, K)."""
    generator, scenario = np.random.default_rng(0), hall.scenarios[1]
    errors = sensor_errors(generator, Setting.of(dodging, hall, EPS).radii, RUNS, steps)
    circles, segments = outlines(hall, scenario)
    bare = circles[np.abs(circles[:, 2] - CART[2]) > 1e-9], segments
    lidar, goal = hall.robot.lidar, np.array(scenario.goal)
    still = Scenes.of(hall, [scenario])
    poses, command = np.repeat([scenario.start], RUNS, axis=0).astype(float), np.zeros((RUNS, 2))
    found, kept = [], []
    for k in range(steps):
        here = wandering(generator, kind, 0.1 * k)
        rays = np.minimum(
            ranges(poses, lidar.angles(), bare, lidar.maximum_range), cart_seen(poses, here, lidar)
        )
        bins = np.clip(
            rays.reshape(RUNS, lidar.bins, -1).min(axis=2), lidar.minimum_range, lidar.maximum_range
        )
        away = goal - poses[:, :2]
        bearing = np.arctan2(away[:, 1], away[:, 0]) - poses[:, 2]
        seen = [np.hypot(*away.T), np.cos(bearing), np.sin(bearing), *command.T, 0.0 * bearing]
        seen = np.hstack([bins, np.stack(seen, axis=1)]) + errors[:, k]
        command = np.clip(dodging.run(np.float32(seen)), [0.0, -1.0], [0.5, 1.0]).astype(float)
        left = np.full(RUNS, np.inf)
        for share in (0.5, 1.0):
            at, cart = arc(poses, command, 0.1 * share), wandering(generator, kind, 0.1 * (k + share))
            left = np.minimum(left, np.hypot(*(at[:, :2] - cart).T) - CART[2])
            left = np.minimum(left, still.clearance(at[:, :2], np.zeros(RUNS, np.int64)) + 0.45)
        poses = arc(poses, command, 0.1)
        found.append(poses)
        kept.append(left)
    return np.stack(found, axis=1), np.stack(kept, axis=1)


def asked(kind):
    return ErrorModel.model_validate({"obstacles": TERMS[kind]})


@pytest.mark.parametrize("kind", TERMS)
def test_missions_hold_the_runs_past_what_moves_and_keep_clear_of_it(hall, dodging, kind):
    given = {"eps": EPS, "scenarios": hall.scenarios[1:], "time_limit": LIMIT}
    (one,) = viatool.mission(dodging, hall, errors=asked(kind), **given)
    assert one.verdict == "proved"
    found, kept = drive(dodging, hall, kind, one.steps)
    assert in_tube(one, found) < ROUNDING
    assert kept.min() >= one.clearance - ROUNDING
    (still,) = viatool.mission(dodging, hall, **given)
    assert in_tube(still, found) > 100 * ROUNDING
    assert one.clearance < still.clearance - 0.05


def seen_at_their_place(monkeypatch):
    honest = elapsed._roaming
    calls = []

    def roaming(setting, scenario, seconds):
        calls.append(seconds)
        return honest(setting, scenario, 0.0 if len(calls) % 2 else seconds)

    monkeypatch.setattr(elapsed, "_roaming", roaming)


def met_where_they_were_observed(monkeypatch):
    monkeypatch.setattr(elapsed, "_until_it_stands", lambda rules: -10.0)


@pytest.mark.parametrize(
    ("mutate", "seen"), [(seen_at_their_place, True), (met_where_they_were_observed, False)]
)
def test_runs_catch_what_is_left_out_of_things_that_move_on(hall, dodging, monkeypatch, mutate, seen):
    mutate(monkeypatch)
    (one,) = viatool.mission(
        dodging, hall, eps=EPS, errors=asked("named"), scenarios=hall.scenarios[1:], time_limit=LIMIT
    )
    found, kept = drive(dodging, hall, "named", one.steps)
    if seen:
        assert in_tube(one, found) > 100 * ROUNDING
    else:
        assert kept.min() < one.clearance - 0.05


def test_what_moved_away_no_longer_ends_runs_and_counts_for_none(hall, dodging):
    """Poses at which a cart stood at the start are not taken for blocked when it may have left."""
    setting = Setting.of(dodging, hall, EPS, Wishes(errors=asked("named")), job="mission")
    loop = ClosedLoop.of(dodging, setting, hall.scenarios[1])
    there = PoseBoxes(np.array([[*CART[:2], 0.0]]), np.zeros((1, 3)))
    assert loop.blocked(there)[0]
    assert not loop_after(loop, 3).blocked(there)[0]


def test_a_mission_through_where_something_may_have_got_is_not_proved(hall, dodging):
    fast = ErrorModel.model_validate({"obstacles": {"named": {"cart": 0.3}}})
    given = {"eps": EPS, "scenarios": hall.scenarios[1:], "time_limit": LIMIT}
    (one,) = viatool.mission(dodging, hall, errors=fast, limits=MissionLimits(0, finer=0), **given)
    assert one.verdict == "unknown"
    assert "the clearance is not proved" in one.reason or "too many parts" in one.reason


def test_horizons_take_what_moves_and_only_what_the_map_shows(hall, dodging):
    given = {"eps": EPS, "scenarios": hall.scenarios[1:], "horizon": 4}
    none, few, more = (
        viatool.verify(
            dodging,
            hall,
            errors=ErrorModel.model_validate({"obstacles": {"named": {"cart": speed}}}),
            **given,
        )
        for speed in (0.0, 0.05, 0.4)
    )
    tubes = [found.horizon.tubes for found in (none, few, more)]
    for less, most in pairwise(tubes):
        assert (most.steps <= less.steps).all()
        assert (most.clearance <= less.clearance + 10 * ROUNDING).all()
    assert (tubes[2].clearance < tubes[0].clearance - 0.05).any()
    with pytest.raises(ConfigurationError, match=r"obstacles\.returns"):
        viatool.verify(
            dodging, hall, errors=ErrorModel.model_validate({"obstacles": {"returns": 0.1}}), **given
        )
