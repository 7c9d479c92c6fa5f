"""Rays are followed only as far as a network tells readings apart: no command is lost, jumps beyond cost nothing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from tests.loop.plant import Plant
from viatool import load_map
from viatool.channels import Quantities
from viatool.loop import closed_loop, told_apart
from viatool.loop.closed_loop import ClosedLoop
from viatool.sets.forms import PoseBoxes
from viatool.sets.states import StateBoxes
from viatool.setting.setting import Setting
from viatool.train.export import export_actor
from viatool.train.observation import ActorLayout, make_scaling, make_specification

LAB = load_map(Path("maps/lab.yaml"))
SCENARIO = LAB.scenarios[0]
RANGE, EPS = 1.5, 0.02


@pytest.fixture(scope="module")
def policy(tmp_path_factory):
    """A policy with large weights that sees 1.5 m far."""
    return seeing(RANGE, tmp_path_factory.mktemp("policy") / "near.onnx")


def seeing(far, path):
    """A policy with large weights that sees so far."""
    layout = ActorLayout(far, previous=False)
    scaling = make_scaling(LAB.robot, 10.0, layout)
    actor = scaling.actor((26, 26), 1, "relu").draw(torch.Generator().manual_seed(3), 3.0)
    return export_actor(actor, scaling, make_specification(LAB.robot, 0.0, {}, layout), path)


def sampled(generator, boxes, rounds):
    """Poses of boxes, often at their corners."""
    for _ in range(rounds):
        z = generator.uniform(-1.0, 1.0, boxes.centre.shape)
        yield boxes.centre + boxes.radius * np.where(generator.random(z.shape) < 0.5, np.sign(z), z)


def beyond(policy, rounds=40):
    """By how much commands of the program lie outside the bounds of their cells, in the worst case."""
    generator = np.random.default_rng(1)
    loop = ClosedLoop.of(policy, Setting.of(policy, LAB, EPS), SCENARIO)
    plant = Plant(policy, LAB, SCENARIO, EPS)
    centre = generator.uniform((-4, -4, -3), (4, 4, 3), (600, 3))
    free = loop.geometry.still.clearance(centre[:, :2], np.zeros(len(centre), np.int64)) > 0.3
    boxes = PoseBoxes(centre[free][:150], np.tile([0.02, 0.02, 0.02], (150, 1)))
    still = np.zeros((150, 2))
    pieces = loop.commands(StateBoxes(boxes, still, still)).pieces
    worst, errs = -np.inf, np.full(24, EPS)
    errs[-1] = 0.0
    for poses in sampled(generator, boxes, rounds):
        readings = plant.readings(np.hstack([poses, still]))
        signs = generator.choice([-1.0, 0.0, 1.0], readings.shape)
        sent = policy.run((readings + signs * errs).astype(np.float32).astype(np.float64))
        worst = max(worst, np.max(sent - pieces.upper), np.max(pieces.lower - sent))
    return worst


def test_every_command_is_within_the_bounds(policy):
    assert beyond(policy) <= 1e-6


def test_a_limit_that_is_too_near_is_noticed(policy, monkeypatch):
    honest = told_apart.ceilings
    monkeypatch.setattr(told_apart, "ceilings", lambda network: 0.8 * honest(network))
    assert beyond(policy) > 1e-3


def test_rays_are_followed_beyond_the_ceiling_by_what_they_err(policy):
    loop = ClosedLoop.of(policy, Setting.of(policy, LAB, EPS), SCENARIO)
    ((lidar, _),) = loop.sensors.quantities.lidars
    assert RANGE + EPS < lidar.farthest < RANGE + EPS + 1e-3


def test_a_network_that_tells_nothing_apart_that_its_lidar_reads_is_followed(tmp_path):
    assert beyond(seeing(0.1, tmp_path / "blind.onnx"), rounds=3) <= 1e-6


def test_what_jumps_beyond_the_range_moves_no_bound(policy, monkeypatch):
    setting = Setting.of(policy, LAB, 0.01)
    near = ClosedLoop.of(policy, setting, SCENARIO)
    monkeypatch.setattr(closed_loop, "as_far_as_told_apart", lambda observed, *_: observed)
    far = ClosedLoop.of(policy, setting, SCENARIO)
    centre = np.random.default_rng(2).uniform((-2, -2, -3), (2, 2, 3), (300, 3))
    boxes = PoseBoxes(centre, np.tile([0.02, 0.02, 0.02], (300, 1)))
    still = np.zeros((300, 2))
    widths = []
    for loop in (near, far):
        pieces = loop.commands(StateBoxes(boxes, still, still)).pieces
        widths.append((pieces.upper - pieces.lower).mean(axis=0))
    assert (widths[0] <= 0.9 * widths[1]).all()


@pytest.mark.parametrize(
    ("change", "looks"),
    [({}, RANGE), ({"reduce": "first"}, RANGE), ({"reduce": "mean"}, np.inf), ({"no_return": 0.0}, np.inf)],
)
def test_what_a_shorter_ray_would_change_is_followed_to_the_end(change, looks):
    layout = ActorLayout()
    channel = make_specification(LAB.robot, 0.0, {}, layout).observation[0]
    assert channel.lidar is not None
    changed = channel.model_copy(update={"lidar": channel.lidar.model_copy(update=change)})
    observed = Quantities.of([changed], LAB.robot).up_to(np.full(changed.size, RANGE))
    assert observed.lidars[0][0].farthest == looks


def test_a_clipped_channel_is_followed_to_the_end():
    channel = make_specification(LAB.robot, 0.0, {}, ActorLayout()).observation[0]
    scaled = channel.model_copy(update={"scale": 0.5})
    observed = Quantities.of([scaled], LAB.robot).up_to(np.full(scaled.size, RANGE))
    assert observed.lidars[0][0].farthest == np.inf
