"""The search for a reading that does better: one change after the other, from the most promising readings on."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import takewhile

from viatool.doctor.evidence import Evidence, Paired
from viatool.doctor.interpretation import Background, Interpretation
from viatool.errors import EmptyEvaluationError
from viatool.policy import PolicySpecification
from viatool.schedule import NEVER, Deadline, Piece, Progress, Scheduler, Span

_DEPTH = 3
"""Most changes of a reading."""
_BEAM = 4
"""Readings from which the search goes on."""
_CHANCE = 0.01
"""How improbable, with all readings that were tried, a difference among equals has to be to be called clear."""
_SAME = 0.05
"""How probable a difference among equals has to be for two readings to count as equally good."""

Examine = Callable[[PolicySpecification], Evidence]


@dataclass(frozen=True, eq=False)
class Examined:
    """A reading and what was found of it."""

    interpretation: Interpretation
    evidence: Evidence

    @property
    def order(self) -> tuple[float, int]:
        """Return what ranks it: its merit, then how few changes it has."""
        return self.evidence.merit, -len(self.interpretation.changes)


@dataclass(frozen=True, eq=False)
class Repeat:
    """One reading against the specification once more, on scenarios that did not choose it.

    Parameters
    ----------
    contender : Examined
        The reading.
    evidence, specified : Evidence
        Of the reading and of the specification.
    """

    contender: Examined
    evidence: Evidence
    specified: Evidence

    @property
    def is_clear(self) -> bool:
        """Tell whether the reading is better, not by chance."""
        return _is_better(self.evidence, self.specified, _CHANCE)


@dataclass(frozen=True, eq=False)
class Ranking:
    """All readings that were tried.

    Parameters
    ----------
    examined : tuple of Examined
        The best first.
    specified : Examined
        The policy's own specification; one of them.
    again : Repeat, optional
        What other scenarios told where these did not.
    stopped : str
        Why readings with more changes were not tried, or not all of them, though none is good; empty if they were.
    """

    examined: tuple[Examined, ...]
    specified: Examined
    again: Repeat | None = None
    stopped: str = ""

    @property
    def best(self) -> Examined:
        """Return the one with the fewest changes among those that do as well as the best.

        A repeat that is clear decides otherwise, and the specification is not preferred to a good reading if it is not
        good itself. A reading that gets nowhere either is not preferred to the specification.
        """
        found = self._best
        return found if found.evidence.gets_somewhere else self.specified

    @property
    def _best(self) -> Examined:
        contender = self.contender
        if self.again is not None and self.again.is_clear:
            return self.again.contender
        if contender is not None and contender.evidence.is_good and not self.specified.evidence.is_good:
            return contender
        return _fewest(self.equals)

    @property
    def contender(self) -> Examined | None:
        """Return what may be better than the specification; None if nothing is."""
        merit = self.specified.evidence.merit
        better = [one for one in self.equals if one.evidence.merit > merit]
        return _fewest(better) if better else None

    @property
    def equals(self) -> list[Examined]:
        """Return those that do as well as the best, as far as can be told."""
        top = self.examined[0].evidence
        return [one for one in self.examined if not _is_better(top, one.evidence, _SAME)]

    @property
    def is_clear(self) -> bool:
        """Tell whether another reading than the specified one is better, not by chance."""
        if self.again is not None and self.again.is_clear:
            return self.best is self.again.contender
        return _is_better(self.best.evidence, self.specified.evidence, _CHANCE / len(self.examined))

    @property
    def against_specified(self) -> Paired:
        """Return how the best does against the specified one."""
        return self.best.evidence.against(self.specified.evidence)


def rank(
    spec: PolicySpecification,
    examine: Examine,
    around: Background,
    scheduler: Scheduler,
    progress: Progress,
    until: Deadline = NEVER,
) -> Ranking:
    """Examine a specification and other readings of it.

    Parameters
    ----------
    spec : PolicySpecification
        The policy's own.
    examine : callable
        Picklable: gives the evidence of a specification.
    around : Background
        Of the policy.
    scheduler : Scheduler
        Who does the work.
    progress : Progress
        Told how many readings have been examined.
    until : Deadline
        After which no reading with more than one change is begun.

    Returns
    -------
    Ranking
        Of the specification, of every reading with one change, and of such with more changes as long as none is good,
        unless nothing that one change makes gets anywhere.

    Raises
    ------
    EmptyEvaluationError
        If there is no evidence of the specification itself.
    """
    base = Interpretation(spec)
    seen = {base.meaning}
    examined = list(_examined([base], examine, scheduler, progress))
    if not examined:
        raise EmptyEvaluationError(
            "nothing of the recording can be compared with the policy",
            "record commands beside the observations",
        )
    frontier, stopped, specified = [base], "", examined[0].evidence
    for depth in range(_DEPTH):
        before = max(one.evidence.merit for one in examined)
        fresh = list(_fresh(frontier, around, seen))
        tried = list(_examined(fresh, examine, scheduler, progress, len(examined), until if depth else NEVER))
        examined += tried
        examined.sort(key=lambda one: one.order, reverse=True)
        best = examined[0].evidence
        if not best.is_good and len(tried) < len(fresh) and until.passed:
            stopped = "the time was up before all readings with several changes were tried"
            break
        if best.is_good or (depth and best.merit <= before):
            break
        if not depth and not any(one.evidence.leads(specified, _CHANCE / len(examined)) for one in examined):
            stopped = "nothing that one change makes gets clearly farther, so that no more changes were tried"
            break
        frontier = [one.interpretation for one in examined if len(one.interpretation.changes) == depth + 1]
        frontier = frontier[:_BEAM]
    own = next(one for one in examined if not one.interpretation.changes)
    return Ranking(tuple(examined), own, stopped=stopped)


def _fewest(examined: Sequence[Examined]) -> Examined:
    """Return the one with the fewest changes, and of such the best."""
    return max(examined, key=lambda one: (-len(one.interpretation.changes), one.evidence.merit))


def _is_better(one: Evidence, other: Evidence, chance: float) -> bool:
    return one.surpasses(other) and one.against(other).chance < chance


def _fresh(
    frontier: Iterable[Interpretation], around: Background, seen: set[str]
) -> Iterator[Interpretation]:
    """Yield what one more change makes of readings, as far as it means something new."""
    for known in frontier:
        for other in known.others(around):
            if other.meaning not in seen:
                seen.add(other.meaning)
                yield other


def _examined(
    interpretations: Sequence[Interpretation],
    examine: Examine,
    scheduler: Scheduler,
    progress: Progress,
    before: int = 0,
    until: Deadline = NEVER,
) -> Iterator[Examined]:
    """Yield the evidence of readings in their order, where there is any, whoever was ready first, and while time is."""
    named = (Piece(Span(i, i + 1), one.name, one.spec) for i, one in enumerate(interpretations))
    pieces = takewhile(lambda _: not until.passed, named)
    found: dict[int, Evidence] = {}
    for done, (piece, evidence) in enumerate(scheduler.run(examine, pieces), 1):
        progress("readings", before + done, before + len(interpretations))
        found[piece.span.first] = evidence
    for place in sorted(found):
        if found[place].is_known:
            yield Examined(interpretations[place], found[place])
