"""Back-substitution: rows of weights from the neurons of one node back to the inputs, between lines on both sides.

Forward models give every activation one slope, with an error on both sides of its line. Going backwards, what raises
the bound follows a line above the activation and what lowers it one below, each with the slope that is best there.
Neither way is always the tighter one, so their bounds are met. docs/kernel.md derives the rounding (K11).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from viatool.arrays import Floats, Hull
from viatool.policy.network import Activation, Affine, Cast, Input, Maximum, Minimum, Network, Product
from viatool.rounding import ENGINE_ROUNDOFF, SLIGHTLY_MORE
from viatool.taylor.approximation import pick_slope, residual_range
from viatool.taylor.curve import Curve, curve_of
from viatool.taylor.rounding import gamma, magnitude

Line = tuple[Floats, Floats]
"""Slopes and shifts, (B, N) each."""

_LOST = 1e-280
"""More than what all products together lose where they underflow."""


def hull_backwards(network: Network, hulls: Sequence[Hull]) -> Hull:
    """Bound the last node of a network by following its neurons back to the inputs.

    Parameters
    ----------
    network : Network
        n inputs, A outputs.
    hulls : sequence of (lower, upper)
        Bounds of every node over B boxes.

    Returns
    -------
    tuple of ndarray
        Lower and upper bounds, (B, A); infinite where nothing is known.

    Notes
    -----
    **Sound:** yes; the float64 rounding of rows and sums is counted. Cost: one product of weights for each output.
    """
    actions = network.output_size
    bounds = _bound_from_above(network, hulls, np.concatenate([np.eye(actions), -np.eye(actions)]))
    return -bounds[:, actions:], bounds[:, :actions]


def _bound_from_above(network: Network, hulls: Sequence[Hull], seeds: Floats) -> Floats:
    """Bound combinations (K, A) of the outputs from above, (B, K)."""
    last, batch = len(network.nodes) - 1, hulls[0][0].shape[0]
    rows: dict[int, Floats] = {last: np.broadcast_to(seeds, (batch, *seeds.shape))}
    total, size = np.zeros((2, batch, len(seeds)))
    for index in range(last, 0, -1):
        if index not in rows:
            continue
        row, node = rows.pop(index), network.nodes[index]
        match node:
            case Affine():
                total, size = (
                    total + row @ node.bias,
                    size + _weighed(np.abs(row), _size_of(node, hulls, len(row))),
                )
                for source, weight in zip(node.sources, node.weights, strict=True):
                    rows[source] = rows.get(source, 0.0) + row @ weight
            case Activation():
                pulled = np.zeros(row.shape)
                lines = lines_around(curve_of(node.function), *hulls[node.source])
                for (slope, shift), part in zip(
                    lines, (np.maximum(row, 0.0), np.minimum(row, 0.0)), strict=True
                ):
                    pulled, total = pulled + part * slope[:, None], total + _weighed(part, shift)
                    held = np.abs(slope) * magnitude(hulls[node.source]) + np.abs(shift)
                    size = size + _weighed(np.abs(part), held)
                rows[node.source] = rows.get(node.source, 0.0) + pulled
            case Cast():
                rows[node.source] = rows.get(node.source, 0.0) + row
            case Input() | Product() | Maximum() | Minimum():
                return np.full((batch, len(seeds)), np.inf)
    row, (lower, upper) = rows.get(0, np.zeros((batch, len(seeds), network.input_size))), hulls[0]
    total = total + _weighed(np.maximum(row, 0.0), upper) + _weighed(np.minimum(row, 0.0), lower)
    size = size + _weighed(np.abs(row), magnitude(hulls[0]))
    lost = _LOST * (1.0 + sum(magnitude(hull).sum(axis=1) for hull in hulls))
    bound = total + 2 * gamma(_roundings(network), ENGINE_ROUNDOFF) * size + lost[:, None]
    return np.where(np.isnan(bound), np.inf, bound)


def lines_around(curve: Curve, lower: Floats, upper: Floats) -> tuple[Line, Line]:
    """Return lines above and below a curve on intervals (B, N), the best of a few in the middle.

    **Sound:** yes: whatever the slope, the shift bounds what the curve is away from it.
    """
    ends, shape = (lower.ravel(), upper.ravel()), lower.shape
    middle = ends[0] / 2 + ends[1] / 2
    slopes = [pick_slope(curve, *ends, "chebyshev"), *(curve.value(x, 1) for x in (middle, *ends))]
    best = [np.full((2, middle.size), [[0.0], [np.inf]]) for _ in range(2)]
    for slope in (np.where(np.isfinite(each), each, 0.0) for each in slopes):
        residual = residual_range(curve, *ends, slope)
        for line, sign, shift in zip(best, (1.0, -1.0), (residual.upper, -residual.lower), strict=True):
            better = sign * slope * middle + shift < line[0] * middle + line[1]
            line[:, better] = sign * slope[better], shift[better]
    above, below = (line.reshape(2, *shape) for line in best)
    return (above[0], above[1]), (-below[0], -below[1])


def _weighed(rows: Floats, values: Floats) -> Floats:
    """Return the sum of weights (B, K, N) times values (B, N)."""
    return np.asarray(np.einsum("bkn,bn->bk", rows, values))


def _size_of(node: Affine, hulls: Sequence[Hull], count: int) -> Floats:
    """Bound the sum of the absolute values of all that a node adds up, (B, N)."""
    parts = (
        magnitude(hulls[source]) @ merged.T
        for source, merged in zip(node.sources, node.magnitudes, strict=True)
    )
    return np.asarray(sum(parts, np.tile(node.bias_magnitude, (count, 1))) * SLIGHTLY_MORE)


def _roundings(network: Network) -> int:
    """Return the roundings of a sum over all neurons, each with those of its weight."""
    affine = [node for node in network.nodes if isinstance(node, Affine)]
    most = max((node.size + node.roundings for node in affine), default=0)
    return sum(node.size for node in network.nodes) + most + len(network.nodes) + 10
