"""Parts of input boxes: what branch and bound has split so far, and how each part is bounded.

On a part the arguments of some neurons are known to lie on one side of a threshold. That shortens the interval on which
their activation is approximated, and it is used a second time as a condition in the dual bound.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viatool.arrays import Booleans, Floats, Hull, Indices
from viatool.policy.network import Activation, Network
from viatool.taylor.approximation import Approximation
from viatool.taylor.curve import curve_of
from viatool.taylor.duality import (
    DualProblem,
    SymbolLayout,
    descend,
    relaxation_conditions,
    solve_exactly,
    source_of,
)
from viatool.taylor.forms import Diagonal, Form
from viatool.taylor.kernel import ExaminedParts, Kernel, kernel_of
from viatool.taylor.propagation import Box, Enclosure, propagate
from viatool.taylor.refinement import Extrema, seeded_upper

_RESERVE, _LAST_RESERVE = 1e-3, 1e-9
"""Weights of symbols that the multipliers have cancelled: they are split when nothing else is left."""


@dataclass(frozen=True, eq=False)
class BoxParts:
    """K parts of the boxes of some questions.

    Parameters
    ----------
    owner : ndarray
        ``(K,)``: the question.
    node, neuron, side : ndarray
        ``(K, D)`` conditions on arguments of activations: below (-1) or above (+1) a threshold; side 0 is no condition.
    threshold : ndarray
        ``(K, D)``.
    bound : ndarray
        ``(K,)``: the best proved bound over the part.
    next_node, next_neuron, next_threshold : ndarray
        ``(K,)``: where to split next; node 0 where nothing is left to split.
    """

    owner: Indices
    node: Indices
    neuron: Indices
    side: Indices
    threshold: Floats
    bound: Floats
    next_node: Indices
    next_neuron: Indices
    next_threshold: Floats

    def rows(self, which: Indices | slice) -> BoxParts:
        """Return some of the parts."""
        return BoxParts(*(getattr(self, field.name)[which] for field in fields(self)))

    def joined(self, other: BoxParts) -> BoxParts:
        """Return these parts and some others, unused conditions padded."""
        depth = max(self.node.shape[1], other.node.shape[1])
        return BoxParts(
            *(
                np.concatenate([_padded(getattr(part, field.name), depth) for part in (self, other)])
                for field in fields(self)
            )
        )

    def halves(self) -> BoxParts:
        """Split every part at its next neuron: first all lower halves and then all upper ones."""
        count = self.owner.size
        twice = {field.name: np.concatenate([getattr(self, field.name)] * 2) for field in fields(self)}
        side = np.repeat(np.array([-1, 1]), count)
        for name, column in (
            ("node", twice["next_node"]),
            ("neuron", twice["next_neuron"]),
            ("side", side),
            ("threshold", twice["next_threshold"]),
        ):
            twice[name] = np.concatenate([twice[name], column[:, None]], axis=1)
        return BoxParts(**twice)


def _padded(values: NDArray[Any], depth: int) -> NDArray[Any]:
    if values.ndim == 1 or values.shape[1] == depth:
        return values
    padded = np.zeros((len(values), depth), dtype=values.dtype)
    padded[:, : values.shape[1]] = values
    return padded


def whole_boxes(extrema: Extrema, questions: Indices) -> BoxParts:
    """Return the boxes of some questions as parts without conditions, not yet examined."""
    none, zeros = np.zeros((questions.size, 0), dtype=np.intp), np.zeros(questions.size, dtype=np.intp)
    return BoxParts(
        questions,
        none,
        none,
        none,
        none.astype(float),
        extrema.bound[questions],
        zeros,
        zeros,
        zeros.astype(float),
    )


def examine(
    network: Network, extrema: Extrema, parts: BoxParts, target: Floats | None, rule: Approximation
) -> tuple[BoxParts, Floats]:
    """Bound parts, and find where to split each next.

    Parameters
    ----------
    network : Network
        n inputs, A outputs.
    extrema : Extrema
        P questions.
    parts : BoxParts
        K parts of their boxes.
    target : ndarray or None
        ``(P,)``: where nothing is left to split and the bound is above this, linear programming settles the part.
    rule : str
        How activations are approximated.

    Returns
    -------
    BoxParts
        The same parts, with bounds at most as large (minus infinity where no point of the box meets the conditions).
    ndarray
        ``(K, n)``: for each part a point of the box where its relaxation is largest.

    Notes
    -----
    **Sound:** yes, by weak duality. Where nothing is left to split the relaxation is the network itself, and linear
    programming finds multipliers that make the bound exact.
    """
    kernel = kernel_of(network, len(network.nodes)) if rule == "chebyshev" else None
    if kernel is None or not parts.owner.size:
        return _by_numpy(network, extrema, parts, target, rule)
    examined, points, known = _by_kernel(kernel, extrema, parts, exactly=target is not None)
    left = ~known.done
    if target is not None:  # what neither descent nor an interior point settled is for linear programming
        left |= (examined.next_node == 0) & ~known.solved & (examined.bound > target[parts.owner])
    rows = np.flatnonzero(left)
    if rows.size:
        others, points[rows] = _by_numpy(network, extrema, parts.rows(rows), target, rule)
        for each in ("bound", "next_node", "next_neuron", "next_threshold"):
            getattr(examined, each)[rows] = getattr(others, each)
    return examined, points


def _by_kernel(
    kernel: Kernel, extrema: Extrema, parts: BoxParts, *, exactly: bool
) -> tuple[BoxParts, Floats, ExaminedParts]:
    box, seed = extrema.box.rows(parts.owner), extrema.seed[parts.owner]
    action = np.abs(seed).argmax(axis=1)
    sign = np.take_along_axis(seed, action[:, None], axis=1)[:, 0]
    conditions = (parts.node, parts.neuron, parts.side, parts.threshold)
    found = kernel.examine(box.lower, box.upper, action, sign, conditions, exactly=exactly)
    bound = np.minimum(parts.bound, found.bound)
    examined = replace(
        parts, bound=bound, next_node=found.node, next_neuron=found.neuron, next_threshold=found.threshold
    )
    return examined, found.points, found


def _by_numpy(
    network: Network, extrema: Extrema, parts: BoxParts, target: Floats | None, rule: Approximation
) -> tuple[BoxParts, Floats]:
    box, seed = extrema.box.rows(parts.owner), extrema.seed[parts.owner]
    passes = propagate(network, box, rule=rule, limits=_limits(network, parts))
    layout = SymbolLayout.of(passes[-1].model)
    known = [
        _conditions(network, passes, parts, layout),
        relaxation_conditions(network, passes, seed, layout),
    ]
    problem = DualProblem.of(passes[-1].model, seed, layout, known)
    tilted, dual = problem.value(descend(problem))
    symbols = np.sign(tilted)
    weights = np.abs(tilted) + _RESERVE * np.abs(problem.objective)
    node, neuron, threshold = _next_split(network, passes, weights, layout)
    if target is not None and problem.slack.shape[1]:
        last = np.flatnonzero((node == 0) & (dual > target[parts.owner]))
        beta, symbols[last] = solve_exactly(problem.rows(last))
        dual[last] = np.minimum(dual[last], problem.rows(last).value(beta)[1])
    bound = np.minimum(parts.bound, np.minimum(dual, seeded_upper(passes[-1].hull, seed)))
    bound = np.where(_is_empty(network, passes, parts), -np.inf, bound)
    examined = replace(parts, bound=bound, next_node=node, next_neuron=neuron, next_threshold=threshold)
    return examined, _points(box, passes[0].model.linear, symbols)


def _points(box: Box, inputs: Form, symbols: Floats) -> Floats:
    """Return the points (K, n) of the boxes that some symbols (K, S), inputs first, stand for."""
    assert isinstance(inputs, Diagonal)
    points = box.centre
    moved = inputs.radius * symbols[:, : inputs.symbols]
    np.put_along_axis(points, inputs.index, np.take_along_axis(points, inputs.index, axis=1) + moved, axis=1)
    return np.clip(points, box.lower, box.upper)


def _limits(network: Network, parts: BoxParts) -> dict[int, Hull]:
    """Turn conditions into bounds of the arguments of each activation node."""
    limits: dict[int, Hull] = {}
    rows = np.arange(parts.owner.size)
    for d in range(parts.node.shape[1]):
        for node in np.unique(parts.node[:, d][parts.side[:, d] != 0]).tolist():
            shape = (rows.size, network.nodes[node].size)
            lower, upper = limits.setdefault(node, (np.full(shape, -np.inf), np.full(shape, np.inf)))
            for side, values, better in ((1, lower, np.maximum), (-1, upper, np.minimum)):
                here = rows[(parts.node[:, d] == node) & (parts.side[:, d] == side)]
                neuron = parts.neuron[here, d]
                values[here, neuron] = better(values[here, neuron], parts.threshold[here, d])
    return limits


def _conditions(
    network: Network, passes: list[Enclosure], parts: BoxParts, layout: SymbolLayout
) -> tuple[Floats, Floats]:
    """Write each condition as a form (K, D, S) plus its largest constant (K, D); rows without a condition are 0."""
    depth = parts.node.shape[1]
    forms, slack = np.zeros((parts.owner.size, depth, layout.size)), np.zeros((parts.owner.size, depth))
    for d in range(depth):
        for node in np.unique(parts.node[:, d][parts.side[:, d] != 0]).tolist():
            rows = np.flatnonzero((parts.node[:, d] == node) & (parts.side[:, d] != 0))
            model = passes[source_of(network, node)].model.rows(rows)
            neuron, side = parts.neuron[rows, d, None], parts.side[rows, d]
            columns, constant, spare = layout.columns(model, neuron)
            forms[rows, d] = side[:, None] * columns[:, 0]
            centre = side * (constant[:, 0] - parts.threshold[rows, d])
            slack[rows, d] = centre + spare[:, 0] + 1e-13 * np.abs(centre)
    return forms, slack


def _is_empty(network: Network, passes: list[Enclosure], parts: BoxParts) -> Booleans:
    """Tell which parts hold no point: a hull of theirs is crossed, or lies beyond what is asked of it, (K,)."""
    empty = np.zeros(parts.owner.size, dtype=bool)
    for each in passes:
        empty |= (each.lower > each.upper).any(axis=1)
    for node, (lower, upper) in _limits(network, parts).items():
        argument = passes[source_of(network, node)]
        empty |= ((lower > argument.upper) | (upper < argument.lower)).any(axis=1)
    return empty


def _next_split(
    network: Network, passes: list[Enclosure], weights: Floats, layout: SymbolLayout
) -> tuple[Indices, Indices, Floats]:
    """Pick, for each part, the neuron whose symbolic remainder weighs most in the bound, and its threshold.

    Node 0 is returned only where no activation has an approximation error left.
    """
    count = weights.shape[0]
    best, node = np.zeros(count), np.zeros(count, dtype=np.intp)
    neuron, threshold = np.zeros(count, dtype=np.intp), np.zeros(count)
    for key, columns in layout.slices.items():
        if key == 0 or not isinstance(network.nodes[key], Activation):
            continue
        fresh = passes[key].model.symbols[key]
        assert isinstance(fresh, Diagonal)
        weight = weights[:, columns] + _LAST_RESERVE * fresh.radius
        slot = weight.argmax(axis=1)[:, None]
        share = np.take_along_axis(weight, slot, axis=1)[:, 0]
        chosen = np.take_along_axis(fresh.index, slot, axis=1)[:, 0]
        better = share > best
        best, node = np.where(better, share, best), np.where(better, key, node)
        neuron = np.where(better, chosen, neuron)
        threshold = np.where(better, _threshold(network, passes, key, chosen), threshold)
    return node, neuron, threshold


def _threshold(network: Network, passes: list[Enclosure], node: int, neuron: Indices) -> Floats:
    """Return the kink inside the argument's range, or the middle of that range."""
    activation = network.nodes[node]
    assert isinstance(activation, Activation)
    argument = passes[activation.source]
    rows = np.arange(neuron.size)
    lower, upper = argument.lower[rows, neuron], argument.upper[rows, neuron]
    threshold = lower / 2 + upper / 2
    for kink in curve_of(activation.function).breaks.tolist():
        threshold = np.where((lower < kink) & (kink < upper), kink, threshold)
    return threshold
