"""Errors over sets of poses: what the network takes, and what it commands, anywhere in cells."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import viatool
from viatool.channels import Quantities
from viatool.channels.erring import Erring
from viatool.loop.closed_loop import ClosedLoop
from viatool.places import SearchBudget, certify
from viatool.sets.forms import PoseBoxes
from viatool.sets.states import StateBoxes
from viatool.setting.setting import Setting
from viatool.setting.wishes import Wishes
from viatool.uncertainty import ErrorModel

LAB = viatool.load_map("maps/lab.yaml")
SCENARIO = LAB.scenarios[0]
POLICY = viatool.load_policy("via")
ALL = {
    "sensor": {
        "lidar": {"absolute": 0.01, "relative": 0.03, "bias": 0.05},
        "goal_distance": {"relative": 0.02},
    },
    "pose": {"x": 0.04, "y": 0.02, "theta": 0.03},
}
SIZES = np.array([0.04, 0.02, 0.03])


def loop_of(model):
    errors = ErrorModel.model_validate(model)
    setting = Setting.of(
        POLICY,
        LAB,
        {"": 0.005} | ({} if "sensor" in model else {"lidar": 0.01}),
        Wishes(errors=errors),
        job="certify",
    )
    return ClosedLoop.of(POLICY, setting, SCENARIO)


def cells_at(loop, count=60, side=0.02):
    generator = np.random.default_rng(4)
    poses = generator.uniform((-4.5, -4.5, -3.2), (4.5, 4.5, 3.2), (20 * count, 3))
    free = loop.geometry.still.clearance(poses[:, :2], np.zeros(len(poses), np.int64)) > 0.45
    poses = poses[free][:count]
    lower = generator.uniform((0.0, -1.0), (0.4, 0.6), (len(poses), 2))
    return StateBoxes(
        PoseBoxes(poses, generator.uniform(0.2, 1.0, (len(poses), 3)) * side), lower, lower + 0.05
    )


def goal_seen(poses):
    away = (np.array(SCENARIO.goal) - poses[:, :2]) @ [1.0, 1j]
    turned = away / np.abs(away) * np.exp(-1j * poses[:, 2])
    return np.stack([np.abs(away), turned.real, turned.imag], axis=1)


def escapes(bounds, cells, loop, tries=40, only=("relative", "common", "pose")):
    """By how much commands of onnxruntime leave those of cells at most, errors of all terms drawn."""
    generator, worst = np.random.default_rng(0), -np.inf

    def unit(*shape):
        drawn = generator.uniform(-1, 1, shape)
        return np.where(generator.random(shape) < 0.6, np.sign(drawn), drawn)

    count = len(cells)
    for _ in range(tries):
        poses = cells.poses.centre + unit(count, 3) * cells.poses.radius
        previous = cells.previous_lower + (0.5 + 0.5 * unit(count, 2)) * (
            cells.previous_upper - cells.previous_lower
        )
        seen = loop.sensors.read(poses, previous)
        seen[:, 20:23] = goal_seen(poses + unit(count, 3) * SIZES * ("pose" in only))
        seen[:, 20] *= 1.0 + 0.02 * unit(count) * ("relative" in only)
        seen[:, :20] *= 1.0 + 0.03 * unit(count, 20) * ("relative" in only)
        seen[:, :20] += 0.05 * unit(count, 1) * ("common" in only) + 0.01 * unit(count, 20)
        seen[:, 20:25] += 0.005 * unit(count, 5)
        actions = loop.rules.clip(POLICY.run(seen.astype(np.float32).astype(float)))
        worst = max(worst, float(np.maximum(actions - bounds.upper, bounds.lower - actions).max()))
    return worst


class Ends:
    """The ends of the commands of cells."""

    def __init__(self, bounds):
        self.lower, self.upper = getattr(bounds, "lower", None), getattr(bounds, "upper", None)
        if self.lower is None:
            self.lower, self.upper = bounds.pieces.hull()


def test_no_command_leaves_the_bounds_of_its_cell():
    loop = loop_of(ALL)
    cells = cells_at(loop)
    assert escapes(Ends(loop.commands(cells)), cells, loop) <= 1e-12


@pytest.mark.parametrize("part", ["relative", "common", "pose"])
def test_onnxruntime_catches_errors_that_are_left_out(part):
    loop = loop_of(ALL)
    erring, cells = loop.sensors.radii, cells_at(loop, side=1e-3)
    assert isinstance(erring, Erring)
    none = {name: 0.0 * getattr(erring, name) for name in ("relative", "common", "pose")}
    for radii, caught in (
        (replace(erring, **{**none, part: getattr(erring, part)}), False),
        (replace(erring, **none), True),
    ):
        some = replace(loop, sensors=replace(loop.sensors, radii=radii))
        assert (escapes(Ends(some.commands(cells)), cells, loop, only=(part,)) > 1e-4) == caught


def test_no_term_changes_no_bit_and_a_common_bias_is_tighter_than_as_much_of_each():
    loop = loop_of({})
    cells = cells_at(loop)
    plain = Ends(replace(loop, sensors=replace(loop.sensors, radii=loop.setting.radii)).commands(cells))
    zero = Ends(
        loop_of(
            {"sensor": {"lidar": {"absolute": 0.01, "relative": 0.0, "bias": 0.0}}, "pose": {"x": 0.0}}
        ).commands(cells)
    )
    for name in ("lower", "upper"):
        np.testing.assert_array_equal(getattr(plain, name), getattr(zero, name))
    together, apart = (
        Ends(loop_of({"sensor": {"lidar": terms}}).commands(cells))
        for terms in ({"absolute": 0.005, "bias": 0.03}, {"absolute": 0.035})
    )
    widths = [ends.upper - ends.lower for ends in (together, apart)]
    assert widths[0][:, 1].mean() < 0.95 * widths[1][:, 1].mean()


def test_certify_takes_the_terms_and_says_so():
    knowing = [one.channel.name for one in Quantities.of(POLICY.spec.observation) if one.knows_its_pose]
    assert knowing == ["goal_distance", "goal_cosine", "goal_sine"]
    model = ErrorModel.model_validate(ALL)
    found, plain = (
        certify(
            POLICY,
            LAB,
            eps=0.005 if errors else {"": 0.005, "lidar": 0.01},
            errors=errors,
            budget=SearchBudget(share=0.0002),
        )
        for errors in (model, None)
    )
    told = {premise.name: premise.value for premise in found.premises}
    assert told["pose.theta"] == "0.03 rad"
    assert not np.array_equal(found.setting.pose_radii, plain.setting.pose_radii)
