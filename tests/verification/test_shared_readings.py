"""Bounds of commands where one reading stands in several frames: it errs once, and no other frame errs with it."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

import viatool
from viatool.policy import Activation, Affine, Input, Network, PolicySpecification, load_policy, write_onnx
from viatool.policy.activations import activation
from viatool.safety import ScenePoses
from viatool.setting.setting import Setting
from viatool.setting.wishes import Wishes
from viatool.simulate import Places, drive, observe_places, roll_out
from viatool.trajectory import Trajectory, load_trajectory, write_trajectory
from viatool.uncertainty import ErrorModel
from viatool.verification import states as states_module
from viatool.verification.observing import BlockSensors
from viatool.verification.states import States
from viatool.world import load_map

MAP = """\
schema_version: 1
arena: {shape: box, center: [0, 0], size: [8, 8]}
robot: {footprint: {shape: point}, control_interval: 0.1, min_linear: -9.0, max_linear: 9.0, max_angular: 9.0}
clearance: {collision: 0.4, danger: 0.5}
scenarios: [{name: hall, start: [0.5, 0.0, 0.3], goal: [-1.0, 2.0]}]
"""
FRAMES = {"count": 3, "stride": 1, "order": "oldest_first"}
EPS = {"scan": 0.04, "far": 0.1, "angle": 0.03}
ERRORS = {"sensor": {"scan": {"relative": 0.02, "bias": 0.05}, "far": {"bias": 0.06}}}
MISSING = {"sensor": {"scan": {"bias": 0.05, "missing": 1}}}
READINGS, AGES = 6, np.array([2, 1, 0])
"""Of one instant: four bins, distance and bearing of the goal; and how old the frames are."""


@lru_cache(maxsize=1)
def world(folder: Path):
    (folder / "hall.yaml").write_text(MAP)
    return load_map(folder / "hall.yaml")


def policy_of(folder: Path, seed: int = 3):
    """A small random network over three frames that compares what it sees now with what it saw before."""
    lidar = {"field_of_view": 3.0, "rays": 8, "bins": 4, "maximum_range": 6.0}
    spec = PolicySpecification.model_validate(
        {
            "schema_version": 2,
            "control_interval": 0.1,
            "frames": FRAMES,
            "observation": [
                {
                    "name": "scan",
                    "kind": "lidar",
                    "lidar": lidar,
                    "scale": 0.2,
                    "offset": -0.1,
                    "clip": [-1, 1],
                },
                {"name": "far", "kind": "goal_distance", "unit": "m"},
                {"name": "angle", "kind": "goal_bearing", "unit": "rad"},
            ],
            "action": [
                {"name": "v", "unit": "m/s", "kind": "linear", "lower": -9.0, "upper": 9.0},
                {"name": "omega", "unit": "rad/s", "kind": "angular", "lower": -9.0, "upper": 9.0},
            ],
        }
    )
    rng = np.random.default_rng(seed)
    now = rng.normal(size=(24, READINGS))
    change = np.hstack([0.5 * now, -1.2 * now, 0.75 * now])
    nodes = (
        Input(3 * READINGS),
        Affine((0,), (change.astype(np.float32).astype(float),), np.zeros(24)),
        Activation(1, activation("Tanh"), 24),
        Affine((2,), (rng.normal(size=(2, 24)).astype(np.float32).astype(float) * 0.25,), np.full(2, 0.125)),
    )
    write_onnx(Network(nodes), spec, folder / "policy.onnx")
    return load_policy(folder / "policy.onnx")


def sensors_of(policy, folder: Path, trajectory: Trajectory, errors: ErrorModel) -> BlockSensors:
    setting = Setting.of(policy, world(folder), EPS, Wishes("swept", errors=errors), job="verify")
    states = States.of(trajectory, np.zeros((len(trajectory), 0, 2)))
    scenes = ScenePoses.of(setting.world_map, trajectory.scenarios, trajectory.poses, trajectory.episode)
    return BlockSensors(setting, states, scenes)


def bounds(policy, folder: Path, trajectory: Trajectory, errors: ErrorModel):
    every = np.ones(len(trajectory), dtype=bool)
    return sensors_of(policy, folder, trajectory, errors).reach(policy, {}, every, ~every)


def sampled(trajectory: Trajectory, errors: dict, first: np.ndarray, count: int = 400) -> np.ndarray:
    """Observations (B, count, 18) in which frame i holds the reading of frame ``first[:, i]``, as the docs say."""
    rng, batch = np.random.default_rng(5), len(trajectory)
    seen = trajectory.observations.reshape(batch, 1, 3, READINGS)
    scale, offset = np.array([0.2] * 4 + [1.0] * 2), np.array([-0.1] * 4 + [0.0] * 2)
    readings = (seen - offset) / scale
    terms = [(EPS["scan"], "scan")] * 4 + [(EPS["far"], "far"), (EPS["angle"], "angle")]
    told = errors.get("sensor", {})
    radius = np.array([eps for eps, _ in terms])
    share, bias = (
        np.array([told.get(name, {}).get(key, 0.0) for _, name in terms]) for key in ("relative", "bias")
    )
    shape = (batch, count, 3, READINGS)
    extreme = rng.random(shape[:2])[..., None, None] < 0.7

    def drawn(size: tuple[int, ...]) -> np.ndarray:
        free = rng.uniform(-1.0, 1.0, size)
        return np.where(extreme, np.sign(free), free) * (1.0 - 1e-6)

    common = drawn((batch, count, 3, 2))[..., [0, 0, 0, 0, 1, 1]]
    off = readings + drawn(shape) * (radius + share * np.abs(readings)) + common * bias
    if bias[:4].any():
        off[..., :4] = np.clip(off[..., :4], 0.0, 6.0)
    if told.get("scan", {}).get("missing"):
        lost = np.arange(4) == rng.integers(-1, 4, size=(batch, count, 3, 1))
        off[..., :4] = np.where(lost, 6.0, off[..., :4])
    taken = scale * off + offset
    taken[..., :4] = np.clip(taken[..., :4], -1.0, 1.0)
    every = np.take_along_axis(taken, np.broadcast_to(first[:, None, :, None], shape), axis=2)
    return every.reshape(batch, count, 3 * READINGS)


def outside(policy, reached, observations: np.ndarray) -> np.ndarray:
    """Tell for which states (B,) onnxruntime leaves the bounds at some observation."""
    actions = policy.run(observations.reshape(-1, observations.shape[2]))
    actions = actions.reshape(*observations.shape[:2], 2)
    inside = (actions >= reached.lower[:, None]) & (actions <= reached.upper[:, None])
    return ~inside.all(axis=(1, 2))


def first_frames(steps: np.ndarray) -> np.ndarray:
    """Which frame first holds the reading of each, (B, 3): those from before the beginning hold the first reading."""
    age = np.minimum(AGES, steps[:, None])
    return (age[:, :, None] == age[:, None, :]).argmax(axis=2)


@pytest.mark.parametrize("errors", [{}, ERRORS, MISSING], ids=["eps", "bias", "missing"])
def test_bounds_hold_what_a_reading_in_several_frames_errs_and_little_else(tmp_path, errors):
    policy, model = policy_of(tmp_path), ErrorModel.model_validate(errors)
    driven = roll_out(policy, world(tmp_path), horizon=4, noise=0.0)
    assert driven.steps.tolist() == [0, 1, 2, 3]
    reached = bounds(policy, tmp_path, driven, model)
    free = bounds(policy, tmp_path, replace(driven, steps=None), model)
    first = first_frames(driven.steps)
    assert first.tolist() == [[0, 0, 0], [0, 0, 2], [0, 1, 2], [0, 1, 2]]
    assert not outside(policy, reached, sampled(driven, errors, first)).any()
    apart = np.broadcast_to(np.arange(3), first.shape)
    loose = outside(policy, reached, sampled(driven, errors, apart))
    assert loose.tolist() == [True, True, False, False]  # a reading that contradicts itself is left out
    share = reached.width / free.width
    assert (share[0] < 0.35).all()
    assert (share[1] < 0.95).all()
    assert (share[2:] > 0.999).all()


def test_frames_that_are_not_known_to_be_one_reading_err_each_by_itself(tmp_path, monkeypatch):
    """A recording may begin anywhere: where its first frames happen to be equal they may still be three readings."""
    policy = policy_of(tmp_path)
    driven = roll_out(policy, world(tmp_path), horizon=4, noise=0.0)
    recorded = replace(driven, steps=None)
    apart = np.broadcast_to(np.arange(3), (4, 3))
    observations = sampled(recorded, {}, apart)
    assert not outside(policy, bounds(policy, tmp_path, recorded, ErrorModel()), observations).any()
    # an episode of which the beginning was left out keeps what it knows
    late = driven.select(np.array([2, 3]))
    assert not outside(policy, bounds(policy, tmp_path, late, ErrorModel()), observations[2:]).any()
    rows = states_module._rows_of_episodes
    monkeypatch.setattr(states_module, "_steps_of_episodes", lambda states: rows(states).astype(float))
    assert outside(policy, bounds(policy, tmp_path, recorded, ErrorModel()), observations)[0]


def test_recorded_numbers_that_differ_are_different_readings(tmp_path):
    policy = policy_of(tmp_path)
    driven = roll_out(policy, world(tmp_path), horizon=1, noise=0.0)
    observations = driven.observations.copy()
    observations[:, :READINGS] += 0.01
    torn = replace(driven, observations=observations)
    reached = bounds(policy, tmp_path, torn, ErrorModel())
    assert not outside(policy, reached, sampled(torn, {}, np.array([[0, 1, 1]]))).any()


def test_where_what_came_before_is_known(tmp_path):
    """In simulations and at picked poses; an adversary takes another reading than the one that filled the stack."""
    policy, hall = policy_of(tmp_path), world(tmp_path)
    setting = Setting.of(policy, hall, 0.01, Wishes("swept"))
    assert observe_places(policy, setting, Places(count=5)).steps.tolist() == [0] * 5
    driven = roll_out(policy, hall, horizon=4, noise=0.0)
    write_trajectory(tmp_path / "driven.npz", driven)
    assert load_trajectory(tmp_path / "driven.npz").steps.tolist() == [0, 1, 2, 3]
    errors = ErrorModel.model_validate({"sensor": {"far": {"absolute": 0.1}}})
    hostile = drive(policy, setting, horizon=3, noise=0.0, errors=errors, adversary=True).trajectory
    assert hostile.steps is None
    with pytest.raises(viatool.errors.TrajectoryError, match="'steps' holds -1 in row 2"):
        replace(driven, steps=np.array([0, 1, -1, 3]))


def test_steps_that_do_not_go_on_are_refused(tmp_path):
    """A robot that stands reads the same numbers again: counted as its first step, each would be the first reading."""
    policy, hall = policy_of(tmp_path), world(tmp_path)
    driven = roll_out(policy, hall, horizon=4, noise=0.0)
    for steps in ([0, 0, 0, 0], [0, 1, 1, 2], [3, 2, 1, 0]):
        with pytest.raises(viatool.errors.TrajectoryError, match=r"'steps' holds \d in row \d, no more than"):
            replace(driven, steps=np.array(steps))
    assert replace(driven, steps=np.zeros(4, np.int64), connected=False).steps.tolist() == [0] * 4
    assert driven.select(np.array([1, 1, 3])).steps.tolist() == [1, 1, 3]
