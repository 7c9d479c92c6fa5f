"""Terms of the error model in every interval of a run: tubes and missions hold what an oracle drives."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import viatool
from tests.hall import MAP
from tests.loop.noisy_runs import runs, sensor_errors
from tests.missions.dodging import write_dodging_policy
from viatool.errors import ConfigurationError
from viatool.loop.closed_loop import ClosedLoop
from viatool.loop.horizon import Horizon
from viatool.loop.tube import TubeFollower
from viatool.setting.setting import Setting
from viatool.setting.wishes import Wishes
from viatool.simulate import roll_out
from viatool.uncertainty import ErrorModel

LAB = viatool.load_map("maps/lab.yaml")
SCENARIO = LAB.scenarios[0]
POLICY = viatool.load_policy("via")
EPS = 0.005
STEPS, RUNS, STATES = 5, 600, 6
SHARES = np.repeat([0.02, 0.03, 0.0], [20, 1, 5])
BIAS = 0.04
POSE = np.array([0.03, 0.03, 0.02])
ALL = {
    "sensor": {"lidar": {"relative": 0.02, "bias": BIAS}, "goal_distance": {"relative": 0.03}},
    "pose": {"x": 0.03, "y": 0.03, "theta": 0.02},
}


def follower(model, steps=STEPS):
    errors = ErrorModel.model_validate(model)
    setting = Setting.of(POLICY, LAB, EPS, Wishes(errors=errors), job="verify with a horizon")
    return TubeFollower(ClosedLoop.of(POLICY, setting, SCENARIO), 0.5, Horizon(steps).beginning(errors))


def drawn(generator, *shape):
    """Numbers from -1 to 1: a third of the runs any, a third ends, a third the same ends in every interval."""
    return sensor_errors(generator, np.ones(shape[2]), shape[0], shape[1])


@pytest.fixture(scope="module")
def begun():
    driven = roll_out(POLICY, LAB, LAB.scenarios[:1], seed=0)
    rows = np.linspace(5, len(driven) - 20, STATES).astype(int)
    return driven.poses[rows], driven.observations[rows][:, 23:25]


def drive(begun, only):
    """Poses (STATES, RUNS, STEPS, 3) under errors of some of the terms."""
    generator, (poses, before), count = np.random.default_rng(3), begun, STATES * RUNS
    starts = drawn(generator, count, 1, 3)[:, 0] * POSE * ("start" in only)
    own = sensor_errors(generator, Setting.of(POLICY, LAB, EPS).radii, count, STEPS)
    own[:, :, :20] += BIAS * drawn(generator, count, STEPS, 1) * ("common" in only)
    found, _ = runs(
        *(
            POLICY,
            LAB,
            SCENARIO,
            (np.repeat(poses, RUNS, axis=0) + starts, np.repeat(before, RUNS, axis=0)),
            own,
        ),
        shares=SHARES * drawn(generator, count, STEPS, len(SHARES)) * ("relative" in only),
        astray=POSE * drawn(generator, count, STEPS, 3) * ("pose" in only),
    )
    return found.reshape(STATES, RUNS, STEPS, 3)


def excess(tubes, found):
    return float(np.maximum(found - tubes.upper[:, None], tubes.lower[:, None] - found).max())


def test_runs_under_all_terms_stay_in_their_tubes(begun):
    found = drive(begun, ("relative", "common", "pose", "start"))
    assert excess(follower(ALL).follow(*begun), found) < 1e-7


@pytest.mark.parametrize("part", ["relative", "common", "pose", "start"])
def test_runs_leave_tubes_without_a_term(begun, part):
    some, found = follower(ALL), drive(begun, (part,))
    erring = some.loop.sensors.radii
    none = {name: 0.0 * getattr(erring, name) for name in ("relative", "common", "pose")}
    own = none if part == "start" else none | {part: getattr(erring, part)}
    for terms, start, caught in ((own, part == "start", False), (none, False, True)):
        sensors = replace(some.loop.sensors, radii=replace(erring, **terms))
        one = replace(some, loop=replace(some.loop, sensors=sensors))
        one = one if start else replace(one, horizon=Horizon(STEPS))
        assert (excess(one.follow(*begun), found) > 1e-4) == caught


def test_more_of_a_term_never_proves_more(begun):
    few = follower(ALL).follow(*begun)
    none = follower({}).follow(*begun)
    assert (few.lower <= none.lower).all()
    assert (few.upper >= none.upper).all()
    assert (few.clearance <= none.clearance).all()
    assert (few.steps <= none.steps).all()


def test_a_horizon_says_what_it_counts_in_every_interval_and_begins_within_the_error_of_the_pose():
    found = viatool.verify(
        POLICY, LAB, eps=EPS, scenarios=LAB.scenarios[:1], errors=ErrorModel.model_validate(ALL), horizon=2
    )
    told = {premise.name: premise.value for premise in found.premises}
    assert told["pose.theta"] == "0.02 rad"
    report = found.to_json()
    assert report["horizon"]["pose_error"] == {"position": 0.03, "heading": 0.02}
    wider = Horizon(2).beginning(ErrorModel.model_validate({"start": {"x": 0.05}, **ALL}))
    assert list(wider.pose_error) == [0.05, 0.05, 0.02]


def test_missions_are_proved_within_a_pose_error_and_a_bias_and_hold_the_runs_of_an_oracle(tmp_path):
    path = tmp_path / "hall.yaml"
    path.write_text(MAP, encoding="utf-8")
    hall = viatool.load_map(path)
    dodging = viatool.load_policy(write_dodging_policy(tmp_path / "dodging.onnx"))
    terms = {"sensor": {"lidar": {"bias": 0.01, "relative": 0.005}}, "pose": {"x": 0.01, "theta": 0.01}}
    errors = ErrorModel.model_validate(terms)
    (one,) = viatool.mission(dodging, hall, eps=0.005, scenarios=hall.scenarios[:1], errors=errors)
    assert one.verdict == "proved"
    count, generator = 900, np.random.default_rng(1)
    own = sensor_errors(generator, Setting.of(dodging, hall, 0.005).radii, count, one.steps)
    own[:, :, :20] += 0.01 * drawn(generator, count, one.steps, 1)
    starts = np.repeat([one.scenario.start], count, axis=0), np.zeros((count, 2))
    found, _ = runs(
        *(dodging, hall, one.scenario, starts, own),
        shares=np.repeat([0.005, 0.0], [20, own.shape[2] - 20])
        * drawn(generator, count, one.steps, own.shape[2]),
        astray=np.array([0.01, 0.0, 0.01]) * drawn(generator, count, one.steps, 3),
    )
    away = np.hypot(*np.moveaxis(found[:, :, :2] - np.array(one.scenario.goal), 2, 0))
    assert (away < 0.5).any(axis=1).all()
    for k in range(one.proof.earliest - 1):
        parts = one.proof.tube.step == k + 1
        poses = found[:, k][:, None]
        over = np.maximum(one.proof.tube.lower[parts, :3] - poses, poses - one.proof.tube.upper[parts, :3])
        assert over.max(axis=2).min(axis=1).max() < 1e-7


def test_terms_that_are_not_followed_over_time_are_refused_by_name():
    for terms, named in (
        ({"actuation": {"linear_acceleration": {"absolute": 0.1}}}, "actuation.linear_acceleration"),
        ({"obstacles": {"returns": 0.1}}, "obstacles.returns"),
    ):
        with pytest.raises(ConfigurationError, match=named):
            viatool.verify(POLICY, LAB, eps=EPS, errors=ErrorModel.model_validate(terms), horizon=2)
