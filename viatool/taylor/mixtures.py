"""Excluding commands of curved networks: weighted means of differences, with curvature as squares, over split boxes.

A command k is chosen only where all of its differences ``output k - output j`` are at least 0, and then so is each of
their weighted means. So it is excluded by weights ``w_j >= 0`` for which ``sum_j w_j (output k - output j)`` is below 0
all over a box, and other weights may do so in other parts of it. Of a curved network the mean is bounded as a sum of
squares (`squares`), which sees what neurons have in common; splitting neurons one by one hardly helps there, as the
error is spread over all of them. Boxes are halved along the input that bends the mean most.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from viatool.arrays import Booleans, Floats, Indices
from viatool.policy.network import Network
from viatool.taylor.approximation import Approximation
from viatool.taylor.duality import SymbolLayout
from viatool.taylor.forms import Diagonal
from viatool.taylor.memory import LARGEST_FLOATS, affordable_squares
from viatool.taylor.propagation import Box, Enclosure, propagate
from viatool.taylor.squares import SquareProblem

_AT_ONCE = 8
"""Parts of one question that are halved in one round."""
_DESCENTS = 24
_GRID = 2.0**20
"""Weights are whole multiples of 1 / this, so that their sums are exact."""


@dataclass(frozen=True, eq=False)
class _Parts:
    """K parts of the boxes of some questions.

    Parameters
    ----------
    owner : ndarray
        (K,) the question.
    lower, upper : ndarray
        (K, n).
    bound : ndarray
        (K,) of the best mean that was found.
    """

    owner: Indices
    lower: Floats
    upper: Floats
    bound: Floats

    def rows(self, which: Indices | Booleans) -> _Parts:
        return _Parts(self.owner[which], self.lower[which], self.upper[which], self.bound[which])

    def joined(self, other: _Parts) -> _Parts:
        names = ("owner", "lower", "upper", "bound")
        return _Parts(*(np.concatenate([getattr(self, name), getattr(other, name)]) for name in names))

    def halves(self, axis: Indices) -> _Parts:
        """Cut each part across an input, (K,)."""
        rows, middle = np.arange(len(self.owner)), 0.5 * (self.lower + self.upper)
        below, above = self.upper.copy(), self.lower.copy()
        below[rows, axis] = above[rows, axis] = middle[rows, axis]
        return _Parts(self.owner, self.lower, below, self.bound).joined(
            _Parts(self.owner, above, self.upper, self.bound)
        )


def excluded_by_means(
    network: Network,
    box: Box,
    command: Indices,
    stray: Floats,
    *,
    rule: Approximation,
    parts: int,
    attained: Callable[[Floats, Indices], Booleans],
) -> Booleans:
    """Tell which commands no observation of a box selects.

    Parameters
    ----------
    network : Network
        n inputs, K outputs.
    box : Box
        (P, n).
    command : ndarray
        (P,) the command that is asked about in each.
    stray : ndarray
        (P,) by how much a program's difference may be above the network's.
    rule : str
        How activations are approximated.
    parts : int
        Parts of a box that are looked at.
    attained : callable
        Of points (M, n) and which questions they belong to, (M,), tells where the program selects the command, (M,).

    Returns
    -------
    ndarray
        (P,) bool.

    Notes
    -----
    **Sound:** yes; a bound that is not a number excludes nothing.
    """
    count = len(command)
    given_up, spent = np.zeros(count, dtype=bool), np.zeros(count, dtype=np.int64)
    fresh = _Parts(np.arange(count), box.lower, box.upper, np.full(count, np.inf))
    waiting, axes = fresh.rows(np.zeros(0, np.int64)), np.zeros(0, np.int64)
    enough = -2.0 * stray  # the weights of a mean sum to less than 2
    while len(fresh.owner):
        found = [
            _bounded(network, Box(fresh.lower[rows], fresh.upper[rows]), command[fresh.owner[rows]], rule)
            for rows in _blocks(network, len(fresh.owner))
        ]
        bound, axis, points = (np.concatenate(column) for column in zip(*found, strict=True))
        np.add.at(spent, fresh.owner, 1)
        given_up[fresh.owner[attained(points, fresh.owner)]] = True
        fresh = _Parts(fresh.owner, fresh.lower, fresh.upper, np.fmin(fresh.bound, bound))
        open_ = ~(fresh.bound < enough[fresh.owner])
        left, axes = waiting.joined(fresh.rows(open_)), np.concatenate([axes, axis[open_]])
        given_up[left.owner] |= (spent >= parts)[left.owner]
        kept = ~given_up[left.owner]
        left, axes = left.rows(kept), axes[kept]
        chosen = _largest_of_each(left)
        waiting, fresh = left.rows(~chosen), left.rows(chosen).halves(axes[chosen])
        axes = axes[~chosen]
    return ~given_up


def _bounded(
    network: Network, box: Box, command: Indices, rule: Approximation
) -> tuple[Floats, Indices, Floats]:
    """Bound the least mean of the differences of commands over boxes (K, n); (K,), where to cut, and points (K, n)."""
    passes = propagate(network, box, rule=rule)
    inputs = passes[0].model.linear
    assert isinstance(inputs, Diagonal)
    seed = _seeds(passes, command)
    symbols = SymbolLayout.of(passes[-1].model).size
    neurons = max(1, affordable_squares(symbols, seed.shape[1]))
    problem = SquareProblem.of(network, passes, seed, neurons=neurons, rule=rule)
    bounds, rows = problem.upper(), np.arange(len(command))
    best = np.where(np.isnan(bounds), np.inf, bounds).argmin(axis=1)
    free = inputs.symbols
    slope, weights = problem.linear[rows, best][:, :free], problem.weights[rows, best]
    bend = np.einsum("kc,kcs->ks", np.abs(weights), np.square(problem.forms[:, :, :free]))
    axis = np.zeros(len(rows), np.int64)
    points = box.centre
    if free:
        axis = inputs.index[rows, (bend + 1e-6 * np.abs(slope) + 1e-30 * inputs.radius).argmax(axis=1)]
        moved = np.take_along_axis(points, inputs.index, axis=1) + inputs.radius * np.sign(slope)
        np.put_along_axis(points, inputs.index, moved, axis=1)
    return bounds[rows, best], axis, np.clip(points, box.lower, box.upper)


def _seeds(passes: list[Enclosure], command: Indices) -> Floats:
    """Return the means that are asked about, as combinations of the outputs, (K, 2, A): one difference, and a mean."""
    model = passes[-1].model
    count, size = model.constant.shape
    layout = SymbolLayout.of(model)
    everyone = np.broadcast_to(np.arange(size), model.constant.shape)
    form, constant, spare = layout.columns(model, everyone)
    form = form[:, :, layout.slices[0]]
    rows = np.arange(count)
    apart = form[rows, command][:, None] - form  # (K, A, V), 0 for the command itself
    level = constant[rows, command][:, None] - constant + spare[rows, command][:, None] + spare
    level[rows, command] = np.inf
    first = np.abs(apart).sum(axis=2) + level
    weights = np.zeros((count, 2, size))
    weights[rows, 0, first.argmin(axis=1)] = 1.0
    weights[:, 1] = _mean(apart, level)
    weights = np.round(weights * _GRID) / _GRID
    seed = -weights
    seed[rows, :, command] += weights.sum(axis=2)
    return seed


def _mean(apart: Floats, level: Floats) -> Floats:
    """Return weights (K, A) for which ``level . w + |apart^T w|_1`` is small: mirror descent on their simplex."""
    there = np.isfinite(level)
    level = np.where(there, level, 0.0)
    weights = there / there.sum(axis=1, keepdims=True)
    best, least = weights, np.full(len(weights), np.inf)
    for turn in range(_DESCENTS):
        total = np.einsum("kav,ka->kv", apart, weights)
        value = (level * weights).sum(axis=1) + np.abs(total).sum(axis=1)
        better = value < least
        best, least = np.where(better[:, None], weights, best), np.where(better, value, least)
        slope = level + np.einsum("kav,kv->ka", apart, np.sign(total))
        slope = np.where(there, slope - slope.min(axis=1, keepdims=True, where=there, initial=np.inf), 0.0)
        largest = slope.max(axis=1, keepdims=True)
        step = 4.0 / np.sqrt(turn + 1.0) / np.where(largest > 0.0, largest, 1.0)
        weights = there * weights * np.exp(-step * slope)
        weights = weights / weights.sum(axis=1, keepdims=True)
    return np.where(np.isfinite(best), best, 0.0)


def _blocks(network: Network, count: int) -> list[slice]:
    """Cut K parts into those whose squares are bounded together."""
    symbols = network.input_size + sum(node.size for node in network.nodes[1:])
    step = int(np.clip(LARGEST_FLOATS // (symbols * symbols), 1, 64))
    return [slice(start, min(start + step, count)) for start in range(0, count, step)]


def _largest_of_each(parts: _Parts) -> Booleans:
    """Mark the parts with the largest bounds of each question."""
    order = np.lexsort((-parts.bound, parts.owner))
    owner = parts.owner[order]
    new = np.ones(len(owner), dtype=bool)
    new[1:] = owner[1:] != owner[:-1]
    starts = np.flatnonzero(new)
    rank = np.arange(len(owner)) - np.repeat(starts, np.diff(np.append(starts, len(owner))))
    chosen = np.zeros(len(owner), dtype=bool)
    chosen[order] = rank < _AT_ONCE
    return chosen
