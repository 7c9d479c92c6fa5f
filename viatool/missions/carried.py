"""Missions of robots whose motion has a state: every set is a form of where its runs began, kept until they arrive.

The box of starts is cut into parts. Of each the states after k intervals are a linear form in symbols of four kinds:
those of its start, which are kept for ever, so that what a policy does about an error is seen for the whole run; those
of the commands' and of the motion's remainders, of which the largest are kept and the others folded into rests. The
union of the forms of the parts at the end of interval k holds every run that has not arrived.

A run arrives where an interval ends within the destination, and a form of which that holds for every state goes no
further; or, where runs are to be there at a deadline, after the last interval alone. Every run of a mission keeps the
collision distance at its start, which is checked first, and by induction in each interval up to the first that is not
proved.

*Refinement.* A part that could not be followed to its end is halved across the side of the start that its form answers
to most, and both halves are begun anew. What was found of its other parts is kept: each start lies in one of the parts.
How finely to cut is *scouted* with the network of the file in real arithmetic, which costs a fraction of the bounds of
every program that may run; nothing that a scout finds is part of the proof, for which each part is followed again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from viatool.arrays import Booleans, Floats, Indices
from viatool.loop.sectors import TubeParts
from viatool.loop.successor import fold_apart, name_rests, select, step
from viatool.missions.follow import (
    TOO_NEAR,
    MissionFollower,
    MissionProof,
    Trace,
    place_words,
)
from viatool.rounding import SLIGHTLY_MORE, SPARE
from viatool.schedule import check_time
from viatool.sets.bounds import require_ordered
from viatool.sets.forms import Forms

_SYMBOLS = 40
"""Of a form, beside those of its start, that are kept after an interval."""
_WIDEST = 0.5
"""A form that is wider than this share of the map has been lost."""


@dataclass(frozen=True, eq=False)
class CarriedFollower(MissionFollower):
    """Follows the closed loop of one scenario to its destination, in forms of where runs begin."""

    def prove(self, lower: Floats, upper: Floats) -> MissionProof:
        """Follow every run from a box of states (3 + K,), with finer parts of it where the first do not suffice.

        Notes
        -----
        Sound: yes, see the module. Cost: one step of the closed loop for each part and interval.
        """
        starts, kept = _Starts(lower[None], upper[None]), 0
        trace, arrived = Trace(1), 0
        while True:
            found = self._carry(starts)
            open_ = np.flatnonzero(found.failed > 0)
            arrived, trace.earliest = max(arrived, found.last), trace.earliest or found.earliest
            if found.earliest:
                trace.earliest = min(trace.earliest, found.earliest)
            kept += len(starts) - len(open_)
            if not len(open_) or found.begins_near or not self._may_halve(starts, found, kept):
                break
            trace.take(found.kept, found.nearest(found.failed == 0))
            starts = self._scouted(starts.halved(open_, found.answers[open_]), kept)
        trace.take(found.tubes, found.nearest(np.ones(len(found.failed), dtype=bool)))
        trace.start_parts = trace.most = kept + len(open_)
        if not len(open_):
            return trace.arrived(arrived)
        first = int(open_[found.failed[open_].argmin()])
        return trace.ended(0 if found.begins_near else int(found.failed[first]), found.reasons[first])

    def _scouted(self, starts: _Starts, kept: int) -> _Starts:
        """Return finer parts of the start, so that in real arithmetic all can be followed if there may be as many.

        Nothing is proved with it.
        """
        scout, fine = replace(self, loop=replace(self.loop, arithmetic="real")), []
        while True:
            found = scout._carry(starts)
            open_ = np.flatnonzero(found.failed > 0)
            fine.append(starts.select(np.flatnonzero(found.failed == 0)))
            kept += len(fine[-1])
            if not len(open_) or not self._may_halve(starts, found, kept):
                break
            starts = starts.halved(open_, found.answers[open_])
        return _Starts.join([*fine, starts.select(open_)])

    def _may_halve(self, starts: _Starts, found: _Round, kept: int) -> bool:
        """Tell whether the parts that could not be followed can be halved, and may be, beside others that are kept."""
        open_ = np.flatnonzero(found.failed > 0)
        wide = starts.widths(open_, found.answers[open_]) > 0.0
        return kept + 2 * len(open_) <= self.limits.parts and bool(wide.all())

    def _carry(self, starts: _Starts) -> _Round:
        """Follow every run from parts of the start until it arrives, or cannot be followed further."""
        found = _Round.of(len(starts.lower))
        here = TubeParts(np.arange(len(starts.lower)), starts.lower, starts.upper)
        states = starts.forms
        near = ~self._begins_clear(here)
        found.fail(0, here, states, near, f"{TOO_NEAR} at the start")
        if near.any():
            found.begins_near = True
            return found
        for k in range(1, self.limits.steps + 1):
            check_time()
            after = step(self.loop, states, self.told(len(here)).after(k - 1))
            clearance, clear = self._clearance_of_each(here, after)
            low, high = after.bounds(here.lower[:, :3], here.upper[:, :3])
            require_ordered("states after an interval", low, high, rounding=SPARE)
            root = here.tube[after.origin]
            here, states = TubeParts(root, np.minimum(low, high), np.maximum(low, high)), after.states
            lost = ~self._known(here)
            np.minimum.at(found.clearance, root, clearance)
            found.fail(k, here, states, ~clear, f"{TOO_NEAR} in {{}}")
            found.fail(k, here, states, lost, "the set of runs has grown too large, {}")
            last = k == self.limits.steps
            gone = found.failed[root] > 0
            if last or not self.destination.deadline_only:
                gone |= found.arrive(k, here, self.destination.surely(here.lower, here.upper))
                if self.destination.possibly(here.lower, here.upper).any():
                    found.earliest = found.earliest or k
            found.tubes.append((k, here.select(~gone)))
            if last:
                found.fail(k, here, states, ~gone, "runs may not have arrived, {}")
                break
            rows = np.flatnonzero(~gone)
            if not len(rows):
                break
            here = here.select(rows)
            states = fold_apart(name_rests(select(states, rows)), starts.lower.shape[1], _SYMBOLS)
        return found

    def _known(self, parts: TubeParts) -> Booleans:
        """Tell which parts are not lost: no wider than a share of the map, nor than half a turn, (P,)."""
        wide = parts.upper - parts.lower
        most = _WIDEST * self.loop.sensors.shapes.scale
        return np.asarray((wide[:, :2] < most).all(axis=1) & (wide[:, 2] < np.pi))


@dataclass(frozen=True, eq=False)
class _Starts:
    """P parts of the box of starts, (P, 3 + K) each."""

    lower: Floats
    upper: Floats

    @property
    def forms(self) -> Forms:
        """Return them as forms, one symbol for each side."""
        centre = 0.5 * (self.lower + self.upper)
        radius = np.maximum(self.upper - centre, centre - self.lower) * SLIGHTLY_MORE
        return Forms(centre, radius[:, :, None] * np.eye(radius.shape[1]), np.zeros_like(centre))

    def __len__(self) -> int:
        """Return P."""
        return len(self.lower)

    def select(self, rows: Indices) -> _Starts:
        """Return some parts."""
        return _Starts(self.lower[rows], self.upper[rows])

    @classmethod
    def join(cls, parts: Sequence[_Starts]) -> _Starts:
        """Return the parts of all."""
        return cls(*(np.concatenate([getattr(part, end) for part in parts]) for end in ("lower", "upper")))

    def widths(self, rows: Indices, axis: Indices) -> Floats:
        """Return how wide some parts are along one of their sides each."""
        return np.asarray((self.upper - self.lower)[rows, axis])

    def halved(self, rows: Indices, axis: Indices) -> _Starts:
        """Return both halves of some parts, each across one of its sides; they meet in the middle."""
        lower, upper = self.lower[rows], self.upper[rows]
        each, middle = np.arange(len(rows)), 0.5 * (lower + upper)
        first, last = lower.copy(), upper.copy()
        last[each, axis] = first[each, axis] = middle[each, axis]
        return _Starts(np.concatenate([lower, first]), np.concatenate([last, upper]))


@dataclass(eq=False)
class _Round:
    """What following P parts of the start found.

    Parameters
    ----------
    failed : ndarray
        (P,) the interval in which a part could not be followed further; 0 for one that arrived.
    answers : ndarray
        (P,) the side of the start to which the form answered most then.
    clearance : ndarray
        (P,) metres that its runs keep.
    reasons : dict
        By part, why.
    tubes : list
        By interval, the parts that have not arrived at its end.
    earliest, last : int
        Intervals before whose end no run has arrived, and after which all of those have that did.
    begins_near : bool
        Whether some start does not keep its distance.
    """

    failed: Indices
    answers: Indices
    clearance: Floats
    reasons: dict[int, str] = field(default_factory=dict)
    tubes: list[tuple[int, TubeParts]] = field(default_factory=list)
    earliest: int = 0
    last: int = 0
    begins_near: bool = False

    @classmethod
    def of(cls, count: int) -> _Round:
        """Begin with as many parts."""
        return cls(np.zeros(count, np.int64), np.zeros(count, np.int64), np.full(count, np.inf))

    def nearest(self, which: Booleans) -> float:
        """Return the metres that the runs of some parts keep."""
        return float(self.clearance[which].min(initial=np.inf))

    def fail(self, k: int, parts: TubeParts, states: Forms, which: Booleans, reason: str) -> None:
        """Note in which interval some parts could not be followed further, and why."""
        for row in np.flatnonzero(which).tolist():
            root = int(parts.tube[row])
            if self.failed[root]:
                continue
            self.failed[root] = max(k, 1)
            self.reasons[root] = reason.format(place_words(parts.select(np.array([row]))))
            sides = parts.lower.shape[1]
            self.answers[root] = int(np.abs(states.slope[row, :sides]).sum(axis=1).argmax())

    def arrive(self, k: int, parts: TubeParts, there: Booleans) -> Booleans:
        """Note that some parts have arrived; return which, (P,)."""
        if there.any():
            self.last = max(self.last, k)
        return there

    @property
    def kept(self) -> list[tuple[int, TubeParts]]:
        """Return the sets of the parts that were followed to their end."""
        return [(k, parts.select(self.failed[parts.tube] == 0)) for k, parts in self.tubes]
