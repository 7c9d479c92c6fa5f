"""Specifications: what they hold, what they refuse, and where the mistake stands."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from viatool.errors import ConfigurationError, PolicyError
from viatool.policy import (
    ActionChannel,
    LidarSpecification,
    ObservationChannel,
    PolicySpecification,
    load_specification,
)
from viatool.policy.specification_file import schema_json, specification_from_json

LIDAR = LidarSpecification(field_of_view=np.pi, rays=180, bins=20, minimum_range=0.2, maximum_range=7.0)
SPEC = PolicySpecification(
    observation=[
        ObservationChannel(name="lidar", size=20, unit="m", kind="lidar", lidar=LIDAR, eps=0.03),
        ObservationChannel(name="goal_distance", unit="m", kind="goal_distance"),
        ObservationChannel(name="budget", kind="budget", value=3.5),
    ],
    action=[
        ActionChannel(name="v", unit="m/s", lower=0.0, upper=0.5, kind="linear"),
        ActionChannel(name="omega", unit="rad/s", lower=-1.0, upper=1.0, kind="angular"),
    ],
)


def test_sizes_and_columns() -> None:
    assert SPEC.observation_size == 22
    assert SPEC.action_size == 2
    assert SPEC.columns("goal_distance").tolist() == [20]
    assert SPEC.channel("budget").value == 3.5
    with pytest.raises(ConfigurationError, match="speed"):
        SPEC.channel("speed")
    with pytest.raises(ConfigurationError, match="speed"):
        SPEC.columns("speed")


@pytest.mark.parametrize(
    ("eps", "lidar", "distance"),
    [
        (0.01, 0.01, 0.01),
        ({"": 0.01, "lidar": 0.02}, 0.02, 0.01),
        ({"goal_distance": 0.5}, 0.03, 0.5),
        ({"": 0.0}, 0.0, 0.0),
    ],
)
def test_radii_by_channel(eps: Any, lidar: float, distance: float) -> None:
    radii = SPEC.radii(eps)
    assert radii.shape == (22,)
    np.testing.assert_array_equal(radii, [*[lidar] * 20, distance, 0.0])


@pytest.mark.parametrize(
    "eps", [None, {}, {"lidar": 0.1}, -1.0, np.nan, np.inf, {"speed": 0.1}, {"budget": 0.1}]
)
def test_radii_that_make_no_sense(eps: Any) -> None:
    with pytest.raises(ConfigurationError) as refusal:
        SPEC.radii(eps)
    assert refusal.value.hint


def test_fixed_values() -> None:
    values = SPEC.fixed_values()
    assert np.isnan(values[:21]).all()
    assert values[21] == 3.5


def test_yaml_and_json_give_the_specification_back(tmp_path: Path) -> None:
    path = tmp_path / "robot.yaml"
    path.write_text(SPEC.to_yaml())
    assert load_specification(path) == SPEC
    assert specification_from_json(SPEC.to_json(), "here") == SPEC
    path.write_text(SPEC.to_json())
    assert load_specification(path) == SPEC


@pytest.mark.parametrize(
    ("old", "new", "where", "meaning"),
    [
        ("rays: 180", "rays: 7", "lidar:", "7 rays in 20 bins"),
        ("size: 20", "size: 19", "- name: lidar", "20 LiDAR bins"),
        ("kind: goal_distance", "kind: goal", "kind: goal", "goal"),
        ("upper: 0.5", "upper: -0.5", "- name: v", "exceeds upper"),
        ("upper: 0.5", "uper: 0.5", "uper: 0.5", "uper"),
        ("schema_version: 1", "schema_version: 3", "schema_version", "1"),
        ("name: omega", "name: v", "name: v", "'v' is given twice"),
        ("value: 3.5", "value: .nan", "value: .nan", "finite"),
        (
            "control_interval: 0.1",
            "control_interval: 0",
            "control_interval: 0",
            "expected more than 0, not 0",
        ),
    ],
)
def test_a_mistake_is_named_with_its_line(
    old: str, new: str, where: str, meaning: str, tmp_path: Path
) -> None:
    path = tmp_path / "robot.yaml"
    text = SPEC.to_yaml()
    assert old in text
    changed = text.replace(old, new, 1)
    path.write_text(changed)
    with pytest.raises(PolicyError, match=meaning) as refusal:
        load_specification(path)
    named = [int(line.split(":")[1]) for line in refusal.value.message.splitlines()]
    assert any(where in changed.splitlines()[number - 1] for number in named)


@pytest.mark.parametrize(
    ("old", "new", "marked"),
    [
        ("name: omega", "name: v  # here", "'v' is given twice"),
        ("  kind: angular\n  scale: 1.0", "  kind: angular\n  scale: 2.0", "`schema_version: 2`"),
        ("overrides: []", "frames: {count: 2}  # here\noverrides: []", "`schema_version: 2`"),
        ("schema_version: 1", "schema_version: 2\naction_map: {scale: [1, 1], offset: [0, 0]}  # here", "version 1"),
        ("memory: {}", "action_map:\n  scale: [1, 1]\n  offset: [0, 0, 1]  # here\nmemory: {}", "3 numbers for 2"),
        (
            "overrides: []",
            "overrides:\n- when:\n    goal_distanc: {below: 1}  # here\n  command: [0, 0]",
            "nearest is 'goal_distance'",
        ),
        (
            "overrides: []",
            "overrides:\n- when: {goal_distance: {below: 1}}\n  command: [0]  # here",
            "1 numbers for 2",
        ),
    ],
)  # fmt: skip
def test_what_a_whole_document_gets_wrong_is_shown_at_the_key_that_says_it(
    old: str, new: str, marked: str, tmp_path: Path
) -> None:
    path, text = tmp_path / "robot.yaml", SPEC.to_yaml()
    assert old in text
    changed = text.replace(old, new, 1)
    if new.startswith("overrides:"):
        changed = changed.replace("schema_version: 1", "schema_version: 2")
    path.write_text(changed)
    with pytest.raises(PolicyError, match=marked) as refusal:
        load_specification(path)
    line = changed.splitlines()[int(refusal.value.message.split(":")[1]) - 1]
    assert "# here" in line or line == "- name: omega"


def test_files_that_are_no_specification(tmp_path: Path) -> None:
    path = tmp_path / "robot.yaml"
    for text in ("a: [1", "- 1\n- 2", "", "just text", "\t", "a: !!python/object:os.system x", "&a [*a]"):
        path.write_text(text)
        with pytest.raises(PolicyError):
            load_specification(path)
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(PolicyError, match="text"):
        load_specification(path)
    with pytest.raises(PolicyError, match="cannot read"):
        load_specification(tmp_path / "missing.yaml")


@pytest.mark.parametrize(
    "change",
    [
        {"action_map": {"scale": [1.0], "offset": [0.0, 0.0]}},
        {"action_map": {"scale": [1.0, np.inf], "offset": [0.0, 0.0]}},
        {"observation": []},
        {"action": []},
        {"observation": [{"name": "a", "kind": "goal_cosine", "size": 2}]},
        {"observation": [{"name": "a", "kind": "budget", "value": 1.0, "eps": 0.1}]},
        {"observation": [{"name": "a", "kind": "budget"}, {"name": "a", "kind": "other"}]},
        {"action": [{"name": n, "kind": "linear", "lower": 0.0, "upper": 1.0} for n in ("v", "w")]},
        {"observation": [{"name": "a", "kind": "goal_cosin"}]},
        {"observation": [{"name": "a", "lidar": LIDAR}]},
    ],
)
def test_contradictions(change: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        PolicySpecification.model_validate({**SPEC.model_dump(), **change})


def test_the_published_schema_is_the_model() -> None:
    published = Path(__file__).parents[2] / "docs" / "specification.schema.json"
    import json

    written = json.loads(published.read_text(encoding="utf-8"))
    assert written["properties"].keys() == json.loads(schema_json())["properties"].keys()


@pytest.mark.parametrize(
    ("line", "meaning"),
    [
        ("no_return: zero", "no_return: expected 'maximum' or a number, not 'zero'"),
        ("maximum_ranges: 3", "there is no key 'maximum_ranges', nearest is 'maximum_range'"),
    ],
)
def test_a_field_of_several_types_is_named_once_in_words_of_the_file(tmp_path, line, meaning):
    path = tmp_path / "robot.yaml"
    path.write_text(
        "schema_version: 2\nobservation:\n  - name: scan\n    kind: lidar\n    lidar:\n"
        f"      field_of_view: 3.0\n      rays: 4\n      maximum_range: 3.0\n      {line}\n"
        "action: [{name: v, kind: linear, lower: 0, upper: 1}, {name: w, kind: angular, lower: -1, upper: 1}]\n",
        encoding="utf-8",
    )
    with pytest.raises(PolicyError) as refusal:
        load_specification(path)
    assert meaning in refusal.value.message
    assert len(refusal.value.message.splitlines()) == 1


def test_a_choice_without_its_commands_is_told_so(tmp_path):
    path = tmp_path / "robot.yaml"
    path.write_text(
        "schema_version: 2\nobservation: [{name: d, kind: goal_distance}]\n"
        "action: [{name: move, kind: choice, axes: [linear, angular]}]\n",
        encoding="utf-8",
    )
    with pytest.raises(PolicyError, match="needs `axes` and at least two `commands`"):
        load_specification(path)
