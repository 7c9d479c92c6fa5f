"""Deep networks: folded symbols lose nothing that the remainder does not cover."""

from __future__ import annotations

from contextlib import contextmanager

import numpy as np
import pytest

from viatool.policy.activations import activation
from viatool.policy.network import Activation, Affine, Input, Network
from viatool.taylor import forms, reach
from viatool.taylor.forms import Dense, Diagonal
from viatool.taylor.model import TaylorModel
from viatool.taylor.propagation import Box, propagate


def make_model(rng, size, symbols):
    """Two states with inputs, symbols of two nodes and a remainder."""
    linear = Dense(rng.normal(size=(2, 5, size)))
    index = np.broadcast_to(np.arange(symbols), (2, symbols))
    forms = {
        2: Dense(rng.normal(size=(2, symbols, size))),
        4: Diagonal(index, rng.random((2, symbols)), size),
    }
    radius = linear.norms() + forms[2].norms() + forms[4].norms()
    return TaylorModel(
        rng.normal(size=(2, size)), linear, None, forms, 1e-12 * rng.random((2, size)), radius * (1 + 1e-12)
    )


@contextmanager
def most_symbols(count):
    """Let models keep `count` symbols at most."""
    before = forms.MOST_SYMBOLS
    forms.MOST_SYMBOLS = count
    try:
        yield
    finally:
        forms.MOST_SYMBOLS = before


def wrong_foldings():
    """By how much folded symbols reach beyond the remainder that took them in."""
    model = make_model(np.random.default_rng(3), 12, 10)
    with most_symbols(12):
        symbols, remainder = forms.fold_symbols(model.symbols, model.remainder)
    assert set(symbols) == {2}  # the other node weighs less
    return float((model.symbols[4].norms() - (remainder - model.remainder) * (1 + 1e-9)).max())


def test_folded_symbols_are_covered():
    assert wrong_foldings() <= 0


def test_few_symbols_stay_as_they_are():
    model = make_model(np.random.default_rng(3), 12, 10)
    symbols, remainder = forms.fold_symbols(model.symbols, model.remainder)
    assert symbols is model.symbols
    assert remainder is model.remainder


class Bare:
    spec = None

    def __init__(self, network):
        self.network = network


def deep_network(depth, width, hidden, rng):
    nodes = [Input(6)]
    for size, before in zip([width] * depth + [2], [6] + [width] * depth, strict=True):
        weight = rng.normal(size=(size, before)) * np.sqrt(1.6 / before)
        nodes.append(Affine((len(nodes) - 1,), (weight,), 0.1 * rng.normal(size=size)))
        nodes.append(Activation(len(nodes) - 1, activation("Tanh" if size == 2 else hidden), size))
    return Network(tuple(nodes))


@pytest.mark.parametrize("hidden", ["Relu", "Elu"])
def test_no_action_of_a_deep_network_escapes(hidden):
    rng = np.random.default_rng(5)
    policy = Bare(deep_network(4, 130, hidden, rng))
    states = rng.uniform(-1, 1, (3, 6))
    with most_symbols(160):
        found = reach(policy, states, 0.05, refine="none", arithmetic="real")
    points = states[:, None] + 0.05 * rng.choice([-1.0, 1.0, 0.3], size=(3, 300, 6))
    actions = policy.network(points.reshape(-1, 6)).reshape(3, 300, 2)
    assert (actions >= found.lower[:, None]).all()
    assert (actions <= found.upper[:, None]).all()


def test_folding_only_widens():
    rng = np.random.default_rng(5)
    network, states = deep_network(4, 130, "Elu", rng), rng.uniform(-1, 1, (3, 6))

    def width():
        last = propagate(network, Box(states - 0.01, states + 0.01))[-1]
        return last.upper - last.lower

    plain = width()
    with most_symbols(100):
        folded = width()
    assert (folded >= plain).all()
    assert (folded > 1.1 * plain).any()
