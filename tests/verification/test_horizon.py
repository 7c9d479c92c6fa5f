"""What is told of the intervals after a state: verdicts, runs that fail, and that nobody's work changes them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.loop.noisy_runs import arc
from tests.sight.ray_oracle import outlines, scan
from viatool.errors import ConfigurationError
from viatool.loop.horizon import Horizon
from viatool.policy import load_policy
from viatool.simulate import roll_out
from viatool.uncertainty import ErrorModel
from viatool.verification import verify
from viatool.world import Scenes, load_map

LAB, EPS = load_map("maps/lab.yaml"), 0.05
POLICY = load_policy("policies/via.onnx")
HORIZON = Horizon(4, 0.01, 0.02, sector=0.01, parts=12)
NEAR = {"eps": EPS, "clearance": 0.6, "danger": 0.7, "horizon": HORIZON}


@pytest.fixture(scope="module")
def driven():
    """The states of the lab that come nearest to obstacles, in which some runs fail, and some far ones."""
    whole = roll_out(POLICY, LAB, seed=0)
    scenes = Scenes.of(LAB, whole.scenarios)
    near = scenes.clearance(whole.poses[:, :2], whole.episode).argsort()
    kept = np.zeros(len(whole), dtype=bool)
    kept[near[:120]] = kept[near[-20:]] = True
    return whole.select(kept)


@pytest.fixture(scope="module")
def result(driven):
    return verify(POLICY, LAB, trajectory=driven, **NEAR)


def test_states_are_safe_unsafe_and_unknown_over_the_horizon(result):
    report = result.to_json()["horizon"]
    assert set(result.horizon.verdict) == {"safe", "unsafe", "unknown"}
    assert report["verdicts"] == {
        name: int((result.horizon.verdict == name).sum()) for name in report["verdicts"]
    }
    safe = [rate["safe"] for rate in report["safety_rate"]]
    assert safe == sorted(safe, reverse=True)
    assert safe[-1] == report["verdicts"]["safe"]
    assert len(safe) == len(report["least_clearance"]) == len(report["width"]["heading"]["median"]) == 4
    table = result.state_table(slice(10, 30))
    assert table["tube_lower"].shape == (20, 4, 3)
    assert ((table["horizon_steps"] == 4) == (table["horizon_verdict"] == "safe")).all()


def test_every_run_that_fails_is_one_that_sensors_allow(result, driven):
    """Observations lie within eps of the oracle's, commands are onnxruntime's, and the last one comes too near."""
    found, radii = result.horizon.crashes, POLICY.spec.radii(EPS)
    assert len(found) > 3
    for row, state in enumerate(found.state):
        scenario = driven.scenarios[driven.episode[state]]
        off = np.abs(found.poses[row, 0] - driven.poses[state])
        assert (off <= HORIZON.pose_error + 1e-12).all()
        pose, before = found.poses[row, :1], driven.observations[state, 23:25]
        for k in range(found.step[row] + 1):
            seen = found.observations[row, k]
            dx, dy = np.array(scenario.goal) - pose[0, :2]
            bearing = np.arctan2(dy, dx) - pose[0, 2]
            rest = [np.hypot(dx, dy), np.cos(bearing), np.sin(bearing), *before, 0.0]
            exact = np.concatenate([scan(pose, LAB.robot.lidar, outlines(LAB, scenario))[0], rest])
            assert (np.abs(seen - exact) <= radii).all()
            before = np.clip(POLICY.run(seen[None])[0], [0.0, -1.0], [0.5, 1.0]).astype(float)
            np.testing.assert_array_equal(before, found.actions[row, k])
            begin, pose = pose, arc(pose, before[None], 0.1)
        path = np.concatenate([arc(begin, before[None], t) for t in np.linspace(0.0, 0.1, 65)])
        scenes = Scenes.of(LAB, [scenario])
        assert scenes.clearance(path[:, :2], np.zeros(65, np.int64)).min() < 0.6
        assert found.clearance[row] < 0.6


def assert_same(one, other):
    for part in ("tubes", "crashes"):
        for name, array in vars(getattr(one.horizon, part)).items():
            np.testing.assert_array_equal(getattr(getattr(other.horizon, part), name), array, err_msg=name)


def test_workers_chunks_and_checkpoints_change_nothing(result, driven, tmp_path):
    assert_same(
        result, verify(POLICY, LAB, trajectory=driven, **NEAR, workers=2, chunk=1, checkpoint=tmp_path)
    )
    assert_same(result, verify(POLICY, LAB, trajectory=driven, **NEAR, checkpoint=tmp_path, resume=True))
    other = NEAR | {"horizon": 4}
    with pytest.raises(ConfigurationError, match="horizon"):
        verify(POLICY, LAB, trajectory=driven, **other, checkpoint=tmp_path, resume=True)


def test_states_out_of_reach_need_no_tube(result, driven):
    fast = verify(POLICY, LAB, trajectory=driven, **NEAR, only_contested=True)
    np.testing.assert_array_equal(fast.horizon.verdict, result.horizon.verdict)
    followed = np.isfinite(fast.horizon.tubes.clearance).all(axis=1)
    assert 0 < (~followed).sum() < len(driven)
    np.testing.assert_array_equal(fast.horizon.tubes.lower[followed], result.horizon.tubes.lower[followed])


def test_what_a_horizon_cannot_be_asked_for_is_refused(driven):
    few = driven.select(np.arange(len(driven)) < 3)
    without = replace(few, scenarios=(None,) * few.episodes)
    with pytest.raises(ConfigurationError, match="goal"):
        verify(POLICY, LAB, trajectory=without, eps=EPS, horizon=2)
    for steps in (0, 1001):
        with pytest.raises(ConfigurationError, match="horizon"):
            Horizon(steps)
    with pytest.raises(ConfigurationError, match="heading"):
        Horizon(3, 0.0, -0.1)


def test_a_horizon_takes_a_delay_as_an_error_model_states_it(driven):
    few = driven.select(np.arange(len(driven)) < 20)
    stated = ErrorModel.model_validate({"timing": {"delay": [0.05, 0.05]}})
    given, model, ideal = (
        verify(POLICY, LAB, trajectory=few, eps=EPS, horizon=2, **delayed).horizon.tubes
        for delayed in ({"delay": 0.05}, {"errors": stated}, {})
    )
    np.testing.assert_array_equal(given.lower, model.lower)
    assert np.abs(given.lower - ideal.lower).max() > 1e-3
    sampled = verify(POLICY, LAB, trajectory=few, eps=EPS, horizon=2, delay=0.05, criterion="sampled")
    np.testing.assert_array_equal(sampled.horizon.tubes.lower, given.lower)


def test_a_report_without_a_horizon_has_none(driven):
    few = driven.select(np.arange(len(driven)) < 3)
    found = verify(POLICY, LAB, trajectory=few, eps=EPS)
    assert "horizon" not in found.to_json()
    assert "tube_lower" not in found.state_table()
