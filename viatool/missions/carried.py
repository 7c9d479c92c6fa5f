"""Missions of robots whose motion has a state: every set is a form of where its runs began, kept until they arrive.

The box of starts is cut into parts. Of each the states after k intervals are a linear form in symbols of four kinds:
those of its start, which are kept for ever, so that what a policy does about an error is seen for the whole run; those
of the commands' and of the motion's remainders, of which the largest are kept and the others folded into rests. The
union of the forms of the parts at the end of interval k holds every run that has not arrived.

A run arrives where an interval ends within the destination, and a form of which that holds for every state goes no
further; or, where runs are to be there at a deadline, after the last interval alone. Every run of a mission keeps the
collision distance at its start, which is checked first, and by induction in each interval up to the first that is not
proved.

*Refinement.* If the whole start could not be followed to its end in one form, it is cut by a grid; later on, each part
that could not is halved across the side of the start to which its form answers most. What was found of the other parts
is kept: each start lies in one of the parts.

*What is checked later.* The clearance of an interval does not decide where the next one leads, so it is checked for
several intervals together; parts that fail then are found to have failed where they did.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from viatool.arrays import Booleans, Floats, Indices
from viatool.loop.sectors import TubeParts
from viatool.loop.successor import fold_apart, name_rests, select, step
from viatool.missions.follow import (
    REFUTED,
    TOO_NEAR,
    MissionFollower,
    MissionProof,
    Trace,
    place_words,
)
from viatool.missions.starts import Starts
from viatool.rounding import SPARE
from viatool.schedule import check_time
from viatool.sets.bounds import require_ordered
from viatool.sets.forms import Forms
from viatool.sets.states import StateBoxes

_SYMBOLS = 60
"""Of a form, beside those of its start, that are kept after an interval."""
_WIDEST = 0.5
"""A form that is wider than this share of the map has been lost."""
_TOGETHER = 128
"""Parts, each of one interval, whose clearance is checked together."""
_LOOKED_AT = frozenset(2**power for power in range(3, 10))
"""Intervals after which it is checked anyway, so that of a few parts those that fail are soon known."""
_AT_FIRST = 50
"""Parts into which a whole start is cut: a batch of as many takes about three times as long as one alone."""


@dataclass(frozen=True, eq=False)
class CarriedFollower(MissionFollower):
    """Follows the closed loop of one scenario to its destination, in forms of where runs begin."""

    def attempts(self, lower: Floats, upper: Floats) -> Iterator[MissionProof]:
        """Yield what following every run finds, once."""
        yield self._proof(lower, upper)

    def _proof(self, lower: Floats, upper: Floats) -> MissionProof:
        """Follow every run from a box of states (3 + K,), with finer parts of it where the first do not suffice.

        Notes
        -----
        Sound: yes, see the module. Cost: one step of the closed loop for each part and interval.
        """
        starts, kept = Starts(lower[None], upper[None]), 0
        trace, arrived = Trace(1), 0
        while True:
            found = self._carry(starts)
            open_ = np.flatnonzero(found.failed > 0)
            arrived, trace.earliest = max(arrived, found.last), trace.earliest or found.earliest
            if found.earliest:
                trace.earliest = min(trace.earliest, found.earliest)
            kept += len(starts) - len(open_)
            finer = self._finer(starts, open_, found, kept)
            if finer is None:
                break
            trace.take(found.kept, found.nearest(found.failed == 0))
            starts = finer
        trace.take(found.followed, found.nearest(np.ones(len(found.failed), dtype=bool)))
        trace.start_parts = trace.most = kept + len(open_)
        if not len(open_):
            return trace.arrived(arrived)
        first = int(open_[found.failed[open_].argmin()])
        return trace.ended(0 if found.begins_near else int(found.failed[first]), found.reasons[first])

    def _finer(self, starts: Starts, open_: Indices, found: _Round, kept: int) -> Starts | None:
        """Cut the parts that could not be followed, (R,); None if none is left, or they may not be cut further."""
        answers = found.answers[open_]
        if not len(open_) or found.begins_near or not starts.are_wide(open_, answers).all():
            return None
        most = min(_AT_FIRST, self.limits.parts // 4)
        if len(starts) == 1 and kept == 0 and most > 2:
            return starts.gridded(answers[0], most)
        return starts.halved(open_, answers) if kept + 2 * len(open_) <= self.limits.parts else None

    def _carry(self, starts: Starts) -> _Round:
        """Follow every run from parts of the start until it arrives, or cannot be followed further."""
        found = _Round.of(*starts.lower.shape)
        here = TubeParts(np.arange(len(starts.lower)), starts.lower, starts.upper)
        states, sides = starts.forms, starts.lower.shape[1]
        near = ~self._begins_clear(here)
        found.fail(
            np.zeros(len(here), np.int64), here, _answers(states, sides), near, f"{TOO_NEAR} at the start"
        )
        if near.any():
            found.begins_near = True
            return found
        passed: list[_Passed] = []
        for k in range(1, self.limits.steps + 1):
            check_time()
            after = step(self.loop, states, self.told(len(here)).after(k - 1))
            begun = here.select(after.origin)
            low, high = after.bounds(here.lower[:, :3], here.upper[:, :3])
            require_ordered("states after an interval", low, high, rounding=SPARE)
            here, states = TubeParts(begun.tube, np.minimum(low, high), np.maximum(low, high)), after.states
            answers, at = _answers(states, sides), np.full(len(here), k)
            passed.append(_Passed(at, begun, after.start, after.lower, after.upper, here, answers))
            found.fail(at, here, answers, ~self._known(here), "the set of runs has grown too large, {}")
            last = k == self.limits.steps
            gone = found.failed[here.tube] > 0
            if last or not self.destination.deadline_only:
                gone |= found.arrive(k, here, self.destination.surely(here.lower, here.upper))
                if self.destination.possibly(here.lower, here.upper).any():
                    found.earliest = found.earliest or k
            found.tubes.append((k, here.select(~gone)))
            if self.refuted:
                found.fail(at, here, answers, np.ones(len(here), dtype=bool), REFUTED)
                gone[:] = True
            if last:
                found.fail(at, here, answers, ~gone, "runs may not have arrived, {}")
            rows = np.flatnonzero(~gone) if not last else np.zeros(0, np.int64)
            if not len(rows) or sum(map(len, passed)) >= _TOGETHER or k in _LOOKED_AT:
                self._settle(passed, found)
                rows, passed = rows[found.failed[here.tube[rows]] == 0], []
            if not len(rows):
                break
            here = here.select(rows)
            states = fold_apart(name_rests(select(states, rows)), sides, _SYMBOLS)
        return found

    def _settle(self, passed: Sequence[_Passed], found: _Round) -> None:
        """Note which intervals are not clear."""
        some = _Passed.join(passed)
        clearance, clear = self.clearance_of(some.begun, some.start, some.lower, some.upper)
        np.minimum.at(found.clearance, some.begun.tube, clearance)
        found.fail(some.interval, some.after, some.answers, ~clear, f"{TOO_NEAR} in {{}}")

    def _known(self, parts: TubeParts) -> Booleans:
        """Tell which parts are not lost: no wider than a share of the map, nor than half a turn, (P,)."""
        wide = parts.upper - parts.lower
        most = _WIDEST * self.loop.sensors.shapes.scale
        return np.asarray((wide[:, :2] < most).all(axis=1) & (wide[:, 2] < np.pi))


@dataclass(frozen=True, eq=False)
class _Passed:
    """P intervals, each of one part, whose clearance is to be checked.

    Parameters
    ----------
    interval : ndarray
        (P,) counted from 1.
    begun, start, lower, upper : TubeParts, StateBoxes, ndarray, ndarray
        The states at its beginning, as bounds and as boxes around forms, and the commands (P, A).
    after : TubeParts
        The states at its end.
    answers : ndarray
        (P, 3 + K) see `_answers`.
    """

    interval: Indices
    begun: TubeParts
    start: StateBoxes
    lower: Floats
    upper: Floats
    after: TubeParts
    answers: Floats

    def __len__(self) -> int:
        """Return P."""
        return len(self.interval)

    @classmethod
    def join(cls, parts: Sequence[_Passed]) -> _Passed:
        """Return all as one."""
        return cls(
            np.concatenate([part.interval for part in parts]),
            _together([part.begun for part in parts]),
            StateBoxes.concatenate([part.start for part in parts]),
            np.concatenate([part.lower for part in parts]),
            np.concatenate([part.upper for part in parts]),
            _together([part.after for part in parts]),
            np.concatenate([part.answers for part in parts]),
        )


def _together(parts: Sequence[TubeParts]) -> TubeParts:
    """Return all parts, one after the other; those of a tube need not stand together."""
    names = ("tube", "lower", "upper")
    return TubeParts(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


def _answers(states: Forms, sides: int) -> Floats:
    """Return how much each form answers to each side of the start, (P, 3 + K)."""
    return np.asarray(np.abs(states.slope[:, :sides]).sum(axis=2))


@dataclass(eq=False)
class _Round:
    """What following P parts of the start found.

    Parameters
    ----------
    failed : ndarray
        (P,) the interval in which a part could not be followed further; 0 for one that arrived.
    answers : ndarray
        (P, 3 + K) how much the form answered to each side of the start then.
    clearance : ndarray
        (P,) metres that its runs keep.
    reasons : dict
        By part, why.
    tubes : list
        By interval, the parts that have not arrived at its end.
    arrived : ndarray
        (P,) intervals after which the last runs of a part have arrived; 0 where none has.
    earliest : int
        Intervals before whose end no run has arrived.
    begins_near : bool
        Whether some start does not keep its distance.
    """

    failed: Indices
    answers: Floats
    clearance: Floats
    arrived: Indices
    reasons: dict[int, str] = field(default_factory=dict)
    tubes: list[tuple[int, TubeParts]] = field(default_factory=list)
    earliest: int = 0
    begins_near: bool = False

    @classmethod
    def of(cls, count: int, sides: int) -> _Round:
        """Begin with as many parts of as many sides."""
        none = np.zeros(count, np.int64)
        return cls(none, np.zeros((count, sides)), np.full(count, np.inf), none.copy())

    def nearest(self, which: Booleans) -> float:
        """Return the metres that the runs of some parts keep."""
        return float(self.clearance[which].min(initial=np.inf))

    def fail(
        self, interval: Indices, parts: TubeParts, answers: Floats, which: Booleans, reason: str
    ) -> None:
        """Note in which intervals (P,) some parts could not be followed further, the first of each, and why."""
        for row in np.flatnonzero(which).tolist():
            root, k = int(parts.tube[row]), max(int(interval[row]), 1)
            if 0 < self.failed[root] <= k:
                continue
            self.failed[root], self.answers[root] = k, answers[row]
            self.reasons[root] = reason.format(place_words(parts.select(np.array([row]))))

    def arrive(self, k: int, parts: TubeParts, there: Booleans) -> Booleans:
        """Note that some parts have arrived; return which, (P,)."""
        self.arrived[parts.tube[there]] = k
        return there

    @property
    def last(self) -> int:
        """Return after how many intervals all runs have arrived of the parts that were followed to their end."""
        return int(self.arrived[self.failed == 0].max(initial=0))

    @property
    def followed(self) -> list[tuple[int, TubeParts]]:
        """Return all sets, of each part up to the interval in which it could not be followed further."""
        last = np.where(self.failed > 0, self.failed, np.iinfo(np.int64).max)
        return [(k, parts.select(k <= last[parts.tube])) for k, parts in self.tubes]

    @property
    def kept(self) -> list[tuple[int, TubeParts]]:
        """Return the sets of the parts that were followed to their end."""
        return [(k, parts.select(self.failed[parts.tube] == 0)) for k, parts in self.tubes]
