"""The registry of kinds, and what is refused by name."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from viatool.channels import Quantities, Quantity, kinds, observes
from viatool.errors import PolicyError
from viatool.policy import ObservationChannel, PolicySpecification
from viatool.world import ROBOTS

ROBOT = ROBOTS["turtlebot3"]


def test_the_kinds_are_these():
    assert sorted(kinds()) == [
        "angular_velocity", "budget", "constant", "goal_bearing", "goal_cosine", "goal_distance", "goal_sine", "goal_x",
        "goal_x_map", "goal_y", "goal_y_map", "heading", "heading_cosine", "heading_sine", "lateral_velocity", "lidar",
        "linear_velocity", "memory", "other", "pose_x", "pose_y", "previous_angular", "previous_lateral",
        "previous_linear", "previous_raw", "steps_left",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("typed", "meant"),
    [("lidr", "lidar"), ("goal_dist", "goal_distance"), ("previous_lin", "previous_linear")],
)
def test_an_unknown_kind_is_refused_with_the_nearest_one(typed, meant):
    with pytest.raises(ValidationError, match=f"kind '{typed}' is not known.*nearest is '{meant}"):
        ObservationChannel(name="a", kind=typed)


def test_every_kind_is_in_the_documentation():
    rows = [
        line.split("|")[1]
        for line in Path("docs/specification.md").read_text("utf-8").splitlines()
        if "|" in line
    ]
    assert {name for name in kinds() if f"`{name}`" not in " ".join(rows)} == set()


def test_a_kind_is_registered_once():
    with pytest.raises(ValueError, match="'lidar' is registered twice"):
        observes("lidar")(Quantity)


@pytest.mark.parametrize("part", ["measure", "record", "enclose", "bounds", "mirror"])
def test_a_part_that_a_kind_lacks_is_refused_by_channel_and_kind(part):
    channels = [
        ObservationChannel(name="far", kind="goal_distance"),
        ObservationChannel(name="imu", kind="other"),
    ]
    with pytest.raises(PolicyError, match="'imu' of kind 'other'") as raised:
        Quantities.of(channels, ROBOT).require(part)
    assert "`value`" in raised.value.hint
    with pytest.raises(PolicyError, match="'imu' of kind 'other'"):  # and where it would be used
        getattr(Quantities.of(channels, ROBOT).each[1], part)(*[None] * (part != "mirror"))


def test_a_fixed_channel_lacks_nothing():
    channels = [ObservationChannel(name="imu", kind="other", size=3, value=1.0)]
    observed = Quantities.of(channels, ROBOT).require("measure", "record", "enclose", "bounds", "mirror")
    assert observed.size == 3


def test_several_channels_of_a_kind_have_columns_of_their_own():
    spec = PolicySpecification(
        observation=[ObservationChannel(name=name, kind="goal_cosine") for name in ("a", "b")],
        action=[{"name": "v", "lower": 0.0, "upper": 1.0}],
    )
    assert Quantities.of(spec.observation).columns == (slice(0, 1), slice(1, 2))
    assert np.isnan(spec.fixed_values()).all()
