from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.sight.ray_oracle import outlines, scan
from viatool import load_map, load_policy
from viatool.channels import goal_forms
from viatool.loop.closed_loop import ClosedLoop
from viatool.sets.forms import PoseBoxes
from viatool.sets.states import StateBoxes
from viatool.setting.setting import Setting
from viatool.setting.wishes import Wishes

LAB, POLICY = load_map(Path("maps/lab.yaml")), load_policy(Path("policies/via.onnx"))
SCENARIO = LAB.scenarios[0]
EPS = 0.01


def question():
    return ClosedLoop.of(POLICY, Setting.of(POLICY, LAB, EPS, Wishes("braking")), SCENARIO)


def cells(generator, count=150, side=0.03):
    """StateBoxes where the robot may stand, some of them around the goal."""
    centre = generator.uniform((-4.4, -4.4, -3.0), (4.4, 4.4, 3.0), (10 * count, 3))
    centre[::9, :2] = np.array(SCENARIO.goal) + generator.uniform(-0.1, 0.1, (len(centre[::9]), 2))
    asked = question()
    free = asked.geometry.still.clearance(centre[:, :2], np.zeros(len(centre), np.int64)) > 0.4
    centre = centre[free][:count]
    lower = generator.uniform((0.0, -1.0), (0.4, 0.6), (count, 2))
    radius = np.tile([side, side, side], (count, 1))
    return StateBoxes(PoseBoxes(centre, radius), lower, lower + np.array([0.1, 0.4]))


def sampled(generator, some):
    """A pose and a previous command of each cell, and what perfect sensors read there, by school formulas."""
    z = generator.uniform(-1, 1, (len(some), 5))
    z[: len(some) // 2] = np.sign(z[: len(some) // 2])
    poses = some.poses.centre + z[:, :3] * some.poses.radius
    half = 0.5 * (some.previous_upper - some.previous_lower)
    previous = some.previous_lower + (1.0 + z[:, 3:]) * half
    dx, dy = np.array(SCENARIO.goal)[:, None] - poses[:, :2].T
    bearing = np.arctan2(dy, dx) - poses[:, 2]
    readings = scan(poses, LAB.robot.lidar, outlines(LAB, SCENARIO))
    rest = [np.hypot(dx, dy), np.cos(bearing), np.sin(bearing), *previous.T, np.zeros(len(some))]
    return z, np.hstack([readings, np.stack(rest, axis=1)])


def excess(generator, some, rounds=10):
    forms = replace(question().sensors, radii=None).enclose(some).forms
    worst = -np.inf
    for _ in range(rounds):
        z, seen = sampled(generator, some)
        linear = forms.centre + np.einsum("cj,cjn->cn", z, forms.slope)
        worst = max(worst, float((np.abs(seen - linear) - forms.rest).max()))
    return worst


@pytest.mark.parametrize("side", [0.003, 0.03, 0.12])
def test_every_column_lies_within_its_form(side):
    generator = np.random.default_rng(0)
    assert excess(generator, cells(generator, side=side)) <= 1e-8


def test_goal_columns_are_nearly_linear_away_from_the_goal():
    generator = np.random.default_rng(1)
    some = cells(generator, side=0.01)
    forms = replace(question().sensors, radii=None).enclose(some).forms
    far = np.hypot(*(some.poses.centre[:, :2] - SCENARIO.goal).T) > 1.0
    assert forms.rest[far][:, 20:23].max() < 5e-4


@pytest.mark.parametrize("exponent", ["square"])
def test_sampling_catches_goal_forms_without_their_second_order(monkeypatch, exponent):
    class Linear:
        def __getattr__(self, name):
            return getattr(np, name)

        @staticmethod
        def square(x):
            return 0.0 * np.asarray(x)

    monkeypatch.setattr(goal_forms, "np", Linear())
    generator = np.random.default_rng(2)
    assert excess(generator, cells(generator, side=0.05)) > 1e-4


def commands_outside(asked, generator, some, radii):
    """By how much the commands of onnxruntime, for errors within radii, leave their bounds at most."""
    found, worst = asked.commands(some), -np.inf
    for _ in range(12):
        _, seen = sampled(generator, some)
        error = generator.uniform(-1, 1, seen.shape)
        error[::2] = np.sign(error[::2])
        carried_out = asked.rules.clip(POLICY.run((seen + error * radii).astype(np.float32)))
        outside = np.maximum(carried_out - found.upper, found.lower - carried_out)
        worst = max(worst, float(outside.max()))
    return worst


def test_commands_lie_within_their_bounds_whatever_the_sensors_err():
    generator = np.random.default_rng(3)
    asked = question()
    for side in (0.005, 0.02):
        assert commands_outside(asked, generator, cells(generator, side=side), asked.setting.radii) <= 0.0


def test_onnxruntime_catches_bounds_that_forget_the_sensor_error():
    generator, asked = np.random.default_rng(4), question()
    radii = asked.setting.radii.copy()
    asked.setting.radii[:] = 0.0
    assert commands_outside(asked, generator, cells(generator, side=0.002), radii) > 0.0
