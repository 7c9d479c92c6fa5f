"""A softmax that rounds at every step in the direction that hurts, in high precision."""

from __future__ import annotations

from typing import Any

import numpy as np

from tests.oracles import MP
from viatool.policy.activations import activation
from viatool.rounding import SMALLEST_NORMAL, UNIT_ROUNDOFF
from viatool.taylor.rounding import activation_error

_EXPONENTIAL = 16
"""Roundings of an exponential, times the larger of 1 and its argument: the programs that are known have at most 2."""

_LOGARITHM = 4
"""Roundings of a logarithm: the programs that are known have at most 2."""

LOGITS: tuple[tuple[float, ...], ...] = (
    (0.0, -70.0),
    (0.0, 0.0),
    (1.0, -2.0, 0.5, -30.0, 3.0),
    (0.0,) * 64,
    (0.0,) + (-3.0,) * 63,
    tuple(np.linspace(-20, 20, 64)),
)


def escape_of_softmax(name: str) -> float:
    """Return by how much, in float32 roundings, the worst program leaves the error of a softmax or its logarithm."""
    worst = 0.0
    for logits in LOGITS:
        function = activation(name, terms=float(len(logits)))
        for chosen in range(len(logits)):
            exact, moved, odds = _exact_and_rounded(logits, chosen, logarithm=name == "LogSoftmax")
            argument = np.array([[float(odds)]])
            value = np.array([[float(abs(exact)) * (1 + 1e-12)]])
            allowed = float(np.max(activation_error(function, "float32", (argument, argument), value)))
            worst = max(worst, float(max(abs(m - exact) for m in moved) - allowed) / UNIT_ROUNDOFF["float32"])
    return worst


def _exact_and_rounded(logits: tuple[float, ...], chosen: int, *, logarithm: bool) -> tuple[Any, Any, Any]:
    unit, tiny = MP.mpf(UNIT_ROUNDOFF["float32"]), MP.mpf(SMALLEST_NORMAL["float32"])
    largest = max(logits)
    powers = [MP.exp(MP.mpf(logit) - largest) for logit in logits]
    total = MP.fsum(powers)
    others = MP.fsum(power for k, power in enumerate(powers) if k != chosen)
    odds = MP.log(powers[chosen] / others)
    exact = MP.log(powers[chosen] / total) if logarithm else powers[chosen] / total
    moved = []
    for sign in (-1, 1):  # the numerator is rounded one way, the sum the other way

        def rounded(k: int, way: int) -> Any:
            difference = MP.mpf(logits[k]) - largest
            error = abs(difference) + _EXPONENTIAL * max(1, abs(difference))
            return MP.exp(difference) * (1 + way * error * unit) + way * tiny

        added = MP.fsum(rounded(k, -sign) for k in range(len(logits)))
        added = max(added, 1 - 2 * _EXPONENTIAL * unit) * (1 - sign * unit) ** len(logits)
        if logarithm:
            difference = MP.mpf(logits[chosen]) - largest
            term = difference + sign * abs(difference) * unit
            subtracted = MP.log(added)
            result = term - subtracted + sign * _LOGARITHM * unit * abs(subtracted)
            moved.append(result + sign * abs(result) * unit)
        else:
            moved.append(rounded(chosen, sign) / added * (1 + sign * unit))
    return exact, moved, odds
