"""The containment checks: how far anything that a network can do leaves the bounds that the engine gives."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests import attacks, oracles, runtimes
from viatool.policy.network import Network
from viatool.taylor import Box, ReachableSet, reach
from viatool.taylor.derivatives import gradient_bounds
from viatool.taylor.propagation import propagate

Floats = NDArray[np.float64]

EXACT_EVALUATIONS = 4
"""Points that are evaluated exactly in each check: those that come closest to the bounds in float64."""


@dataclass(frozen=True, eq=False)
class Bare:
    """A policy without a specification."""

    network: Network
    spec: Any = None


def bounds(network: Network, centre: Floats, eps: Floats, **options: Any) -> ReachableSet:
    """Return the reachable set of a network."""
    return reach(Bare(network), centre, eps, **options)


def escape_of_exact_values(
    network: Network, centre: Floats, eps: Floats, seed: int = 0, *, samples: int = 100, **options: Any
) -> float:
    """Return how far an exact value inside the box leaves the bounds for real arithmetic; 0 if none does.

    Points are sampled and attacked in float64; the decisive ones are evaluated as fractions or in 240 bits.
    """
    sets = bounds(network, centre, eps, arithmetic="real", **options)
    points = _points(network, centre, eps, np.random.default_rng([seed, 13]), samples)  # (S, B, n)
    values = _evaluated(network, points)  # (S, B, A)
    worst = 0.0
    above = _closest(sets.upper - values)
    below = _closest(values - sets.lower)
    for s, b, a in {*above, *below}:
        if oracles.is_rational(network):
            value = oracles.exact(network, points[s, b].tolist())[a]
            gaps = [value - _fraction(sets.upper[b, a]), _fraction(sets.lower[b, a]) - value]
        else:
            value = oracles.precise(network, points[s, b].tolist())[a]
            gaps = [value - oracles.MP.mpf(sets.upper[b, a]), oracles.MP.mpf(sets.lower[b, a]) - value]
        gap = max(gaps)
        worst = max(worst, max(float(gap), 5e-324) if gap > 0 else 0.0)
    return worst


def escape_of_programs(
    network: Network, centre: Floats, eps: Floats, seed: int = 0, *, samples: int = 60, **options: Any
) -> float:
    """Return how far a float32 program leaves the bounds: sums in any order, fused or not, onnxruntime."""
    sets = bounds(network, centre, eps, arithmetic="float32", **options)
    rng = np.random.default_rng([seed, 17])
    points = _points(network, centre, eps, rng, samples)
    flat = points.reshape(-1, points.shape[2])
    worst = 0.0
    outputs = [
        runtimes.run_in_any_order(network, flat, rng, fused=fused, sloppiness=sloppiness)
        for fused in (False, True)
        for sloppiness in (0, 2)
    ]
    if all(node.precision == "float32" for node in network.nodes):
        outputs.append(runtimes.run_onnx(network, flat))
    for output in outputs:
        values = output.reshape(*points.shape[:2], -1)
        assert not np.isnan(values).any()
        worst = max(worst, float((values - sets.upper).max()), float((sets.lower - values).max()))
    return worst


def escape_of_gradients(network: Network, lower: Floats, upper: Floats, seed: int = 0) -> float:
    """Return how far a true gradient of the first action leaves the bounds of gradients over boxes (B, n)."""
    rng = np.random.default_rng([seed, 19])
    chosen = np.zeros((lower.shape[0], network.output_size))
    chosen[:, 0] = 1.0
    with np.errstate(all="ignore"):
        hulls = [enclosure.hull for enclosure in propagate(network, Box(lower, upper))]
        low, high = gradient_bounds(network, hulls, chosen)
    worst = oracles.MP.mpf(0)
    for points in attacks.sample(lower, upper, 3, rng):
        for b in range(lower.shape[0]):
            for k, slope in enumerate(oracles.gradient(network, points[b].tolist(), 0)):
                slack = (1 + abs(slope)) * oracles.MP.mpf(10) ** -40
                worst = max(worst, slope - slack - high[b, k], low[b, k] - slope - slack)
    return float(worst)


def _points(network: Network, centre: Floats, eps: Floats, rng: np.random.Generator, samples: int) -> Floats:
    lower, upper = centre - eps, centre + eps
    actions = network.output_size
    found = [attacks.sample(lower, upper, samples, rng)]
    for action in range(actions):
        for sign in (1.0, -1.0):
            seed = np.zeros((centre.shape[0], actions))
            seed[:, action] = sign
            best, _ = attacks.attack(network, lower, upper, seed, rng, restarts=1, steps=6)
            found.append(best[None])
    return np.concatenate(found)


def _evaluated(network: Network, points: Floats) -> Floats:
    return network(points.reshape(-1, points.shape[2])).reshape(*points.shape[:2], -1)


def _closest(gap: Floats) -> list[tuple[int, int, int]]:
    """Return the indices (sample, state, action) of the smallest gaps, one for each state and action."""
    first = gap.argmin(axis=0)  # (B, A)
    least = np.take_along_axis(gap, first[None], axis=0)[0]
    order = np.argsort(least, axis=None)[: EXACT_EVALUATIONS // 2]
    states, actions = np.unravel_index(order, least.shape)
    return [(int(first[b, a]), int(b), int(a)) for b, a in zip(states, actions, strict=True)]


def _fraction(value: float) -> Any:
    from fractions import Fraction

    return Fraction(float(value))
