"""Rules around a policy, against each rule spelled out for one reading after the other."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from viatool.errors import ConfigurationError
from viatool.motion.kinematics import DIFFERENTIAL
from viatool.policy.command_map import command_map
from viatool.policy.overrides import Overrides
from viatool.policy.specification import PolicySpecification
from viatool.world.robot import Robot

Floats = NDArray[np.float64]

OBSERVATION = [
    {"name": "scan", "kind": "lidar", "scale": 0.25, "clip": [0.0, 0.8],
     "lidar": {"start": -1.0, "step": 0.5, "rays": 5, "maximum_range": 4.0}},
    {"name": "near", "kind": "lidar", "scale": 0.5, "reciprocal": True,
     "lidar": {"start": -1.0, "step": 1.0, "rays": 3, "maximum_range": 4.0}},
    {"name": "bearing", "kind": "goal_bearing", "scale": -0.3},
    {"name": "distance", "kind": "goal_distance", "frames": {"count": 3}},
]  # fmt: skip
ACTION = [
    {"name": "turn", "kind": "angular", "lower": -1.0, "upper": 1.0},
    {"name": "drive", "kind": "linear", "lower": 0.0, "upper": 0.5},
]
RULES = [
    {"when": {"distance": {"below": 0.9}}, "command": [0.0, 0.0]},
    {"when": {"scan": {"below": 0.5}, "bearing": {"above": -0.5, "below": 0.5}}, "command": [0.7, 0.1]},
    {"when": {"lidar": {"below": 0.4}}, "command": [-0.7, 0.2]},
]


def overrides(rules: list[Any] | None = None) -> Overrides:
    """Return the rules of a policy that names its turn before its speed."""
    spec = PolicySpecification.model_validate(
        {"schema_version": 2, "observation": OBSERVATION, "action": ACTION, "overrides": rules or RULES}
    )
    return Overrides.of(spec, command_map(spec, DIFFERENTIAL, Robot()))


def observed(readings: Floats, before: Floats) -> Floats:
    """Encode readings (B, 10): five rays, three rays, a bearing and a distance; two distances before."""
    scan = np.clip(0.25 * readings[:, :5], 0.0, 0.8)
    near = 0.5 / readings[:, 5:8]
    return np.concatenate([scan, near, -0.3 * readings[:, 8:9], before, readings[:, 9:]], axis=1)


def by_hand(readings: Floats, commands: Floats) -> Floats:
    """What is sent, v and omega."""
    sent = commands.copy()
    for row, read in enumerate(readings):
        if read[9] < 0.9:
            sent[row] = [0.0, 0.0]
        elif read[:5].min() < 0.5 and -0.5 < read[8] < 0.5:
            sent[row] = [0.1, 0.7]
        elif read[:8].min() < 0.4:
            sent[row] = [0.2, -0.7]
    return sent


def draw(count: int) -> tuple[Floats, Floats]:
    """Return readings around the numbers of the rules, and distances before."""
    generator = np.random.default_rng(4)
    low = np.array([0.2] * 8 + [-1.0, 0.5])
    high = np.array([1.6] * 8 + [1.0, 2.0])
    return generator.uniform(low, high, (count, 10)), generator.uniform(0.2, 2.0, (count, 2))


def test_what_is_sent_is_what_the_rules_say_of_the_readings() -> None:
    """The first rule that applies, in the command's order, by the newest of stacked frames."""
    readings, before = draw(3000)
    commands = np.random.default_rng(1).uniform(0.3, 0.4, (3000, 2))
    found = overrides().apply(observed(readings, before), commands)
    np.testing.assert_array_equal(found, by_hand(readings, commands))
    assert len(np.unique(found[found[:, 0] < 0.3], axis=0)) == 3


@pytest.mark.parametrize("width", [0.0, 0.02, 0.3])
def test_every_rule_that_counts_somewhere_in_a_box_may_count(width: float) -> None:
    """Points of boxes of observations, decoded by hand, against what holds of the box."""
    generator, count = np.random.default_rng(2), 300
    readings, before = draw(count)
    shift = generator.uniform(-width, width, (count, 40, 10))
    around = np.maximum(readings[:, None] + shift, 0.05)
    seen = observed(around.reshape(-1, 10), np.repeat(before, 40, axis=0)).reshape(count, 40, -1)
    standing = overrides().over(seen.min(axis=1), seen.max(axis=1))
    plain = np.full((count * 40, 2), 9.0)
    sent = by_hand(around.reshape(-1, 10), plain).reshape(count, 40, 2)
    for number, command in enumerate(([0.0, 0.0], [0.1, 0.7], [0.2, -0.7])):
        counts = (sent == command).all(axis=2).any(axis=1)
        assert not (counts & ~standing.counts[:, number]).any()
    assert not ((sent[:, :, 0] == 9.0).any(axis=1) & ~standing.policy).any()
    certain = standing.counts.sum(axis=1) + standing.policy
    assert (certain >= 1).all()
    if width == 0.0:
        assert (certain == 1).mean() > 0.99  # of one observation a rule applies or does not


def test_a_reciprocal_of_either_sign_tells_nothing() -> None:
    """A box of inputs around 0 stands for readings without bounds."""
    rules = overrides([{"when": {"near": {"above": 3.0}}, "command": [0.0, 0.0]}])
    inputs = observed(*draw(1))
    lower, upper = inputs.copy(), inputs.copy()
    lower[:, 5:8], upper[:, 5:8] = -0.1, 0.4
    assert rules.over(lower, upper).counts.all()


def test_nan_leaves_everything_open() -> None:
    """What is not known may be anything."""
    inputs = np.full((1, 12), np.nan)
    standing = overrides().over(inputs, inputs)
    assert standing.counts.all()
    assert standing.policy.all()


@pytest.mark.parametrize("bound", [{"above": 3.3}, {"below": 3.3}, {"below": -0.1}])
def test_a_number_beyond_the_clip_is_refused(bound: dict[str, float]) -> None:
    """The scan is clipped between 0 and 3.2 m."""
    with pytest.raises(ConfigurationError, match="clipped"):
        overrides([{"when": {"scan": bound}, "command": [0.0, 0.0]}])
