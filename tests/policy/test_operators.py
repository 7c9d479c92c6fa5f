"""Every operator that is read, in every version: against onnxruntime, and enclosed by the engine."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnx
import pytest

from tests.policy.models import save
from tests.policy.operator_cases import CASES, Case
from viatool.policy import load_policy
from viatool.policy.operators import registered
from viatool.taylor import reach


def all_cases() -> list[tuple[str, int, Case]]:
    known = sorted({(key[0], key[1]) for key in registered()})
    newest = onnx.defs.onnx_opset_version()
    return [(op, version, case) for op, version in known if version <= newest for case in CASES[op](version)]


@pytest.mark.parametrize(
    ("operator", "version", "case"),
    [
        pytest.param(*entry, id=f"{entry[0]}-{entry[1]}-{entry[2].name or i}")
        for i, entry in enumerate(all_cases())
    ],
)
def test_operator_means_what_onnxruntime_computes(
    operator: str, version: int, case: Case, tmp_path: Path
) -> None:
    policy = load_policy(save(case.model(max(version, 6)), tmp_path))

    observations = np.random.default_rng(3).normal(size=(50, policy.input_size)).astype(np.float32)
    expected, found = policy.run(observations), policy(observations)
    tolerance = 1e-2 if "float16" in case.name else 2e-5
    np.testing.assert_allclose(found, expected, rtol=tolerance, atol=tolerance)


def test_every_registered_operator_has_a_case() -> None:
    assert {operator for operator, _ in registered()} == set(CASES)


NEWEST = {operator: max(version for name, version in registered() if name == operator) for operator in CASES}


@pytest.mark.parametrize(
    "case",
    [
        pytest.param(case, id=f"{operator}-{case.name or i}")
        for operator, version in sorted(NEWEST.items())
        if version <= onnx.defs.onnx_opset_version()
        for i, case in enumerate(CASES[operator](version))
    ],
)
def test_reachable_sets_of_an_operator_contain_what_onnxruntime_computes(
    case: Case, request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    operator = request.node.callspec.id.split("-")[0]
    policy = load_policy(save(case.model(max(NEWEST[operator], 6)), tmp_path))
    generator = np.random.default_rng(5)
    centres = generator.normal(size=(4, policy.input_size)).astype(np.float32).astype(np.float64)

    sets = reach(policy, centres, 0.02, refine="none")

    for _ in range(50):
        deviations = (
            0.02 * np.where(generator.random(centres.shape) < 0.5, 1, -1) * generator.random(centres.shape)
        )
        actions = policy.run(
            np.clip((centres + deviations).astype(np.float32), centres - 0.02, centres + 0.02)
        )
        assert (sets.lower <= actions).all()
        assert (actions <= sets.upper).all()
