"""A new kind through the public door: one class, and simulations, verdicts and certificates know it."""

from __future__ import annotations

import numpy as np
import pytest

from tests.channels.square import COLLISION, HALF, lidar, linear_policy, readings, square
from viatool import roll_out, verify
from viatool.channels import Quantity, kinds, observes, quantity
from viatool.errors import PolicyError
from viatool.places import Resolution, SearchBudget, certify
from viatool.policy import ObservationChannel
from viatool.sets.forms import Forms

VIEW, BINS = 1.0, 2


@pytest.fixture
def northing(monkeypatch):
    """The sine of the robot's heading in the map: 1 to the north."""
    monkeypatch.setattr(quantity, "_KINDS", dict(kinds()))

    @observes("northing")
    class Northing(Quantity):
        def measure(self, view):
            return np.sin(view.poses[:, 2])

        def enclose(self, view):
            theta = view.state("theta")
            spread = np.abs(theta.slope).sum(axis=1) + theta.rest
            slope = theta.slope * np.cos(theta.centre)[:, None]
            rest = 0.5 * np.square(spread) + theta.rest + 1e-12
            return Forms(np.sin(theta.centre), slope, rest)


def make(tmp_path):
    """As fast as it is turned to the north, minus what comes near ahead."""
    channels = [lidar("scan", VIEW, BINS), ObservationChannel(name="north", kind="northing")]
    rows = {("scan", 0): (0.3, 0.0), ("scan", 1): (0.3, 0.0), ("north", 0): (0.4, 0.2)}
    return linear_policy(tmp_path / "toy.onnx", channels, rows, bias=(-0.5, 0.0)), square(tmp_path)


def truth(poses):
    seen = readings(poses, VIEW, BINS)
    v = np.clip(0.3 * seen.sum(axis=1) + 0.4 * np.sin(poses[:, 2]) - 0.5, 0.0, 0.5)
    return v, np.clip(0.2 * np.sin(poses[:, 2]), -1.0, 1.0)


@pytest.mark.usefixtures("northing")
def test_a_toy_kind_is_driven_verified_and_certified(tmp_path):
    policy, world = make(tmp_path)
    driven = roll_out(policy, world, noise=0.0)
    np.testing.assert_allclose(driven.observations[:, BINS], np.sin(driven.poses[:, 2]), atol=1e-6)
    result = verify(policy, world, eps=0.001, trajectory=driven)
    v, w = truth(driven.poses)
    lower, upper = result.commands
    assert (lower[:, 0] <= v).all()
    assert (v <= upper[:, 0]).all()
    certificate = certify(
        policy, world, world.scenarios[0], eps=0.001, criterion="swept", resolution=Resolution(0.1, 0),
        budget=SearchBudget(share=0.05),
    )  # fmt: skip
    table = certificate.cell_table()
    proved = table["status"] == "certified"
    assert proved.sum() > 100
    generator = np.random.default_rng(0)
    lower, upper = (table[end][proved][:, :3] for end in ("lower", "upper"))
    for _ in range(20):
        poses = generator.uniform(lower, upper)
        v, w = truth(poses)
        heading = poses[:, 2] + 0.05 * w
        end = poses[:, :2] + 0.1 * v[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=1)
        free = HALF - np.abs(poses[:, :2]).max(axis=1) > COLLISION
        assert (HALF - np.abs(end).max(axis=1))[free].min() > COLLISION - 1e-3


@pytest.mark.usefixtures("northing")
def test_what_the_toy_lacks_is_refused_by_its_name():
    channel = ObservationChannel(name="north", kind="northing")
    with pytest.raises(PolicyError, match="'north' of kind 'northing' is not in a bag"):
        quantity.quantity_of(channel).require("record")


def test_the_toy_is_gone_afterwards():
    assert "northing" not in kinds()
