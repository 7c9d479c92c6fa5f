"""Which numbers of an observation decide: by how much the error of each moves the clearance, to first order.

The Taylor model of order 1 gives every command as a linear form of the errors; the paths give by how much the clearance
changes with the command. Their product says how many metres of clearance the error of an entry takes. It is a ranking,
and proves nothing.
"""

from __future__ import annotations

import numpy as np

from viatool.arrays import Floats
from viatool.policy.network import Network
from viatool.safety import JudgedStates
from viatool.setting.driven import DrivenPolicy
from viatool.taylor.correlated import input_model, reach_linear
from viatool.verification.examination import StateExamination
from viatool.verification.states import States

_FRACTIONS = np.linspace(0.0, 1.0, 21)
_MOST_FLOATS = 2**21
_LEAST = 1e-6
"""Half of the width of a command below which it is moved by so much."""


def deciding_weights(examination: StateExamination, states: States) -> Floats:
    """Return which part of what the errors move the clearance by is due to each of n inputs, (B, n).

    Parts add up to 1 in each state, or are all 0 where no error moves it.

    Notes
    -----
    Sound: no, of first order, and what reads together is taken entry by entry.
    """
    sensors = examination.sensors(states, examination.placed(states))
    judged = sensors.judged
    policy = examination.setting.driven(examination.policy)
    lower, upper = sensors.bounds
    centre, radius = 0.5 * (lower + upper), 0.5 * (upper - lower)
    count, size = centre.shape
    chunk, weights = max(1, _MOST_FLOATS // size**2), np.zeros((count, size))
    for first in range(0, count, chunk):
        rows = np.arange(first, min(first + chunk, count))
        slope, ends = _slopes(policy.network, centre[rows], radius[rows])
        gain = _gains(policy, judged.select(rows), centre[rows], *ends)
        weights[rows] = np.abs(np.einsum("bna,ba->bn", slope, gain))
    weights = np.nan_to_num(weights, nan=0.0, posinf=0.0)
    total = weights.sum(axis=1, keepdims=True)
    return np.asarray(np.divide(weights, total, out=np.zeros_like(weights), where=total > 0.0))


def _slopes(network: Network, centre: Floats, radius: Floats) -> tuple[Floats, tuple[Floats, Floats]]:
    """Return the outputs as linear forms of the errors, (B, n, A), and their ends (B, A)."""
    size = centre.shape[1]
    inputs = input_model(centre, radius[:, None] * np.eye(size), np.zeros_like(centre))
    found = reach_linear(network, inputs, size)
    return found.slope, (found.lower, found.upper)


def _gains(
    policy: DrivenPolicy, judged: JudgedStates, centre: Floats, lower: Floats, upper: Floats
) -> Floats:
    """Return by how much clearance changes with each output, (B, O), about.

    Of a choice, what decides between the two commands whose numbers are the largest.
    """
    if policy.choice is not None:
        outputs = policy.network(centre)
        first, second = np.argsort(-outputs, axis=1, kind="stable")[:, :2].T
        unit = np.eye(outputs.shape[1])
        return np.asarray(unit[first] - unit[second])
    rules = judged.rules
    low, high = (rules.clip(np.nan_to_num(end)) for end in (lower, upper))
    middle, half = 0.5 * (low + high), np.maximum(0.5 * (high - low), _LEAST)
    steps = np.eye(middle.shape[1]) * half[:, None]
    around = rules.clip(np.concatenate([middle[:, None] + steps, middle[:, None] - steps], axis=1))
    ahead, behind = np.split(judged.clearance(around, _FRACTIONS).min(axis=2), 2, axis=1)
    gain = (ahead - behind) / (2.0 * half)
    flat = ~gain.any(axis=1)  # where it has hit something, and no command makes a difference
    gain[flat] = 1.0 / (rules.upper - rules.lower)
    return np.asarray(gain)
