"""The report on margins: which errors contested states survive, the weakest first, and what decides."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from pathlib import PurePath
from typing import TYPE_CHECKING, ClassVar

from viatool.errors import ConfigurationError
from viatool.report.document import Annotated, Cased, Document, Drawn, Explained, Explorable, Located, Tabled
from viatool.report.margins.explained import explain_margin
from viatool.report.margins.record import ContestedStateRecord, MarginsRecord, PolicyMarginsRecord
from viatool.report.margins.tables import (
    at_stake,
    certified,
    decides,
    margin_sections,
    refuted,
    survived,
    varied_in_words,
)
from viatool.report.numbers import MISSING, count, counted, down
from viatool.report.paired import apart
from viatool.report.sections import (
    Annotation,
    Case,
    Check,
    Count,
    Finding,
    Headline,
    Key,
    Rules,
    Section,
    Share,
    Survivor,
    Table,
    Tally,
)
from viatool.report.verified import Verified
from viatool.report.wording import describe_eps, describe_value

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLUMNS = (
    "policy",
    "kind",
    "state",
    "scenario",
    "time",
    "x",
    "y",
    "theta",
    "distance",
    "certified",
    "refuted",
    "decides",
)
_UNPROVED, _WEAK = "unproved-state", "weak-state"


class MarginsDocument(Verified, Explained, Cased, Annotated, Located, Tabled, Drawn, Explorable):
    """Margins; their JSON tells all that most formats need."""

    RECORD = MarginsRecord
    SIGN = "margins"
    WHAT = "a report of margins"
    SUBJECTS = "contested states"
    EMPTY = "no contested states to decide on: no verdict depended on the policy"
    COMMAND = "margin"
    RATES: ClassVar[Mapping[str, str]] = {}
    RADII: ClassVar[Mapping[str, str]] = {"margin": "error that every contested state is proved to survive"}
    FINDING_RULES: ClassVar[Rules] = {
        _UNPROVED: ("warning", "The state is not proved safe even at an error of 0."),
        _WEAK: ("note", "The state is not proved safe at the error that the gate asks for."),
    }

    ASKED = ("state", "close")

    record: MarginsRecord

    @property
    def failing(self) -> Table:
        """Return the states that are not proved even at an error of 0, those that were seen to fail first."""
        found = sorted(self._unproved(), key=lambda one: one[1].refuted != 0.0)
        rows = tuple(
            (self._name(name, one), one.scenario, f"{one.time:.2f}", self._why(one)) for name, one in found
        )
        return Table(("what", "scenario", "time [s]", "why"), rows, texts=1)

    def _why(self, state: ContestedStateRecord) -> str:
        if state.refuted == 0.0:
            return "fails without any error: the policy has to act otherwise"
        return f"not proved at an error of 0, refuted {refuted(state.refuted, self.record.varied)}"

    def explain(self, option: str, subject: int) -> str:
        """Return what a state, or a close place, survives under each policy, by its number."""
        close = option == "close"
        told = [
            explain_margin(self._name(name, one), one, self.record)
            for name, one in self._states()
            if one.close == close and one.state == subject
        ]
        if told:
            return "\n\n".join(told)
        what = "close place" if close else "state"
        raise ConfigurationError(
            f"there is no contested {what} {subject} in the report: of others no verdict depends on the policy",
            "viatool report lists the weakest, and csv all of them",
        )

    @property
    def names(self) -> Sequence[str]:
        """Return how each policy is called: by its file, or by its path where two files have one name."""
        paths = [part.policy.path for part in self.record.margins]
        short = [PurePath(path).name for path in paths]
        return short if len(set(short)) == len(short) else paths

    @property
    def parts(self) -> Mapping[str, PolicyMarginsRecord]:
        """Return what was found of each policy, by how it is called."""
        return dict(zip(self.names, self.record.margins, strict=True))

    @property
    def headline(self) -> Headline:
        """Return what half of the contested states survive, and the weakest one, behind what was at stake."""
        parts = self.record.margins
        if not self.size:
            total = counted(sum(part.states for part in parts), "state")
            return Headline("", f"none of {total} is contested", stake="no verdict depended on the policy")
        return Headline(
            "",
            self._of_each(survived),
            stake=f"the policy was put to the test in {self._of_each(at_stake)}",
        )

    def _of_each(self, told: Callable[[PolicyMarginsRecord], str]) -> str:
        """Write what is told of each policy, behind its name if there are several."""
        texts = [told(part) for part in self.record.margins]
        if len(texts) == 1:
            return texts[0]
        return "; ".join(f"{name}: {text}" for name, text in zip(self.names, texts, strict=True))

    @property
    def terms(self) -> Mapping[str, str]:
        """Return what varies, criterion and arithmetic, and what readings err that do not vary."""
        told = dict(super().terms)
        return {"varied": self.varied, "eps besides": told.pop("eps"), **told}

    @property
    def varied(self) -> str:
        """Return in words what varies, and how far."""
        return varied_in_words(self.record.varied)

    @property
    def subject(self) -> Sequence[str]:
        """Return which policies are beside, what varies and the criterion."""
        others = self.names[1:]
        beside = [f"beside {', '.join(others)}"] if others else []
        return [*beside, *self.asked]

    @property
    def asked(self) -> Sequence[str]:
        """Return what varies, what does not, and the criterion."""
        stays = self.record.eps
        besides = [] if stays == 0.0 else [f"eps besides {describe_eps(stays)}"]
        return [self.varied, *besides, f"criterion {self.record.criterion}"]

    @property
    def sections(self) -> Sequence[Section]:
        """Return quantiles, and for each policy its weakest states and what decides about them."""
        return margin_sections(self.record.varied, self.parts)

    @property
    def assumptions(self) -> Mapping[str, str]:
        """Return what the margins rest on."""
        record = self.record
        origins = dict.fromkeys(part.origin for part in record.margins)
        return {
            **super().assumptions,
            "states": "; ".join(origins),
            **({"close places": told} if (told := self._close) else {}),
            **record.assumptions,
            "engine": describe_value(record.engine),
        }

    @property
    def _close(self) -> str:
        """Return how many close places there are, or why none."""
        each = [part.close for part in self.record.margins]
        told = (
            f"none: {one.reason}" if one.reason else count(one.states) if one.states else "" for one in each
        )
        return "; ".join(dict.fromkeys(filter(None, told)))

    @property
    def settings(self) -> Mapping[str, str]:
        """Return what a comparison has to agree in, which of the two engines ran left out."""
        engine = self.record.engine
        asked = {k: v for k, v in engine.items() if k != "passes"} if isinstance(engine, dict) else engine
        return {**super().settings, "engine": describe_value(asked)}

    @property
    def rates(self) -> Mapping[str, Share]:
        """Return no rates: margins are errors."""
        return {}

    @property
    def survived(self) -> Mapping[str, Sequence[Survivor]]:
        """Return which error every contested state survives, the weakest first; nothing if a policy has none."""
        if not all(part.tested for part in self.record.margins):
            return {}
        found = [
            Survivor(self._name(name, one), one.certified, self._finding(name, one), one.refuted)
            for name, one in self._states()
        ]
        return {"margin": sorted(found, key=lambda one: -1.0 if one.error is None else one.error)}

    @property
    def outcomes(self) -> Mapping[str, float]:
        """Return which error every contested state of a single policy survives, -1 for none, by where it is."""
        states = [state for _, state in self._states()] if len(self.names) == 1 else []
        places = (f"{state.scenario} {state.pose}" for state in states)
        survived = (-1.0 if state.certified is None else state.certified for state in states)
        return dict(zip(apart(places), survived, strict=True))

    def _states(self) -> Iterator[tuple[str, ContestedStateRecord]]:
        for name, part in self.parts.items():
            for state in part.contested_states:
                yield name, state

    def _name(self, policy: str, state: ContestedStateRecord) -> str:
        return f"{_kind(state)} {state.state}" + (f" of {policy}" if len(self.names) > 1 else "")

    @property
    def size(self) -> int:
        """Return how many states are contested, of all policies."""
        return sum(part.tested for part in self.record.margins)

    @property
    def limited(self) -> Mapping[str, Count]:
        """Return how many driven states are contested, of the policy of which the fewest are."""
        return {"contested": Count(min(part.contested for part in self.record.margins), "contested")}

    @property
    def tallies(self) -> Sequence[Tally]:
        """Return how many states are contested, how many of them fail without an error, and what they survive."""
        states = [state for _, state in self._states()]
        bare = sum(state.certified is None for state in states)
        broken = sum(state.refuted == 0.0 for state in states)
        return [
            Tally("contested states", len(states), count(len(states))),
            Tally("not proved at an error of 0", bare, count(bare), -1),
            Tally("refuted at an error of 0", broken, count(broken), -1),
            *_errors("proved", [state.certified for state in states]),
        ]

    def new_failures(self, baseline: Document) -> Sequence[Check]:
        """Decide whether the weakest state survives what the weakest one did, and no more fail without an error."""
        if not isinstance(baseline, MarginsDocument):
            return ()
        old, new = (document.survived.get("margin", ()) for document in (baseline, self))
        if not (old and new):
            return ()
        before, now = (-1.0 if found[0].error is None else found[0].error for found in (old, new))
        figures = f"{certified(new[0].error)} ({new[0].name}), was {certified(old[0].error)}"
        failing = tuple(one.finding for one in new if (-1.0 if one.error is None else one.error) < before)
        least = Check("least margin not below the baseline", now >= before, figures, failing=failing)
        was, held = (Share(sum(one.error is not None for one in found), len(found)) for found in (old, new))
        return [least, _not_below(was, held, tuple(one.finding for one in new if one.error is None))]

    def cases(self) -> Sequence[Case]:
        """Return every contested state; whether its margin is enough only a gate says."""
        return [
            Case(
                "viatool.margin",
                self._name(name, state),
                figures=self._tell(state),
                subjects=(_key(name, state),),
            )
            for name, state in self._states()
        ]

    def annotations(self) -> Sequence[Annotation]:
        """Return a warning for each state that is not proved even at an error of 0."""
        return [
            Annotation(
                "warning",
                f"{self._name(name, state)} is not proved even at an error of 0",
                self._tell(state),
                (_key(name, state),),
            )
            for name, state in self._unproved()
        ]

    def findings(self) -> tuple[Iterable[Finding], int]:
        """Return the states that are not proved even at an error of 0."""
        found = [self._finding(name, state) for name, state in self._unproved()]
        return found, len(found)

    def _finding(self, name: str, state: ContestedStateRecord) -> Finding:
        """Return a state as what it is if it survives too little."""
        called, close = self._name(name, state), state.close
        x, y, heading = state.pose
        where = f"{x:.3f},{y:.3f},{heading:.3f}" if close else f"{state.time:.3f}"
        return Finding(
            _UNPROVED if state.certified is None else _WEAK,
            f"{called[0].upper()}{called[1:]}: {self._tell(state)}.",
            f"{state.scenario}/{where}",
            f"{name}/{state.scenario}/{state.time:.3f}/{state.pose}",
            scenario=f"beside {state.scenario}" if close else state.scenario,
            state=None if close else state.state,
            subject=_key(name, state),
        )

    def _unproved(self) -> list[tuple[str, ContestedStateRecord]]:
        return [(name, state) for name, state in self._states() if state.certified is None]

    def _tell(self, state: ContestedStateRecord) -> str:
        x, y, heading = state.pose
        return (
            f"scenario {state.scenario} at {state.time:.2f} s, x {x:.3f} m, y {y:.3f} m, heading {heading:.3f} rad, "
            f"{state.distance:.3f} m from something; proved {certified(state.certified)}, refuted "
            f"{refuted(state.refuted, self.record.varied)}"
        )

    def columns(self) -> Sequence[str]:
        """Return what a row tells of its state, in metres, radians and the unit of what varies."""
        return COLUMNS

    def rows(self) -> Iterator[Sequence[object]]:
        """Yield a row for each contested state, the weakest first."""
        for name, state in self._states():
            errors = ("" if error is None else f"{error:.17g}" for error in (state.certified, state.refuted))
            told = decides(state.decides, len(state.decides))
            where = (state.scenario, state.time, *state.pose, state.distance)
            yield [name, _kind(state), state.state, *where, *errors, told]

    def row_keys(self) -> Iterator[Collection[Key]]:
        """Yield which contested state each row is of."""
        return ((_key(name, state),) for name, state in self._states())

    def draw(self) -> Figure:
        """Return the proved and the refuted share of the contested states against the error."""
        from viatool.report.margins.figure import draw_margins

        return draw_margins(self)

    def page(self, checks: Sequence[Check]) -> str:
        """Return the curve and the states as one page."""
        from viatool.report.margins.html.page import render_page

        return render_page(self, checks)


def state_key(policy: str, number: int, *, close: bool) -> Key:
    """Return which contested state of which policy is meant."""
    return f"{policy}/{'close' if close else 'driven'}", number


def _key(policy: str, state: ContestedStateRecord) -> Key:
    return state_key(policy, state.state, close=state.close)


def _kind(state: ContestedStateRecord) -> str:
    return "close place" if state.close else "state"


def _errors(what: str, errors: Sequence[float | None]) -> list[Tally]:
    """Return the least and the middle of errors as figures of a comparison; none counts as less than any."""
    known = sorted(-1.0 if error is None else error for error in errors)
    some = {"least": known[:1], "median": known[(len(known) - 1) // 2 :][:1]}
    return [
        Tally(f"{name} error {what}", found[0], "none" if found[0] < 0.0 else down(found[0]), 1)
        for name, found in some.items()
        if found
    ] or [Tally(f"{name} error {what}", 0, MISSING) for name in some]


def _not_below(was: Share, held: Share, bare: tuple[Finding, ...]) -> Check:
    """Decide whether as large a share of the contested states is proved at an error of 0 as before."""
    passed = held.part * was.total >= was.part * held.total
    figures = f"{held.percentage(4)} ({held.of()}), was {was.percentage(4)}"
    failing = () if passed else bare
    return Check("share proved at an error of 0 not below the baseline", passed, figures, failing=failing)
