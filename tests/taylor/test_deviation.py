"""Deep networks: what rounding adds to a bound stays near what it does, and holds for the program."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.benchmarks.deep import CASES, deep_policy, observations, ratio, samples_within
from tests.taylor.containment import Bare
from viatool.errors import EnclosureError
from viatool.policy.activations import activation
from viatool.policy.network import Activation, Affine, Input, Network, Node, Product
from viatool.taylor import deviation, reach
from viatool.taylor.deviation import runtime_deviation

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


def test_the_errors_of_a_wide_network_are_those_of_each_state_by_itself(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    generator = np.random.default_rng(0)
    first, second = generator.normal(size=(1200, 12)) / 12, generator.normal(size=(2, 1200)) / 1200
    network = Network(
        (
            Input(12),
            Affine((0,), (first,), generator.normal(size=1200)),
            Activation(1, activation("Tanh"), 1200),
            Affine((2,), (second,), np.zeros(2)),
        )
    )
    centre = generator.normal(size=(9, 12))
    hulls = [(value, value) for value in network.values(centre)]
    together = runtime_deviation(network, hulls)
    assert [len(rows) for rows in deviation._blocks(network, np.arange(9))] == [5, 4]
    monkeypatch.setattr(deviation, "_MOST_FLOATS", 0)
    assert {len(rows) for rows in deviation._blocks(network, np.arange(9))} == {1}
    np.testing.assert_allclose(runtime_deviation(network, hulls), together, rtol=1e-9)


@pytest.mark.usefixtures("numpy_engine")
def test_symbols_that_gain_less_than_a_tenth_are_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """Behind a wide sum nearly all of a deviation is what that sum errs by itself."""
    generator = np.random.default_rng(5)
    wide = Network(
        (
            Input(3),
            Affine((0,), (0.01 * generator.normal(size=(400, 3)),), np.ones(400)),
            Activation(1, activation("Relu"), 400),
            Affine((2,), (generator.normal(size=(2, 400)),), np.zeros(2)),
        )
    )
    points = generator.uniform(-0.001, 0.001, (20, 3))
    hulls = [(value - 1e-6, value + 1e-6) for value in wide.values(points)]
    right, symbols = deviation._Carried.may_cancel, []
    carried = deviation._Carried.__init__

    def noted(self: deviation._Carried, *given: object, **named: object) -> None:
        symbols.append(named["with_symbols"])
        carried(self, *given, **named)

    monkeypatch.setattr(deviation._Carried, "__init__", noted)
    without = deviation.enclose_program(wide, hulls).deviation
    assert symbols == [False]
    monkeypatch.setattr(deviation._Carried, "may_cancel", lambda self: np.ones_like(right(self)))
    both = deviation.enclose_program(wide, hulls).deviation
    assert True in symbols
    assert (both <= without).all()
    assert (0.9 * without <= both * (1 + 1e-9)).all()
