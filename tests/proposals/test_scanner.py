"""A scan's geometry in a proposed specification: rays point where the message says that they point."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from viatool.errors import PolicyError
from viatool.policy.specification_file import specification_from_json
from viatool.proposals import PolicyFacts, Proposal, Scanner, propose_by_size, with_kinds, with_scanner
from viatool.world import Lidar

LIMITS = ((0.0, 0.5), (-1.0, 1.0))


def proposed(inputs: int, **more: object) -> Proposal:
    return propose_by_size(PolicyFacts(inputs, 2, limits=LIMITS, **more))  # type: ignore[arg-type]


def lidar_of(proposal: Proposal) -> Lidar:
    spec = specification_from_json(json.dumps(proposal.document), "proposed")
    (described,) = (channel.lidar for channel in spec.observation if channel.lidar is not None)
    return described.lidar()


@given(
    rays=st.integers(8, 400),
    first=st.floats(-3.0, 3.0),
    around=st.floats(0.5, 6.0),
    clockwise=st.booleans(),
    yaw=st.floats(-3.0, 3.0),
)
def test_every_ray_points_where_the_message_says(
    rays: int, first: float, around: float, clockwise: bool, yaw: float
) -> None:
    step = (-around if clockwise else around) / rays
    found = with_scanner(proposed(rays + 2), Scanner(first, step, rays, 0.1, 5.0), yaw)
    lidar = lidar_of(found)
    expected = first + yaw + step * np.arange(rays)
    assert np.abs(np.exp(1j * lidar.angles()) - np.exp(1j * expected)).max() < 1e-5
    assert (lidar.bins, lidar.minimum_range, lidar.maximum_range) == (rays, 0.1, 5.0)


def test_a_scan_is_binned_where_the_policy_takes_fewer_numbers() -> None:
    lidar = lidar_of(with_scanner(proposed(20 + 5), Scanner(-1.5, 3.0 / 179, 180, 0.2, 7.0)))
    assert (lidar.rays, lidar.bins, lidar.reduce) == (180, 20, "minimum")
    spread = with_scanner(proposed(36 + 2), Scanner(-1.5, 0.03, 101, 0.2, 7.0))
    assert lidar_of(spread).angles()[[0, -1]] == pytest.approx([-1.5, 1.5])
    around = with_scanner(proposed(36 + 2), Scanner(0.0, math.tau / 500, 500, 0.2, 7.0))
    assert lidar_of(around).angles()[1] == pytest.approx(math.tau / 36)
    assert any("evenly spread over the 500" in guess.what for guess in around.guesses)


def test_a_size_that_nobody_knows_is_told_by_the_scan() -> None:
    assert proposed(57 + 3).observation[0]["kind"] == "other"
    found = with_scanner(proposed(57 + 3), Scanner(-1.5, 0.05, 57, 0.2, 7.0))
    assert [channel["kind"] for channel in found.observation] == [
        "lidar", "goal_distance", "goal_cosine", "goal_sine",
    ]  # fmt: skip
    assert any("60 = 57 readings + 3" in guess.what for guess in found.guesses)


def test_a_scan_leaves_no_guess_about_another_layout_of_the_same_size() -> None:
    found = with_scanner(
        proposed(26), Scanner(-math.pi, math.tau / 24, 24, 0.1, 3.5)
    )  # VIA's has 26 numbers, too
    assert [channel["kind"] for channel in found.observation] == ["lidar", "goal_distance", "goal_bearing"]
    told = found.to_yaml().split("schema_version")[0]
    assert "26 = 24 readings + 2" in told
    assert not any(word in told for word in ("20 bins", "budget", "VIA"))
    said = with_kinds(proposed(26), ["lidar", "goal_x", "goal_y"], [])
    assert not any("budget" in guess.what or "20 bins" in guess.what for guess in said.guesses)


def test_limits_of_the_observation_tell_shares_from_metres() -> None:
    scanner = Scanner(-1.5, 0.08, 36, 0.1, 4.0)
    shares = with_scanner(proposed(38, ranges=((0.0, 1.0),) * 38), scanner)
    assert (shares.observation[0]["scale"], lidar_of(shares).maximum_range) == (0.25, 4.0)
    cut = with_scanner(proposed(38, ranges=((0.0, 3.0),) * 38), scanner)
    assert "scale" not in cut.observation[0]
    assert lidar_of(cut).maximum_range == 3.0
    beyond = with_scanner(proposed(38, ranges=((0.0, 20.0),) * 38), scanner)
    assert lidar_of(beyond).maximum_range == 4.0


def test_kinds_are_taken_in_the_order_that_is_said() -> None:
    found = with_kinds(proposed(60), ["goal_x", "goal_y", "lidar", "previous_raw"], [])
    assert [channel["size"] for channel in found.observation] == [1, 1, 56, 2]
    swapped = with_kinds(proposed(38), [], ["angular", "linear"])
    assert [action["kind"] for action in swapped.action] == ["angular", "linear"]
    for names, outputs in ((["goal_x"], []), (["goal"], []), ([], ["linear"]), (["lidar", "lidar"], [])):
        with pytest.raises(PolicyError):
            with_kinds(proposed(38), names, outputs)
