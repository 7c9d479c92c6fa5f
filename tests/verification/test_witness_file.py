from __future__ import annotations

import json

import numpy as np
import pytest

from tests.safety.hand_made_policy import specification, write_policy
from viatool.errors import ConfigurationError
from viatool.policy import load_policy
from viatool.simulate import roll_out
from viatool.verification import verify
from viatool.verification.witness_file import load_witnesses, replay, witness_document
from viatool.world import load_map

LAB = "maps/lab.yaml"


@pytest.fixture(scope="module")
def policy(tmp_path_factory):
    path = write_policy(tmp_path_factory.mktemp("policy") / "policy.onnx", specification(), caution=0.05)
    return load_policy(path)


@pytest.fixture(scope="module")
def driven(policy):
    world_map = load_map(LAB)
    return roll_out(policy, world_map, world_map.generator.draw(24, 1))


@pytest.mark.parametrize(
    "options",
    [{}, {"criterion": "braking"}, {"delay": 0.05}, {"footprint": [[-0.2, -0.1], [0.2, -0.1], [0.2, 0.1]]}],
)
def test_every_written_witness_violates_when_it_is_replayed(policy, driven, tmp_path, options):
    result = verify(policy, LAB, eps=0.03, trajectory=driven, clearance=0.55, only_contested=True, **options)
    path = tmp_path / "witnesses.json"
    path.write_text(json.dumps(witness_document(result)))
    file = load_witnesses(path)
    again = replay(policy, load_map(LAB), file)
    assert result.close is not None
    each = (result.witnesses, result.close.witnesses)  # the driven states, then close places
    assert all(len(found) > 3 for found in each)
    assert again.violates.all()
    for name in ("clearance", "seconds"):
        expected = np.concatenate([getattr(found, name) for found in each])
        np.testing.assert_allclose(getattr(again, name), expected, atol=1e-6)
    assert [bool(entry.get("close")) for entry in file.entries] == [
        close for close in (False, True) for _ in each[close].state
    ]
    assert [entry["closest"]["obstacle"] for entry in file.entries] == list(again.nearest)


def test_the_obstacle_of_a_witness_is_the_nearest_one(policy, driven, tmp_path):
    result = verify(policy, LAB, eps=0.03, trajectory=driven, clearance=0.55, only_contested=True)
    path = tmp_path / "witnesses.json"
    path.write_text(json.dumps(witness_document(result)))
    fixed = load_map(LAB).obstacles.circles.tolist()
    for entry in json.loads(path.read_text())["witnesses"]:
        x, y, _ = entry["closest"]["pose"]
        circles = [*fixed, *entry["scenario"]["circles"]]
        distances = [np.hypot(x - cx, y - cy) - radius for cx, cy, radius in circles]
        wall = 4.85 - max(abs(x), abs(y))
        assert np.isclose(min([wall, *distances]), entry["closest"]["clearance"], atol=1e-6)
        assert ("wall" in entry["closest"]["obstacle"]) == (wall < min(distances))


def test_no_witness_makes_an_empty_file_that_replays(policy, driven, tmp_path):
    result = verify(policy, LAB, eps=0.0, trajectory=driven, clearance=0.05, only_contested=True, close=0)
    path = tmp_path / "witnesses.json"
    path.write_text(json.dumps(witness_document(result)))
    assert len(replay(policy, load_map(LAB), load_witnesses(path)).violates) == 0


@pytest.mark.parametrize(
    "text", ["", "[]", "{}", '{"witnesses": [{}], "columns": [0, 1], "policy": {}, "map": {}}']
)
def test_what_is_no_witness_file_is_refused(tmp_path, text):
    path = tmp_path / "witnesses.json"
    path.write_text(text)
    with pytest.raises(ConfigurationError, match="is not a witness file"):
        load_witnesses(path)
    with pytest.raises(ConfigurationError, match="cannot read"):
        load_witnesses(tmp_path / "none.json")
