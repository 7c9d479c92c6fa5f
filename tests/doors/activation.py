"""The hyperbolic cosine: its declaration, and the operator that means it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tests.policy.models import model_of, node, save, weights
from viatool import load_policy, reach

FILES = {
    "viatool/policy/activations.py": {
        '@_declare("Log")\n': """\
@_declare("Cosh")
def _cosh(x: Expression) -> Expression:
    return (exp(x) + exp(-x)) / 2


@_declare("Log")
"""
    },
    "viatool/policy/operators/elementwise.py": {
        '    "Erf": (9, 13),\n': '    "Cosh": (9,),\n    "Erf": (9, 13),\n'
    },
}


def check(folder: Path) -> None:
    nodes = [node("MatMul", ["x", "w"], ["h"]), node("Cosh", ["h"], ["c"]), node("MatMul", ["c", "v"], ["y"])]
    model = model_of(nodes, {"w": weights(1, 4, 6, scale=0.5), "v": weights(2, 6, 2)})
    policy = load_policy(save(model, folder))
    generator, eps = np.random.default_rng(0), 0.02
    centres = generator.normal(size=(8, 4)).astype(np.float32).astype(np.float64)
    sets = reach(policy, centres, eps)
    least, largest = np.full((2, 8, 2), np.inf) * [[[1]], [[-1]]]
    for _ in range(400):
        errors = np.clip(generator.uniform(-1.5, 1.5, centres.shape), -1.0, 1.0) * eps
        actions = policy.run(np.clip((centres + errors).astype(np.float32), centres - eps, centres + eps))
        least, largest = np.minimum(least, actions), np.maximum(largest, actions)
    assert (sets.lower <= least).all()
    assert (largest <= sets.upper).all()
    assert (sets.upper - sets.lower < 3.0 * (largest - least)).all()
    for order in (2, 3):
        finer = reach(policy, centres, eps, order=order)
        assert (finer.lower <= least).all()
        assert (largest <= finer.upper).all()
