"""Other readings of a specification: each is a specification by itself, and says what its words and keys say."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.doctor.layouts import AHEAD, AROUND, LAYOUTS, PLAIN, Layout
from viatool.channels import Extent
from viatool.doctor.edits import edits
from viatool.doctor.interpretation import FAMILIES, Background, Interpretation, as_version_2, reads
from viatool.policy import PolicySpecification, load_policy
from viatool.world import Robot

AROUND_LAB = Background(Robot(), Extent(-4.85, -4.85, 4.85, 4.85))
EPISODES = {"schema_version": 2, "observation": PLAIN.observation}


def readings(spec: PolicySpecification) -> dict[str, PolicySpecification]:
    return {one.name: one.spec for one in Interpretation(spec).others(AROUND_LAB)}


def told(before: PolicySpecification, after: PolicySpecification) -> list[str]:
    return [str(edit) for edit in edits(before, after)]


@pytest.mark.parametrize("layout", LAYOUTS, ids=lambda layout: layout.name)
def test_every_reading_is_a_specification_that_can_be_written_and_read(layout: Layout) -> None:
    found = readings(layout.spec)
    assert len(found) > 12
    for spec in found.values():
        assert PolicySpecification.model_validate(spec.model_dump(mode="json", exclude_none=True)) == spec
        assert spec.observation_size == layout.spec.observation_size


@pytest.mark.parametrize("layout", LAYOUTS, ids=lambda layout: layout.name)
def test_what_is_turned_over_twice_is_as_it_was(layout: Layout) -> None:
    for name in (
        "rays in reversed order",
        "scan begins on the other side",
        "bearing mirrored",
        "turns to the other side",
        "actions swapped",
    ):
        once = readings(layout.spec)[name]
        assert Interpretation(once).meaning != Interpretation(layout.spec).meaning, name
        assert Interpretation(readings(once)[name]).meaning == Interpretation(layout.spec).meaning, name


def test_a_reversed_scan_looks_to_the_other_side() -> None:
    for layout in LAYOUTS:
        was = layout.spec.observation[[c.kind for c in layout.spec.observation].index("lidar")]
        now = readings(layout.spec)["rays in reversed order"].channel(was.name)
        here, there = (np.exp(1j * channel.lidar.lidar().angles()) for channel in (was, now))
        np.testing.assert_allclose(there, here.conj(), atol=1e-12)


def directions(layout: Layout, name: str) -> np.ndarray:
    """The rays of a reading in degrees, in the order in which they are observed."""
    was = layout.spec.observation[[c.kind for c in layout.spec.observation].index("lidar")]
    return np.degrees(readings(layout.spec)[name].channel(was.name).lidar.lidar().angles())


def test_scans_span_what_scanners_of_the_field_do() -> None:
    turned = directions(AHEAD, "scan over 360 degrees")  # clockwise, 180 rays
    np.testing.assert_allclose(turned, 180.0 - 2.0 * np.arange(180), atol=1e-9)
    assert "scan over 270 degrees" in readings(AHEAD.spec)
    half = directions(AROUND, "scan over 180 degrees")  # 360 rays, before from straight ahead to the left
    np.testing.assert_allclose(np.diff(half), 0.5, atol=1e-9)
    assert half[0] == pytest.approx(-half[-1])
    found = readings(AROUND.spec)
    assert Interpretation(found["scan over 360 degrees"]).meaning == Interpretation(AROUND.spec).meaning
    assert (
        "scan over 360 degrees, the last ray where the first is" not in found
    )  # 359 gaps are no round number


def test_a_full_turn_may_have_its_first_ray_twice() -> None:
    rays = {"start": 0.0, "step": 2.0 * math.pi / 361, "rays": 361, "maximum_range": 7.0}
    spec = PolicySpecification.model_validate(
        {
            "schema_version": 2,
            "observation": [{"name": "scan", "kind": "lidar", "lidar": rays}],
            "action": PLAIN.action,
        }
    )
    name = "scan over 360 degrees, the last ray where the first is"
    angles = np.degrees(readings(spec)[name].channel("scan").lidar.lidar().angles())
    np.testing.assert_allclose(angles, np.arange(361), atol=0.01)


def test_numbers_of_rays_that_are_not_round_are_not_tried() -> None:
    rays = {"field_of_view": math.pi, "rays": 77, "bins": 77, "maximum_range": 7.0}
    spec = PolicySpecification.model_validate(
        {
            "observation": [{"name": "scan", "kind": "lidar", "size": 77, "lidar": rays}],
            "action": PLAIN.action,
        }
    )
    assert not [name for name in readings(spec) if name.startswith("scan over")]


def test_rays_without_a_return_and_small_ranges_may_read_otherwise() -> None:
    found = readings(PLAIN.spec)
    assert told(PLAIN.spec, found["rays without a return read 0"]) == [
        "observation.scan.lidar.no_return: 0 (was maximum)"
    ]
    assert told(PLAIN.spec, found["rays without a return read the minimum range"]) == [
        "observation.scan.lidar.no_return: 0.2 (was maximum)"
    ]
    assert told(PLAIN.spec, found["ranges from 0 m on"]) == [
        "observation.scan.lidar.minimum_range: 0 (was 0.2)"
    ]


def test_the_keys_to_change_are_named() -> None:
    assert told(PLAIN.spec, readings(PLAIN.spec)["rays in reversed order"]) == [
        "observation.scan.lidar.order: clockwise (was counter_clockwise)"
    ]
    assert told(AROUND.spec, readings(AROUND.spec)["scan a quarter turn further left"]) == [
        "observation.scan.lidar.start: 1.57079633 (was 0)"
    ]
    assert told(PLAIN.spec, readings(PLAIN.spec)["scan begins on the other side"]) == [
        "observation.scan.lidar.start: 1.57079633",
        "observation.scan.lidar.step: 0.0175507969",
        "leave out observation.scan.lidar.field_of_view (was 3.14159265)",
    ]
    assert told(AHEAD.spec, readings(AHEAD.spec)["angles in degrees"]) == [
        f"observation.goal_bearing.scale: {180.0 / math.pi:.9g} (was 1)"
    ]
    assert told(AHEAD.spec, readings(AHEAD.spec)["actions swapped"]) == [
        "action (order): v, omega (was omega, v)"
    ]


def test_version_1_is_kept_where_it_can_say_the_reading() -> None:
    spec = load_policy("via", self_check=False).spec
    assert spec is not None
    assert spec.schema_version == 1
    found = readings(spec)
    assert told(spec, found["rays in reversed order"]) == [
        "observation.lidar.lidar.order: clockwise (was counter_clockwise)"
    ]
    assert told(spec, found["turns to the other side"])[0] == "schema_version: 2 (was 1)"


def test_an_action_map_is_told_by_each_action() -> None:
    content = {
        "observation": PLAIN.observation,
        "action": PLAIN.action,
        "action_map": {"scale": [0.25, 2.0], "offset": [0.25, 0.0], "clip": True},
    }
    newer = as_version_2(PolicySpecification.model_validate(content))
    assert [(action.scale, action.offset) for action in newer.action] == [(0.25, 0.25), (2.0, 0.0)]
    assert PolicySpecification.model_validate(newer.model_dump(exclude_none=True)) == newer


def test_a_choice_turns_to_the_other_side_by_its_table() -> None:
    table = [[0.2, 1.0], [0.2, 0.0], [0.2, -1.0]]
    action = {"name": "c", "kind": "choice", "axes": ["linear", "angular"], "commands": table}
    spec = PolicySpecification.model_validate({**EPISODES, "action": [action]})
    found = readings(spec)
    flipped = found["turns to the other side"].action[0].commands
    assert flipped == ((0.2, -1.0), (0.2, 0.0), (0.2, 1.0))
    assert not [name for name in found if "output" in name or "swapped" in name]


def test_rules_keep_their_commands_when_actions_are_swapped() -> None:
    rule = {"when": {"goal_distance": {"below": 0.5}}, "command": [0.1, 0.7]}
    spec = PolicySpecification.model_validate({**EPISODES, "action": PLAIN.action, "overrides": [rule]})
    swapped = readings(spec)["actions swapped"]
    assert [action.name for action in swapped.action] == ["omega", "v"]
    assert swapped.overrides[0].command == (0.7, 0.1)


def test_fixed_channels_are_left_alone() -> None:
    observation = [{**channel, "value": 1.0} for channel in PLAIN.observation]
    spec = PolicySpecification.model_validate(
        {"schema_version": 2, "observation": observation, "action": PLAIN.action}
    )
    for other in readings(spec).values():
        assert other.observation == spec.observation


def test_a_family_has_a_name_of_its_own() -> None:
    name = next(iter(FAMILIES))
    with pytest.raises(ValueError, match=name):
        reads(name)(lambda spec, around: iter(()))
