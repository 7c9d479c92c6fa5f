"""Tighter bounds than one pass gives: monotone collapse.

Where an action provably rises or falls with an input over the whole box, its extremum lies on the face of the box where
that input is at its end. Fixing such inputs shrinks the box, a smaller box decides more derivatives, and so on; when no
input is left the bound is the value of the network itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from viatool.arrays import Floats, Hull, Indices
from viatool.policy.network import Network
from viatool.taylor.approximation import Approximation
from viatool.taylor.derivatives import gradient_bounds
from viatool.taylor.deviation import runtime_deviation
from viatool.taylor.duality import DualEffort, DualProblem, SymbolLayout, descend, relaxation_conditions
from viatool.taylor.higher_order import higher_hulls
from viatool.taylor.memory import (
    CACHED_FLOATS,
    LARGEST_FLOATS,
    affordable_squares,
    blocks_of_questions,
    floats_of_order,
)
from viatool.taylor.propagation import Box, Enclosure, is_curved, propagate
from viatool.taylor.squares import SquareProblem

ROUNDS = 4
"""How often the box of a question is shrunk."""

_NEURONS_OF_A_STATE = 96
"""Neurons of one layer that the dual bounds of one state look at, over all questions, when nothing else is refined."""


@dataclass(frozen=True, eq=False)
class Extrema:
    """P one-sided questions: the largest value of ``seed . actions`` over each box.

    Parameters
    ----------
    box : Box
        ``(P, n)``: boxes that contain a point where the maximum is attained.
    seed : ndarray
        ``(P, A)``: +1 or -1 for the maximum or minimum of one action, 0 for the others.
    bound : ndarray
        ``(P,)``: proved upper bounds.
    """

    box: Box
    seed: Floats
    bound: Floats

    def rows(self, which: Indices | slice) -> Extrema:
        """Return some of the questions."""
        return Extrema(self.box.rows(which), self.seed[which], self.bound[which])

    def met(self, bound: Floats) -> Extrema:
        """Return the same questions with bounds (P,) that hold as well; one that is not a number says nothing."""
        return Extrema(self.box, self.seed, np.fmin(self.bound, bound))


def extrema_of(box: Box, lower: Floats, upper: Floats) -> Extrema:
    """Ask for the maximum and the minimum of every action over B boxes, given bounds (B, A) of the actions.

    Returns
    -------
    Extrema
        ``2 A B`` questions: first all maxima and then all minima, each by action and then by state.
    """
    batch, actions = lower.shape
    seed = np.repeat(np.concatenate([np.eye(actions), -np.eye(actions)]), batch, axis=0)
    copies = Box(np.tile(box.lower, (2 * actions, 1)), np.tile(box.upper, (2 * actions, 1)))
    return Extrema(copies, seed, np.concatenate([upper.T.ravel(), -lower.T.ravel()]))


def joined(parts: Sequence[Extrema]) -> Extrema:
    """Put questions one after the other."""
    box = Box(*(np.concatenate([getattr(part.box, side) for part in parts]) for side in ("lower", "upper")))
    return Extrema(
        box, *(np.concatenate([getattr(part, name) for part in parts]) for name in ("seed", "bound"))
    )


def unfold(values: Floats, actions: int) -> Hull:
    """Turn the answers to `extrema_of`, (2 A B,), into lower and upper values of the actions, (B, A) each."""
    upper, negated_lower = values.reshape(2, actions, -1)
    return -negated_lower.T, upper.T


def collapse_monotone(network: Network, box: Box, hulls: Sequence[Hull], seed: Floats) -> Box:
    """Shrink boxes to the face on which a combination of the actions attains its maximum.

    Parameters
    ----------
    network : Network
        n inputs, A outputs.
    box : Box
        ``(P, n)``.
    hulls : sequence of (lower, upper)
        Bounds of every node over the boxes.
    seed : ndarray
        ``(P, A)``: the combination to maximise.

    Returns
    -------
    Box
        ``(P, n)``; every input whose partial derivative keeps its sign has width 0.

    Notes
    -----
    **Sound:** yes; derivative bounds are rounded outward and count every generalised derivative at kinks, so the
    combination is monotone along every segment of the box in such an input.
    """
    low, high = gradient_bounds(network, hulls, seed)
    rises, falls = low >= 0, (high <= 0) & (low < 0)
    return Box(np.where(rises, box.upper, box.lower), np.where(falls, box.lower, box.upper))


def refine_monotone(
    network: Network, extrema: Extrema, passes: Sequence[Enclosure], *, rule: Approximation
) -> Extrema:
    """Tighten one-sided bounds by repeated monotone collapse, and by duality where it ends short of a point.

    Parameters
    ----------
    network : Network
        n inputs, A outputs.
    extrema : Extrema
        ``2 A B`` questions, as `extrema_of` asks them, with the bounds known so far.
    passes : sequence of Enclosure
        The forward pass over the B boxes.
    rule : str
        How activations are approximated in the passes over the shrunken boxes.

    Returns
    -------
    Extrema
        The same questions over smaller boxes, with bounds at most as large.

    Notes
    -----
    **Sound:** yes. A box without free inputs is a point, bounded by the value of the network and its float64 rounding.
    """
    batch = passes[0].lower.shape[0]
    refined = [
        _refined(network, extrema.rows(block), passes, np.arange(block.start, block.stop) % batch, rule)
        for block in blocks_of_questions(network, extrema.bound.size)
    ]
    return joined(refined) if refined else extrema


def _refined(
    network: Network, extrema: Extrema, passes: Sequence[Enclosure], places: Indices, rule: Approximation
) -> Extrema:
    """Refine P questions together, given passes and where in them the box of each stands, (P,)."""
    lower, upper, bound = extrema.box.lower.copy(), extrema.box.upper.copy(), extrema.bound.copy()
    rows: Indices = np.arange(bound.size)
    for turn in range(ROUNDS):
        seed = extrema.seed[rows]
        hulls = [(enclosure.lower[places], enclosure.upper[places]) for enclosure in passes]
        face = collapse_monotone(network, Box(lower[rows], upper[rows]), hulls, seed)
        shrank = ((face.lower > lower[rows]) | (face.upper < upper[rows])).any(axis=1)
        stopped = np.flatnonzero(~shrank) if turn + 1 < ROUNDS else np.arange(rows.size)
        ended = rows[stopped]
        dual = bound_by_pieces(network, [e.rows(places[stopped]) for e in passes], seed[stopped])
        bound[ended] = np.minimum(bound[ended], dual)
        rows, face = rows[shrank], face.rows(np.flatnonzero(shrank))
        lower[rows], upper[rows] = face.lower, face.upper
        is_point = (face.lower == face.upper).all(axis=1)
        points, rows = rows[is_point], rows[~is_point]
        bound[points] = np.minimum(
            bound[points], bound_at_points(network, lower[points], extrema.seed[points])
        )
        if not rows.size or turn + 1 == ROUNDS:
            break
        passes = propagate(network, Box(lower[rows], upper[rows]), rule=rule)
        bound[rows] = np.minimum(bound[rows], seeded_upper(passes[-1].hull, extrema.seed[rows]))
        places = np.arange(rows.size)
    return Extrema(Box(lower, upper), extrema.seed, bound)


def refine_by_pieces(network: Network, extrema: Extrema, passes: Sequence[Enclosure]) -> Extrema:
    """Tighten one-sided bounds, as `extrema_of` asks for them, by duality with one pass over the B boxes.

    The effort for one state is bounded, however many actions it has, so that it stays near that of the pass.

    **Sound:** yes.
    """
    bound = extrema.bound.copy()
    batch = passes[0].lower.shape[0]
    effort = effort_in_passing(batch, bound.size)
    for start in range(0, bound.size, batch):
        block = slice(start, start + batch)
        bound[block] = np.minimum(bound[block], bound_by_pieces(network, passes, extrema.seed[block], effort))
    return Extrema(extrema.box, extrema.seed, bound)


def effort_in_passing(states: int, questions: int) -> DualEffort:
    """Return how hard to try where nothing else is refined, for the questions of some states."""
    return DualEffort(sweeps=1, neurons=max(1, _NEURONS_OF_A_STATE * states // max(questions, 1)))


def refine_by_squares(
    network: Network, extrema: Extrema, passes: Sequence[Enclosure], *, rule: Approximation
) -> Extrema:
    """Tighten one-sided bounds, as `extrema_of` asks them, by what curvature adds to one pass over the B boxes.

    Only where a pass of order 2, which sees more, would be too large.

    **Sound:** yes.
    """
    model = passes[-1].model
    batch, actions = model.constant.shape
    questions = 2 * actions
    box = Box(*passes[0].hull)
    rows = sees_squares(network, box)
    symbols = model.linear.symbols + sum(form.symbols for form in model.symbols.values())
    neurons = affordable_squares(symbols, questions)
    if not rows.size or not neurons:
        return extrema
    seed = np.swapaxes(extrema.seed.reshape(questions, batch, actions), 0, 1)[rows]
    problem = SquareProblem.of(network, [e.rows(rows) for e in passes], seed, neurons=neurons, rule=rule)
    bound = np.full((questions, batch), np.inf)
    bound[:, rows] = problem.upper().T
    return extrema.met(bound.ravel())


def sees_squares(network: Network, box: Box) -> Indices:
    """Return the boxes for which curvature is looked at in a pass of order 1, as one of order 2 would be too large."""
    if not is_curved(network):
        return np.empty(0, dtype=np.intp)
    return np.flatnonzero(floats_of_order(network, box, 2) > CACHED_FLOATS)


def refine_by_order(
    network: Network,
    extrema: Extrema,
    rows: Indices,
    *,
    order: int,
    rule: Approximation,
    largest: int = LARGEST_FLOATS,
) -> Extrema:
    """Tighten some one-sided bounds by passes up to a higher order over the shrunken boxes, see `higher_hulls`.

    **Sound:** yes.
    """
    if not is_curved(network):
        return extrema
    bound = extrema.bound.copy()
    for block in blocks_of_questions(network, rows.size):
        some = rows[block]
        box = extrema.box.rows(some)
        hulls = [enclosure.hull for enclosure in propagate(network, box, rule=rule)]
        hulls = higher_hulls(network, box, hulls, order=order, rule=rule, largest=largest)
        bound[some] = np.fmin(bound[some], seeded_upper(hulls[-1], extrema.seed[some]))
    return Extrema(extrema.box, extrema.seed, bound)


def bound_by_pieces(
    network: Network, passes: Sequence[Enclosure], seed: Floats, effort: DualEffort | None = None
) -> Floats:
    """Bound ``seed . actions`` from above (P,) using that convex activations lie above their straight pieces.

    **Sound:** yes; infinity where the network has no piecewise linear activation or the order is above 1.
    """
    model = passes[-1].model
    if model.higher is not None or not seed.shape[0]:
        return np.full(seed.shape[0], np.inf)
    layout = SymbolLayout.of(model)
    effort = effort or DualEffort()
    forms, slack = relaxation_conditions(network, passes, seed, layout, effort)
    if not slack.shape[1]:
        return np.full(seed.shape[0], np.inf)
    problem = DualProblem.of(model, seed, layout, [(forms, slack)])
    return problem.value(descend(problem, effort))[1]


def bound_at_points(network: Network, points: Floats, seed: Floats) -> Floats:
    """Bound ``seed . actions`` at points (P, n) from above: the float64 value and its rounding. **Sound:** yes."""
    values = network.values(points)
    rounding = runtime_deviation(network, [(value, value) for value in values], engine=True)
    return np.asarray((values[-1] * seed).sum(axis=1) + (rounding * np.abs(seed)).sum(axis=1))


def seeded_upper(hull: Hull, seed: Floats) -> Floats:
    """Return the upper bound of the action that each seed names, negated for a minimum."""
    return np.asarray(np.where(seed > 0, hull[1], np.where(seed < 0, -hull[0], -np.inf)).max(axis=1))
