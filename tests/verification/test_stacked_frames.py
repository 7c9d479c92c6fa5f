"""Frames that hold one reading share its error: a counterexample gives both the same number."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import viatool
from viatool.channels.inputs import Inputs
from viatool.policy import ActionChannel, Affine, Input, Network, PolicySpecification, load_policy, write_onnx
from viatool.safety import witness
from viatool.simulate import Places, roll_out
from viatool.world import load_map

MAP = """\
schema_version: 1
arena: {shape: box, center: [0, 0], size: [4, 4]}
robot: {footprint: {shape: point}, control_interval: 0.1}
clearance: {collision: 0.4, danger: 0.5}
scenarios: [{name: wall, start: [1.57, 0.0, 0.0], goal: [-1.0, 0.0]}]
"""
EPS = 0.05


def asked(folder: Path, gain: float = 10.0):
    """A robot before a wall that drives ahead as fast as the goal seems farther now than two steps ago."""
    path = folder / "square.yaml"
    path.write_text(MAP)
    frames = {"count": 2, "stride": 2, "order": "newest_first"}
    spec = PolicySpecification.model_validate(
        {
            "schema_version": 2,
            "control_interval": 0.1,
            "observation": [{"name": "far", "kind": "goal_distance", "unit": "m", "frames": frames}],
            "action": [
                ActionChannel(name="v", unit="m/s", lower=0.0, upper=0.5, kind="linear"),
                ActionChannel(name="omega", unit="rad/s", lower=-1.0, upper=1.0, kind="angular"),
            ],
        }
    )
    weight = np.array([[gain, -gain], [0.0, 0.0]])
    write_onnx(Network((Input(2), Affine((0,), (weight,), np.zeros(2)))), spec, folder / "policy.onnx")
    return load_policy(folder / "policy.onnx"), load_map(path)


def test_a_reading_never_contradicts_itself(tmp_path):
    """At picked poses, and as long as the stack reaches beyond the beginning, both frames are one reading."""
    policy, world = asked(tmp_path)
    places = viatool.verify(policy, world, eps=EPS, places=Places(count=400))
    assert (places.verdict == "safe").all()  # it stands still, whatever the sensor errs
    driven = roll_out(policy, world, horizon=5, noise=0.0)
    result = viatool.verify(policy, world, eps=EPS, trajectory=driven)
    assert result.verdict.tolist() == ["safe", "unsafe", "unsafe", "unsafe", "unsafe"]


def test_of_a_recording_nothing_tells_what_came_before_its_first_state(tmp_path):
    """Frames may be different readings then, also of one number: no proof, and no counterexample either."""
    policy, world = asked(tmp_path)
    driven = roll_out(policy, world, horizon=5, noise=0.0)
    result = viatool.verify(policy, world, eps=EPS, trajectory=replace(driven, steps=None))
    assert result.verdict.tolist() == ["unknown", "unsafe", "unsafe", "unsafe", "unsafe"]
    late = viatool.verify(policy, world, eps=EPS, trajectory=driven.select(np.arange(2, 5)))
    assert late.verdict.tolist() == ["unsafe"] * 3


def test_a_search_that_forgets_it_finds_what_cannot_be(tmp_path, monkeypatch):
    monkeypatch.setattr(witness, "_of_one_reading", lambda points, shared: points)
    with pytest.raises(AssertionError):
        test_of_a_recording_nothing_tells_what_came_before_its_first_state(tmp_path)


def test_a_counterexample_of_one_reading_is_found_by_its_first_or_its_last_frame(tmp_path):
    """The newest frame alone speeds up; the other must follow, and does not matter."""
    policy, world = asked(tmp_path)
    weight = np.array([[0.5, 0.0], [0.0, 0.0]])
    network = Network((Input(2), Affine((0,), (weight,), np.array([-1.25, 0.0]))))
    write_onnx(network, policy.spec, tmp_path / "other.onnx")
    policy = load_policy(tmp_path / "other.onnx")
    driven = roll_out(policy, world, horizon=3, noise=0.0)
    result = viatool.verify(policy, world, eps=1.0, trajectory=driven)
    assert result.verdict[0] == "unsafe"
    row = result.witnesses.observation[0]
    assert row[0] == row[1]


def test_which_inputs_hold_one_reading():
    """Both before the beginning of the episode; of the same reading, and the same number."""
    spec = PolicySpecification.model_validate(
        {
            "schema_version": 2,
            "frames": {"count": 3, "stride": 2, "order": "oldest_first"},
            "observation": [
                {"name": "far", "kind": "goal_distance"},
                {"name": "angle", "kind": "goal_bearing"},
            ],
            "action": [ActionChannel(name="v", kind="linear", lower=0.0, upper=1.0)],
        }
    )
    inputs = Inputs.of(spec.observation, spec.frames)
    assert inputs.age.tolist() == [4, 4, 2, 2, 0, 0]
    same, others = [3.0, 0.1, 3.0, 0.1, 3.0, 0.1], [3.0, 0.2, 3.0, 0.1, 3.0, 0.1]
    found = inputs.shared(np.array([same, same, same, same, others]), np.array([0, 1, 2, 4, 0]))
    assert found.tolist() == [
        [0, 1, 0, 1, 0, 1],
        [0, 1, 0, 1, 4, 5],
        [0, 1, 0, 1, 4, 5],
        [0, 1, 2, 3, 4, 5],
        [0, 1, 0, 3, 0, 3],
    ]
