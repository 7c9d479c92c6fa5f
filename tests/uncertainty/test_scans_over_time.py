"""Scans that are turned, pass thin obstacles or lose rays in every interval: sets hold the runs of a ray caster.

The rays are those of `tests.sight.ray_oracle`; nothing is shared with the bounds.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import viatool
from tests.loop.noisy_runs import runs, sensor_errors
from tests.missions.dodging import write_dodging_policy
from tests.missions.test_mission import outside
from tests.sight.ray_oracle import outlines, ranges
from viatool.loop.closed_loop import ClosedLoop
from viatool.loop.horizon import Horizon
from viatool.loop.tube import TubeFollower
from viatool.setting.setting import Setting
from viatool.setting.wishes import Wishes
from viatool.sight.shapes import Shapes
from viatool.simulate import roll_out
from viatool.uncertainty import ErrorModel
from viatool.world import Obstacles

LAB = viatool.load_map("maps/lab.yaml")
POSTS = np.array([[-1.6, 1.0, 0.03], [0.4, 0.6, 0.04], [1.1, -1.2, 0.02], [3.4, 0.2, 0.05]])
POLICY = viatool.load_policy("via")
LIDAR = POLICY.spec.channel("lidar").lidar.lidar()
EPS, STEPS, RUNS, STATES = 0.005, 4, 240, 5
TERMS = {
    "angle": {"angle": 0.03},
    "thin": {"thin": 0.1},
    "missing": {"missing": 2},
    "all": {"angle": 0.02, "thin": 0.1, "missing": 1},
}


def drawn(generator, *shape):
    """Numbers from -1 to 1, most of them at an end."""
    found = generator.uniform(-1.0, 1.0, shape)
    return np.where(generator.random(shape) < 0.7, np.sign(found), found)


def look(world, scenario, terms, seed=0):
    """What LiDARs read at poses (R, 3) under terms that are drawn anew: a function for `runs`."""
    generator = np.random.default_rng(seed)
    every = outlines(world, scenario)
    circles, segments = every
    bare = circles[2.0 * circles[:, 2] > terms.get("thin", 0.0)], segments

    def seen(poses):
        turned = poses + terms.get("angle", 0.0) * drawn(generator, len(poses), 1) * [0.0, 0.0, 1.0]
        rays, past = (ranges(turned, LIDAR.angles(), what, LIDAR.maximum_range) for what in (every, bare))
        passes = np.repeat(generator.random((len(poses), LIDAR.bins)) < 0.5, LIDAR.each, axis=1)
        rays = np.clip(np.where(passes, past, rays), LIDAR.minimum_range, LIDAR.maximum_range)
        rays = rays + EPS * np.repeat(drawn(generator, len(poses), LIDAR.bins), LIDAR.each, axis=1)
        count = terms.get("missing", 0)
        if count:
            nearest = rays.argsort(axis=1)[:, : 3 * LIDAR.each]
            for row, order in enumerate(nearest):
                lost = generator.choice(order, size=generator.integers(0, count + 1), replace=False)
                rays[row, lost] = LIDAR.maximum_range
        return rays.reshape(len(poses), LIDAR.bins, -1).min(axis=2)

    return seen


def setting_of(policy, world, terms, job):
    errors = ErrorModel.model_validate({"sensor": {"lidar": terms}} if terms else {})
    return Setting.of(policy, world, EPS, Wishes(errors=errors), [world.scenarios[0]], job=job)


@pytest.fixture(scope="module")
def world():
    return replace(LAB, obstacles=LAB.obstacles + Obstacles(POSTS, ()))


@pytest.fixture(scope="module")
def begun(world):
    """States near a post, so that every term changes a reading."""
    found = roll_out(POLICY, LAB, LAB.scenarios[:1], seed=0)
    away = np.min(
        [np.hypot(*(found.poses[:, :2] - post[:2]).T) - post[2] for post in POSTS], axis=0
    )  # the first drive meets none of them
    rows = np.flatnonzero(away > 0.45)
    rows = rows[np.linspace(3, len(rows) - 20, STATES).astype(int)]
    return found.poses[rows], found.observations[rows][:, 23:25]


def follower(world, terms, job="verify with a horizon"):
    setting = setting_of(POLICY, world, terms, job)
    return TubeFollower(ClosedLoop.of(POLICY, setting, world.scenarios[0]), 0.5, Horizon(STEPS))


def driven(world, begun, terms):
    """Poses (STATES, RUNS, STEPS, 3)."""
    generator, count = np.random.default_rng(1), STATES * RUNS
    own = sensor_errors(generator, setting_of(POLICY, world, {}, "verify").radii, count, STEPS)
    own[:, :, :20] = 0.0  # drawn for each ray's bin, as a ray that returns nothing does not err
    starts = tuple(np.repeat(part, RUNS, axis=0) for part in begun)
    scenario = world.scenarios[0]
    found, _ = runs(POLICY, world, scenario, starts, own, look(world, scenario, terms))
    return found.reshape(STATES, RUNS, STEPS, 3)


def excess(tubes, found):
    return float(np.maximum(found - tubes.upper[:, None], tubes.lower[:, None] - found).max())


@pytest.mark.parametrize("name", TERMS)
def test_runs_stay_in_their_tubes_and_leave_those_without_the_term(world, begun, name):
    found = driven(world, begun, TERMS[name])
    assert excess(follower(world, TERMS[name]).follow(*begun), found) < 1e-7
    assert excess(follower(world, {}).follow(*begun), found) > 1e-4


def test_rays_that_pass_thin_obstacles_are_caught_if_these_are_seen_for_certain(world, begun, monkeypatch):
    found = driven(world, begun, TERMS["thin"])
    monkeypatch.setattr(Shapes, "passing", lambda self, width: self)
    assert excess(follower(world, TERMS["thin"]).follow(*begun), found) > 1e-4


def test_what_is_lost_is_caught_if_only_one_choice_counts(world, begun, monkeypatch):
    found = driven(world, begun, TERMS["missing"])
    from viatool.channels.quantities import Sightings

    honest = Sightings.choices
    monkeypatch.setattr(Sightings, "choices", lambda self, most: list(honest(self, most))[:1])
    assert excess(follower(world, TERMS["missing"]).follow(*begun), found) > 1e-4


def test_a_mission_is_proved_with_a_turned_scan_and_a_lost_ray_and_holds_the_runs_of_the_oracle(tmp_path):
    from tests.hall import MAP

    (tmp_path / "hall.yaml").write_text(MAP, encoding="utf-8")
    hall = viatool.load_map(tmp_path / "hall.yaml")
    dodging = viatool.load_policy(write_dodging_policy(tmp_path / "dodging.onnx"))
    terms = {"angle": 0.01, "missing": 1}
    errors = ErrorModel.model_validate({"sensor": {"lidar": terms}})
    (one,) = viatool.mission(dodging, hall, eps=EPS, scenarios=hall.scenarios[1:], errors=errors)
    assert one.verdict == "proved"
    generator, count = np.random.default_rng(2), 400
    own = sensor_errors(generator, Setting.of(dodging, hall, EPS).radii, count, one.steps)
    own[:, :, :20] = 0.0
    starts = np.repeat([one.scenario.start], count, axis=0), np.zeros((count, 2))
    found, _ = runs(dodging, hall, one.scenario, starts, own, look(hall, one.scenario, terms))
    assert outside(one.proof.tube, found, one.scenario) < 1e-7
    away = np.hypot(*np.moveaxis(found[:, :, :2] - np.array(one.scenario.goal), 2, 0))
    assert (away < 0.5).any(axis=1).all()
