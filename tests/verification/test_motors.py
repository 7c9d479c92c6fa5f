"""viatool.verify of a robot with real motors and timing: what it proves, and counterexamples that drive again."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from viatool import load_map, load_policy, verify
from viatool.errors import ConfigurationError
from viatool.uncertainty import ErrorModel
from viatool.verification.witness_file import load_witnesses, replay, witness_document

ROOT = Path(__file__).resolve().parents[2]
TERMS = {
    "actuation": {
        "linear": {"acceleration": 1.0, "lag": [0.0, 0.1], "relative": 0.05, "absolute": 0.01},
        "angular": {"acceleration": [3.0, 6.0], "lag": [0.0, 0.1], "relative": 0.05},
        "slip": 0.02,
    },
    "timing": {"interval": [0.09, 0.11], "delay": [0.03, 0.06], "sensing": 0.02},
}


@pytest.fixture(scope="module")
def policy():
    return load_policy(ROOT / "policies" / "via.onnx")


@pytest.fixture(scope="module")
def world():
    return load_map(ROOT / "maps" / "lab.yaml")


def asked(policy, world, errors, scenarios, **given):
    model = ErrorModel.model_validate(errors)
    return verify(
        policy,
        world,
        eps=0.01,
        errors=model,
        scenarios=scenarios,
        only_contested=True,
        criterion="braking",
        **given,
    )


def test_counterexamples_of_real_motors_drive_again_from_their_file(policy, world, tmp_path):
    found = asked(policy, world, TERMS, world.scenarios[4:6], clearance=0.45)
    ideal = asked(policy, world, {}, world.scenarios[4:6], clearance=0.45)
    assert len(found.witnesses) > len(ideal.witnesses)
    assert found.judgement.safe.sum() < len(found.judgement.safe)
    path = tmp_path / "witnesses.json"
    path.write_text(json.dumps(witness_document(found), allow_nan=False))
    file = load_witnesses(path)
    again = replay(policy, world, file)
    assert again.violates.all()
    each = (found.witnesses, found.close.witnesses)
    np.testing.assert_allclose(again.clearance, np.concatenate([one.clearance for one in each]), atol=1e-9)
    assert file.rules.to_json() == found.rules.to_json()
    assert found.assumptions()["delay"].startswith("0.03 to 0.06 s on observations up to 0.02 s old")


@pytest.mark.parametrize(
    ("errors", "given", "message"),
    [
        ({"timing": {"delay": [0.0, 0.1]}}, {"delay": 0.1}, "timing.delay"),
        ({"timing": {"interval": [0.2, 0.3]}}, {}, "control interval"),
        ({"actuation": {"lateral": {"absolute": 0.1}}}, {}, "actuation.lateral"),
    ],
)
def test_what_contradicts_is_refused_before_any_work(policy, world, errors, given, message):
    with pytest.raises(ConfigurationError, match=message):
        asked(policy, world, errors, None, **given)


def test_a_criterion_that_samples_takes_no_motors(policy, world):
    with pytest.raises(ConfigurationError, match="sampled"):
        verify(policy, world, eps=0.01, criterion="sampled", errors=ErrorModel.model_validate(TERMS))
