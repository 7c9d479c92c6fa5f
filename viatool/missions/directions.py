"""Directions along which sets of poses are bounded beside their boxes, so that joining parts does not spread them.

A part that is replaced by the box around it reaches further wherever the set's rim is not along an axis, in each
interval anew; a policy takes back what is lost so aside of its path by two or three hundredths in an interval. So of
each part coordinates ``z_m = d_m . (q - o)`` of its poses q are bounded as well. Where the loop leads poses on by
``q' = A q + b``, the direction ``d' = d A^-1`` sees after an interval what d saw before it: its bounds spread by sensor
errors and by what the loop does beyond A, and not by boxes. Such families of directions begin at the axes of the start,
or end at the axes of some later interval, from which they are carried backward: forward they lean towards what the loop
takes back soonest, backward towards what it takes back last.

*Carrying.* With the symbols s of a part's box its z is linear in s, ``z = z_0 + t . s``, and so is its z' after the
interval, with what the commands add: for any number k

    z' = k z + (z' - k z)  lies in  k [bounds of z] + (z'_0 - k z_0) +- (|t' - k t| + what z' has beside s).

*Tightening.* A coordinate bounds each q_j by the others: ``d_j (q_j - o_j)`` is z less the other terms. A piece of
which bounds cross so holds no pose.

Which directions are chosen decides how far sets spread and never what is true: A is estimated from poses around one run
that nothing disturbs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, reduce

import numpy as np

from viatool.arrays import Booleans, Floats, Indices
from viatool.loop.sectors import TubeParts
from viatool.loop.successor import LoopStep
from viatool.rounding import SLIGHTLY_MORE, SPARE
from viatool.sets.bounds import require_ordered
from viatool.sets.forms import Forms
from viatool.sets.states import StateBoxes

_LEAST = 0.05
"""Of its largest entry, that a direction must have along an axis to bound poses along it."""


@dataclass(frozen=True, eq=False)
class PoseDirections:
    """M directions of poses at one time.

    Parameters
    ----------
    origin : ndarray
        (3,) the pose o; metres and radians.
    rows : ndarray
        (M, 3) the directions, the largest entry of each 1.
    names : tuple of int
        (M,) of their families: a direction goes on from the one of its name an interval before.
    """

    origin: Floats
    rows: Floats
    names: tuple[int, ...]

    def __len__(self) -> int:
        """Return M."""
        return len(self.rows)

    @classmethod
    def none(cls) -> PoseDirections:
        """Return no direction at all."""
        return cls(np.zeros(3), np.zeros((0, 3)), ())

    def beside(self, states: Forms) -> Forms:
        """Return the coordinates of states (C, Q) beside them, (C, Q + M)."""
        centre, slope = states.centre[:, :3] - self.origin, states.slope[:, :, :3]
        reach = np.abs(slope).sum(axis=1) + states.rest[:, :3]
        size = (np.abs(states.centre[:, :3]) + reach).sum(axis=1, keepdims=True)
        rest = states.rest[:, :3] @ np.abs(self.rows.T) * SLIGHTLY_MORE + self.slack(size)
        coordinates = Forms(centre @ self.rows.T, slope @ self.rows.T, rest)
        return Forms.beside(states, coordinates) if len(self) else states

    def beside_boxes(self, lower: Floats, upper: Floats) -> tuple[Floats, Floats]:
        """Return the bounds of coordinates beside those of boxes of states (C, Q), (C, Q + M) twice."""
        least, most = self._terms(lower, upper)
        slack = self.slack(_size(lower, upper))
        low, high = _sum(least).T - slack, _sum(most).T + slack
        return np.concatenate([lower, low], axis=1), np.concatenate([upper, high], axis=1)

    def after(self, parts: BoundedParts, step: LoopStep) -> tuple[Floats, Floats]:
        """Bound states and their coordinates after an interval.

        Parameters
        ----------
        parts : BoundedParts
            P sets of Q quantities at its beginning.
        step : LoopStep
            Where their boxes lead, as forms of the sides of these.

        Returns
        -------
        tuple of ndarray
            (C, Q + M) twice, of each piece of the step.

        Notes
        -----
        Sound: yes, of all states of a part of which all bounds hold.
        """
        low, high = step.bounds(parts.boxes.lower[:, :3], parts.boxes.upper[:, :3])
        require_ordered("states after an interval", low, high, finite=True, rounding=SPARE)
        low, high = self.beside_boxes(np.minimum(low, high), np.maximum(low, high))
        states = self.beside(step.states)
        for place, name in enumerate(self.names, start=low.shape[1] - len(self)):
            own = Forms(*(part[..., place] for part in (states.centre, states.slope, states.rest)))
            _narrow(low[:, place], high[:, place], own.centre, own.centre, _reach(own))
            source = parts.directions.places.get(name)
            if source is not None:
                _narrow(low[:, place], high[:, place], *parts.carried(source, step.origin, own))
        return low, high

    def tightened(self, lower: Floats, upper: Floats) -> tuple[Floats, Floats]:
        """Return bounds of states and coordinates (P, Q + M) as one tells of the other; crossed ones hold no state.

        Notes
        -----
        Sound: yes, every state of which the bounds held is within the new ones.
        """
        if not len(self):
            return lower, upper
        lower, upper = lower.copy(), upper.copy()
        count = lower.shape[1] - len(self)
        least, most = self._terms(lower, upper)
        slack = self.slack(_size(lower, upper)).T
        low, high = lower[:, count:].T - slack, upper[:, count:].T + slack  # (M, P)
        for axis in range(3):
            some = np.flatnonzero(np.abs(self.rows[:, axis]) >= _LEAST)
            others = [other for other in range(3) if other != axis]
            first = (low[some] - _sum([most[other][some] for other in others])) / self.rows[some, axis, None]
            last = (high[some] - _sum([least[other][some] for other in others])) / self.rows[some, axis, None]
            spare = self.origin[axis] + slack[0] * np.array([[-1.0], [1.0]]) / _LEAST
            nearest = np.minimum(first, last).max(axis=0, initial=-np.inf) + spare[0]
            furthest = np.maximum(first, last).min(axis=0, initial=np.inf) + spare[1]
            np.maximum(lower[:, axis], nearest, out=lower[:, axis])
            np.minimum(upper[:, axis], furthest, out=upper[:, axis])
        np.maximum(lower[:, count:], (_sum(least) - slack).T, out=lower[:, count:])
        np.minimum(upper[:, count:], (_sum(most) + slack).T, out=upper[:, count:])
        return lower, upper

    def _terms(self, lower: Floats, upper: Floats) -> tuple[list[Floats], list[Floats]]:
        """Return the ends of the terms of coordinates along x, y and theta over boxes, (M, P) each."""
        ends = [
            [self.rows[:, axis, None] * (end[:, axis] - self.origin[axis]) for end in (lower, upper)]
            for axis in range(3)
        ]
        return [np.minimum(*pair) for pair in ends], [np.maximum(*pair) for pair in ends]

    def slack(self, size: Floats) -> Floats:
        """Return what covers the rounding of coordinates of poses of that size, whatever its shape."""
        return np.asarray(SPARE * (1.0 + size + np.abs(self.origin).sum()))

    @cached_property
    def places(self) -> dict[int, int]:
        """Return the place of each name."""
        return {name: place for place, name in enumerate(self.names)}


@dataclass(frozen=True, eq=False)
class BoundedParts:
    """P sets of states: each a box, and bounds of the coordinates of its poses.

    Parameters
    ----------
    lower, upper : ndarray
        (P, Q + M) ends of Q quantities of the state, then of the coordinates.
    directions : PoseDirections
        M of them.
    """

    lower: Floats
    upper: Floats
    directions: PoseDirections

    def __len__(self) -> int:
        """Return P."""
        return len(self.lower)

    def select(self, which: Indices | Booleans) -> BoundedParts:
        """Return some of the parts."""
        return BoundedParts(self.lower[which], self.upper[which], self.directions)

    @cached_property
    def boxes(self) -> TubeParts:
        """Return the boxes of states."""
        count = self.lower.shape[1] - len(self.directions)
        return TubeParts(np.zeros(len(self), np.int64), self.lower[:, :count], self.upper[:, :count])

    @cached_property
    def cells(self) -> StateBoxes:
        """Return the same as boxes of poses and of what stands behind them."""
        return self.boxes.cells

    def halved(self) -> BoundedParts:
        """Return the parts cut in two along x, y and theta each, without those that hold no state. Sound: yes."""
        middle = 0.5 * (self.lower[:, :3] + self.upper[:, :3])
        lower, upper = (np.repeat(end[None], 8, axis=0) for end in (self.lower, self.upper))
        second = np.indices((2, 2, 2)).reshape(3, 8).T[:, None] == 1  # (8, 1, 3)
        lower[:, :, :3] = np.where(second, middle, lower[:, :, :3])
        upper[:, :, :3] = np.where(second, upper[:, :, :3], middle)
        size = self.lower.shape[1]
        ends = self.directions.tightened(lower.reshape(-1, size), upper.reshape(-1, size))
        return BoundedParts(*ends, self.directions).select(not_crossed(*ends))

    def beside(self, others: BoundedParts) -> BoundedParts:
        """Return these parts and others along the same directions."""
        lower = np.concatenate([self.lower, others.lower])
        return BoundedParts(lower, np.concatenate([self.upper, others.upper]), self.directions)

    def carried(self, source: int, origin: Indices, after: Forms) -> tuple[Floats, Floats, Floats]:
        """Bound a coordinate after an interval by one before it.

        Parameters
        ----------
        source : int
            Which of the directions.
        origin : ndarray
            (C,) the part of each piece.
        after : Forms
            (C,) the coordinate then, in the symbols of the sides of its part and more.

        Returns
        -------
        tuple of ndarray
            (C,) lower and upper bounds, and by how much more it may be off. Sound: see the module.
        """
        poses, here = self.cells.poses.select(origin), self.directions
        row, column = here.rows[source], self.lower.shape[1] - len(here) + source
        its = row * poses.radius  # change with each side of the box
        k = (after.slope[:, :3] * its).sum(axis=1) / np.maximum(np.square(its).sum(axis=1), 1e-300)
        k = np.where(np.abs(k) < _STEEPEST, k, 0.0)
        apart = after.slope.copy()
        apart[:, :3] -= k[:, None] * its
        middle = after.centre - k * ((poses.centre - here.origin) @ row)
        ends = k * self.lower[origin, column], k * self.upper[origin, column]
        slack = here.slack(np.abs(poses.centre).sum(axis=1)) * (1.0 + np.abs(k))
        rest = _reach(Forms(middle, apart, after.rest)) + slack
        return middle + np.minimum(*ends), middle + np.maximum(*ends), rest


_STEEPEST = 1e3


def not_crossed(lower: Floats, upper: Floats) -> Booleans:
    """Tell which boxes may hold a state, (P,): what is not a number is kept, to be refused."""
    return ~np.asarray((lower > upper).any(axis=1))


def _reach(form: Forms) -> Floats:
    """Return how far a quantity, (C,), may be from its centre."""
    return np.asarray((np.abs(form.slope).sum(axis=1) + form.rest) * SLIGHTLY_MORE)


def _narrow(lower: Floats, upper: Floats, low: Floats, high: Floats, rest: Floats) -> None:
    """Narrow bounds in place to others, widened by a rest."""
    np.maximum(lower, low - rest, out=lower)
    np.minimum(upper, high + rest, out=upper)


def _sum(terms: Sequence[Floats]) -> Floats:
    return reduce(np.add, terms)


def _size(lower: Floats, upper: Floats) -> Floats:
    """Return how large poses of boxes are at most, (P, 1)."""
    return np.asarray(np.maximum(np.abs(lower[:, :3]), np.abs(upper[:, :3])).sum(axis=1, keepdims=True))
