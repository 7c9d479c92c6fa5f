"""A squash by an exponential that errs as far as it may, every other operation rounded in the direction that hurts."""

from __future__ import annotations

from itertools import product

import numpy as np

from tests.oracles import MP
from viatool.policy.activations import activation
from viatool.rounding import UNIT_ROUNDOFF
from viatool.taylor.rounding import activation_error

_EXPONENTIAL = 16
"""Roundings of an exponential, times its argument where that is above 1: what its own margin allows."""


def escape_of_squash(name: str) -> float:
    """Return by how much the worst program leaves the error of a sigmoid or a tanh, in float32 roundings."""
    unit = MP.mpf(UNIT_ROUNDOFF["float32"])
    worst = -np.inf
    for x in np.concatenate([[0.0, 1e-6, 1e-3], np.linspace(0.01, 3.0, 100), np.linspace(3.1, 80.0, 100)]):
        power = -2 * MP.mpf(x) if name == "Tanh" else -MP.mpf(x)
        exponential = MP.exp(power)
        exact = (1 - exponential) / (1 + exponential) if name == "Tanh" else 1 / (1 + exponential)
        argument = np.full((1, 1), x)
        allowed = activation_error(
            activation(name), "float32", (argument, argument), np.full((1, 1), float(exact))
        )
        for errs, above, below, whole in product((-1, 1), repeat=4):
            erring = exponential * (1 + errs * _EXPONENTIAL * unit * max(1, abs(power)))
            top = (1 - erring) * (1 + above * unit) if name == "Tanh" else MP.mpf(1)
            found = top / ((1 + erring) * (1 + below * unit)) * (1 + whole * unit)
            worst = max(worst, float((abs(found - exact) - MP.mpf(allowed[0, 0])) / unit))
    return worst
