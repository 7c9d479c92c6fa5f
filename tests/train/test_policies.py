"""The policies of the repository are what policies/README.md says."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from viatool.policy import load_policy
from viatool.train import TrainingMaps, load_configuration, make_configuration
from viatool.train.selection import evaluate_policy
from viatool.world import load_map

POLICIES = sorted(Path("policies").glob("*.onnx"))


@pytest.mark.parametrize("path", POLICIES, ids=lambda path: path.stem)
def test_a_policy_drives_as_well_as_its_table_says(path: Path) -> None:
    policy = load_policy(path)
    table = Path("policies/README.md").read_text(encoding="utf-8")
    (row,) = [line for line in table.splitlines() if line.startswith(f"| `{path.name}` |")]
    success, collisions = (float(cell.strip(" %")) / 100 for cell in row.split("|")[3:5])
    world_map = load_map("maps/lab.yaml")
    outcome = evaluate_policy(policy, TrainingMaps((world_map,)), make_configuration()).metrics["held_out"]
    # another machine rounds otherwise, and a few of the 500 episodes end otherwise
    assert outcome["success_rate"] == pytest.approx(success, abs=0.02)
    assert outcome["collision_rate"] == pytest.approx(collisions, abs=0.01)


@pytest.mark.parametrize("path", POLICIES, ids=lambda path: path.stem)
def test_the_configuration_beside_a_policy_is_the_one_in_its_specification(path: Path) -> None:
    configuration = load_configuration(path.with_suffix(".yaml")).model_dump(mode="json")
    policy = load_policy(path)
    assert policy.spec is not None
    trained = policy.spec.training["configuration"]
    assert {name: configuration[name] for name in trained} == trained
    record = json.loads(path.with_suffix(".json").read_text(encoding="utf-8"))
    assert record["sha256"] == policy.sha256


BEFORE = ["budget_rule=recursive", "standing_penalty=0", "shaping_narrow=0", "shaping_capped=false"]


@pytest.mark.parametrize(("name", "preset", "settings"), [("via", "study", BEFORE), ("via-64", "best", [])])
def test_a_policy_was_trained_with_its_preset(name: str, preset: str, settings: list[str]) -> None:
    records = {
        "checkpoint_interval": 1,
        "tensorboard": False,
    }  # what a run keeps does not change what it learns
    configuration = load_configuration(f"policies/{name}.yaml").model_copy(update=records)
    assert configuration == make_configuration(preset, settings=settings).model_copy(update=records)
