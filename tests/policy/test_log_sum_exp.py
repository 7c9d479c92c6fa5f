"""The logarithm of a sum of exponentials, whose program rounds in ways of its own."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.policy.enclosure import escapes
from tests.policy.models import model_of, node, save, weights
from viatool.errors import PolicyError, SelfCheckError
from viatool.policy import Policy, load_policy
from viatool.policy.operators import reduction
from viatool.taylor import reach


def summed(folder: Path, count: int = 5, scale: float = 1.0) -> Policy:
    nodes = [node("MatMul", ["x", "w"], ["z"]), node("ReduceLogSumExp", ["z"], ["y"], axes=[1])]
    return load_policy(save(model_of(nodes, {"w": weights(1, 4, count, scale=scale)}), folder))


@pytest.mark.parametrize(("count", "scale"), [(1, 1.0), (2, 1.0), (5, 1.0), (7, 6.0), (64, 0.5)])
def test_bounds_hold_what_onnxruntime_computes(count: int, scale: float, tmp_path: Path) -> None:
    policy = summed(tmp_path, count, scale)
    assert escapes(policy, samples=4000) == 0
    rows = np.random.default_rng(0).normal(size=(40, 4))
    exact = np.logaddexp.reduce(rows @ weights(1, 4, count, scale=scale).astype(float), axis=1)
    np.testing.assert_allclose(policy(rows)[:, 0], exact, atol=1e-9)


def rounds_outside(folder: Path, size: float, *, self_check: bool) -> int:
    """Count points at which the program is not where bounds of the point alone say."""
    path = save(model_of([node("ReduceLogSumExp", ["x"], ["y"], axes=[1])]), folder)
    policy = load_policy(path, self_check=self_check)
    rows = (size * np.random.default_rng(2).normal(size=(300, 4))).astype(np.float32).astype(np.float64)
    sets, found = reach(policy, rows, 0.0, arithmetic="float32"), policy.run(rows)
    return int(((found < sets.lower) | (found > sets.upper)).sum())


@pytest.mark.parametrize("size", [1e-3, 1.0, 40.0])
def test_the_rounding_of_the_program_is_counted(
    size: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert rounds_outside(tmp_path, size, self_check=True) == 0
    monkeypatch.setattr(reduction, "_LOGARITHM", 0.0)
    monkeypatch.setattr(reduction, "_EXPONENTS", 0.0)
    with pytest.raises(SelfCheckError):  # a mutant that counts none is caught
        rounds_outside(tmp_path, size, self_check=False)


def test_too_many_values_are_refused(tmp_path: Path) -> None:
    with pytest.raises(PolicyError, match="goes over 65 values, where at most 64 are read"):
        summed(tmp_path, 65)
