"""Cumulated sums: a reader in the file of its family."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.policy.models import model_of, node, save, weights
from viatool import load_policy, reach
from viatool.errors import PolicyError
from viatool.policy.operators.table import operator_table

FILES = {
    "viatool/policy/operators/reduction.py": {
        '@reads("ReduceMean",': '''\
@reads("CumSum", 11, 14, treatment="exact", note="a constant axis")
def read_cumulated_sum(call: Call) -> Sequence[Value]:
    """Read the sums of all elements up to each of them along an axis."""
    x, axis = call.computed(0), int(call.scalar(1, "axis", 0.0))
    if call.flag("exclusive") or call.flag("reverse"):
        raise Refusal("cumulates exclusively or in reverse", "export the policy with a plain CumSum")
    behind = axis % len(x.shape) - len(x.shape)
    return [call.assembly.linear(x, lambda basis: np.cumsum(basis, axis=behind), x.shape)]


@reads("ReduceMean",'''
    }
}


def check(folder: Path) -> None:
    constants = {"axis": np.array(1, np.int64), "w": weights(1, 4, 3)}
    nodes = [
        node("CumSum", ["x", "axis"], ["s"]),
        node("Tanh", ["s"], ["t"]),
        node("MatMul", ["t", "w"], ["y"]),
    ]
    policy = load_policy(save(model_of(nodes, constants), folder))
    generator, eps = np.random.default_rng(0), 0.02
    centres = generator.normal(size=(8, 4)).astype(np.float32).astype(np.float64)
    sets = reach(policy, centres, eps)
    for _ in range(400):
        errors = generator.uniform(-1.0, 1.0, centres.shape) * eps
        actions = policy.run(np.clip((centres + errors).astype(np.float32), centres - eps, centres + eps))
        assert ((sets.lower <= actions) & (actions <= sets.upper)).all()
    assert "- `CumSum` (11, 14): a constant axis." in operator_table()
    assert operator_table().count("`CumSum`") == 1  # no longer among those that are folded and nothing else
    backwards = [node("CumSum", ["x", "axis"], ["y"], reverse=1)]
    with pytest.raises(PolicyError, match="cumulates exclusively or in reverse"):
        load_policy(save(model_of(backwards, constants), folder))
