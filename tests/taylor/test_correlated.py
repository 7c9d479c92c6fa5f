from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from viatool import load_policy
from viatool.taylor import correlated
from viatool.taylor.correlated import input_model, reach_correlated

POLICY = load_policy(Path("policies/via.onnx"))


def inputs(seed, count=60):
    generator = np.random.default_rng(seed)
    size = POLICY.input_size
    centre = generator.uniform(0.2, 4.0, (count, size))
    shared = generator.normal(0.0, 0.1, (count, 3, size)) * (generator.random((count, 3, size)) < 0.6)
    own = generator.uniform(0.0, 0.03, (count, size))
    return generator, centre, shared, own


def excess(seed):
    """By how much the commands of onnxruntime leave the bounds at most."""
    generator, centre, shared, own = inputs(seed)
    found = reach_correlated(POLICY.network, input_model(centre, shared, own))
    worst = -np.inf
    for _ in range(60):
        z, e = generator.uniform(-1, 1, (len(centre), 3)), generator.uniform(-1, 1, centre.shape)
        if generator.random() < 0.7:
            z, e = np.sign(z), np.sign(e)
        points = centre + np.einsum("bv,bvn->bn", z, shared) + own * e
        actions = POLICY.run(points.astype(np.float32))
        worst = max(worst, float(np.maximum(actions - found.upper, found.lower - actions).max()))
    return worst


def test_commands_over_correlated_inputs_lie_within_their_bounds():
    assert max(excess(seed) for seed in range(3)) <= 0.0


def test_common_symbols_are_tighter_than_boxes():
    _, centre, shared, own = inputs(5)
    together = reach_correlated(POLICY.network, input_model(centre, shared, own))
    apart = reach_correlated(
        POLICY.network, input_model(centre, 0.0 * shared, own + np.abs(shared).sum(axis=1))
    )
    wide = (apart.upper - apart.lower) > 1e-3
    assert np.median((together.upper - together.lower)[wide] / (apart.upper - apart.lower)[wide]) < 0.9


def test_dual_bounds_are_tighter_and_hold():
    _, centre, shared, own = inputs(6)
    plain = reach_correlated(POLICY.network, input_model(centre, shared, own))
    better = reach_correlated(POLICY.network, input_model(centre, shared, own), thorough=True)
    assert (better.upper <= plain.upper + 1e-12).all()
    assert (better.upper < plain.upper - 1e-6).any()


@pytest.mark.parametrize("forgotten", ["shared", "own"])
def test_onnxruntime_catches_inputs_that_forget_a_part(monkeypatch, forgotten):
    right = correlated.input_model

    def mutant(centre, shared, own):
        return right(centre, shared * (forgotten != "shared"), own * (forgotten != "own"))

    monkeypatch.setitem(globals(), "input_model", mutant)
    assert excess(0) > 0.0


@pytest.mark.parametrize("name", ["policies/via.onnx", "policies/td3.onnx"])
def test_both_engines_give_the_same_bounds_and_influence(name, monkeypatch):
    policy = load_policy(Path(name))
    _, centre, shared, own = inputs(8)
    compiled = reach_correlated(policy.network, input_model(centre, shared, own))
    monkeypatch.setenv("VIATOOL_ENGINE", "numpy")
    by_numpy = reach_correlated(policy.network, input_model(centre, shared, own))
    assert compiled.lower == pytest.approx(by_numpy.lower, rel=1e-6, abs=1e-7)
    assert compiled.upper == pytest.approx(by_numpy.upper, rel=1e-6, abs=1e-7)
    assert compiled.influence == pytest.approx(by_numpy.influence, rel=1e-6, abs=1e-7)
