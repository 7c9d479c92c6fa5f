"""Branch and bound: boxes that stay loose are split where the engine itself says that it lost most.

The loss of a bound is the sum of the symbolic remainders that reach the action, and each belongs to one neuron. So the
neuron with the largest share is split: in one part its argument lies below a threshold (the kink of a ReLU), in the
other above. In each part the activation is closer to its line, and `duality` uses the condition itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from viatool.arrays import Booleans, Floats
from viatool.policy.network import Network
from viatool.taylor.approximation import Approximation
from viatool.taylor.memory import CACHED_FLOATS, blocks_of_questions
from viatool.taylor.parts import BoxParts, examine, whole_boxes
from viatool.taylor.refinement import Extrema, refine_by_order, unfold

_AT_ONCE = 8
"""Parts of one question that are split in one round."""
_NEGLIGIBLE = 1e-12


@dataclass(frozen=True)
class SplittingEffort:
    """When to stop splitting.

    Parameters
    ----------
    tolerance : float
        A question is answered when its bound is within this fraction of the attained width of its action.
    parts : int
        Parts that are examined for one question before its best bound so far is returned.
    exact : bool
        Whether linear programming settles a part in which nothing is left to split.
    """

    tolerance: float
    parts: int
    exact: bool = True

    def at_least(self, other: SplittingEffort) -> SplittingEffort:
        """Return an effort that stops no earlier than either."""
        return SplittingEffort(
            min(self.tolerance, other.tolerance), max(self.parts, other.parts), self.exact or other.exact
        )


def refine_by_splitting(
    network: Network,
    extrema: Extrema,
    found: Floats,
    *,
    rule: Approximation,
    effort: SplittingEffort,
    settled: Booleans | None = None,
) -> tuple[Extrema, Floats]:
    """Tighten one-sided bounds by branch and bound.

    Parameters
    ----------
    network : Network
        n inputs, A outputs.
    extrema : Extrema
        P questions, as `extrema_of` asks them, with the bounds known so far.
    found : ndarray
        ``(P,)``: values that are attained.
    rule : str
        How activations are approximated.
    effort : SplittingEffort
        When to stop.
    settled : ndarray, optional
        ``(B,)`` bool: states of which no question is split.

    Returns
    -------
    Extrema
        The same questions, with bounds at most as large.
    ndarray
        ``(P,)``: values that are attained, at least as large.

    Notes
    -----
    **Sound:** yes. The parts cover the box, and the bound of a question is the largest of its parts.
    """
    found = found.copy()
    margin = effort.tolerance * _attained_widths(found, extrema.seed.shape[1]) + _NEGLIGIBLE * np.abs(found)
    closed = np.full(found.shape, -np.inf)  # largest bound among the parts that are done with
    spent = np.zeros(found.shape, dtype=np.intp)
    open_ = extrema.bound > found + margin
    if settled is not None:
        open_ &= ~np.tile(settled, 2 * extrema.seed.shape[1])
    questions = np.flatnonzero(open_)
    if not questions.size:
        return extrema, found
    extrema = refine_by_order(network, extrema, questions, order=2, rule=rule, largest=CACHED_FLOATS)
    questions = questions[(extrema.bound > found + margin)[questions]]
    fresh, waiting = whole_boxes(extrema, questions), whole_boxes(extrema, questions[:0])
    while fresh.owner.size:
        parts = waiting
        target = found + margin if effort.exact else None
        for block in blocks_of_questions(network, fresh.owner.size):
            examined, points = examine(network, extrema, fresh.rows(block), target, rule)
            reached = (network(points) * extrema.seed[examined.owner]).sum(axis=1)
            np.maximum.at(found, examined.owner, reached)
            np.add.at(spent, examined.owner, 1)
            parts = parts.joined(examined)
        done = (parts.bound <= (found + margin)[parts.owner]) | (parts.next_node == 0)
        done |= (spent >= effort.parts)[parts.owner]
        np.maximum.at(closed, parts.owner[done], parts.bound[done])
        parts = parts.rows(np.flatnonzero(~done))
        chosen = largest_of_each(parts, _AT_ONCE)
        waiting = parts.rows(np.flatnonzero(~chosen))
        fresh = parts.rows(np.flatnonzero(chosen)).halves()
    bound = extrema.bound.copy()
    bound[questions] = np.minimum(bound[questions], np.maximum(closed, found)[questions])
    return Extrema(extrema.box, extrema.seed, bound), found


def _attained_widths(found: Floats, actions: int) -> Floats:
    """Return for each question the width of its action between what is attained at both sides, (P,)."""
    smallest, largest = unfold(found, actions)
    return np.tile((largest - smallest).T.ravel(), 2)


def largest_of_each(parts: BoxParts, count: int) -> Booleans:
    """Mark the parts with the `count` largest bounds of each question."""
    order = np.lexsort((-parts.bound, parts.owner))
    owner = parts.owner[order]
    starts = (
        np.flatnonzero(np.r_[True, owner[1:] != owner[:-1]]) if owner.size else np.empty(0, dtype=np.intp)
    )
    rank = np.arange(owner.size) - np.repeat(starts, np.diff(np.r_[starts, owner.size]))
    chosen = np.zeros(owner.size, dtype=bool)
    chosen[order] = rank < count
    return chosen
