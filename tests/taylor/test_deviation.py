"""Deep networks: what rounding adds to a bound stays near what it does, and holds for the program."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.benchmarks.deep import CASES, deep_policy, observations, ratio, samples_within
from tests.taylor.containment import Bare
from viatool.errors import EnclosureError
from viatool.policy.network import Affine, Input, Network, Node, Product
from viatool.taylor import reach

EPS = 0.01


@pytest.mark.parametrize(
    "name",
    [
        "tanh-12",
        "relu-12",
        "layernorm-relu-8",
        "silu-12",
        "gelu-12",
        "glu-8",
        "rms-silu-8",
        "residual-layernorm-6",
    ],
)
def test_rounding_adds_at_most_a_tenth_to_the_bounds_of_deep_networks(name: str, tmp_path: Path) -> None:
    policy = deep_policy(*CASES[name], tmp_path)
    centre = observations(2)
    bounds = reach(policy, centre, EPS)
    real = reach(policy, centre, EPS, arithmetic="real")
    assert ratio(bounds, real) <= 1.1
    points = samples_within(centre, EPS, 100)
    actions = policy.run(points.reshape(-1, policy.input_size)).reshape(*points.shape[:2], -1)
    assert (actions >= bounds.lower).all()
    assert (actions <= bounds.upper).all()


@pytest.mark.parametrize(
    ("name", "seed"), [("rms-silu-8", 1), ("rms-silu-8", 4), ("gelu-12", 3), ("gelu-12", 6)]
)
def test_rounding_adds_at_most_a_tenth_where_real_bounds_are_loose_or_an_action_saturates(
    name: str, seed: int, tmp_path: Path
) -> None:
    policy = deep_policy(*CASES[name], tmp_path, seed)
    bounds = reach(policy, observations(3), EPS)
    assert ratio(bounds, reach(policy, observations(3), EPS, arithmetic="real")) <= 1.1


def test_an_overflow_that_norms_cannot_exclude_is_excluded_by_symbols() -> None:
    """``1e30 (s - s)`` is zero but for the rounding of s, whose symbol cancels; a true overflow is refused."""
    size = 8
    difference = np.concatenate([np.eye(size), -np.eye(size)], axis=1)
    nodes: list[Node] = [
        Input(size),
        Affine((0,), (np.full((size, size), 0.3),), np.zeros(size)),
        Affine((1,), (np.concatenate([np.eye(size), np.eye(size)]),), np.zeros(2 * size)),
        Affine((2,), (1e30 * difference,), np.zeros(size)),
        Product(3, 3, size),
    ]
    bounds = reach(Bare(Network(tuple(nodes[:4]))), np.ones((1, size)), 1e-3, refine="none")
    assert np.isfinite(bounds.upper).all()
    with pytest.raises(EnclosureError, match="leave the range of float32"):
        reach(Bare(Network(tuple(nodes))), np.ones((1, size)), 1e-3, refine="none")
