"""The report on whether a specification is right: which reading does best, and what to change to say it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import ClassVar

from viatool.report.diagnoses.record import DiagnosisRecord, EditRecord, ReadingRecord
from viatool.report.document import Annotated, Tabled
from viatool.report.numbers import counted, significant
from viatool.report.sections import Annotation, Facts, Headline, Section, Share, Table, Tally

COLUMNS = ("reading", "changes", "part", "total", "better", "worse", "chance", "as_good", "edits")
_SHOWN = 12
"""Most readings in a table for people."""
_RARE = 1e-6
"""Below which a probability is not written out."""


class DiagnosisDocument(Annotated, Tabled):
    """A diagnosis; its JSON tells all that the formats of text need."""

    RECORD = DiagnosisRecord
    SIGN = "readings"
    WHAT = "a diagnosis"
    SUBJECTS = "readings"
    EMPTY = "no readings to decide on"
    COMMAND = "doctor"
    PLAIN = "A report in JSON holds words and figures alone: --output html of viatool doctor shows what was driven."
    RATES: ClassVar[Mapping[str, str]] = {
        "overall": "share of scenarios in which the policy as specified reaches the goal, or of recorded commands that "
        "it gives",
        "best": "the same of the best reading",
    }

    record: DiagnosisRecord

    @property
    def specified(self) -> ReadingRecord:
        """Return the policy's own specification."""
        return self.record.readings[self.record.specified]

    @property
    def best(self) -> ReadingRecord:
        """Return the reading that does best, with the fewest changes."""
        return self.record.readings[self.record.best]

    @property
    def does(self) -> str:
        """Return what a policy does that is read well."""
        return "reaches the goal" if self.record.method == "driven" else "explains the recorded command"

    @property
    def finding(self) -> str:
        """Return what was found, in a sentence."""
        best, own = self.best, self.specified
        both = f"{_told(best)} against {_told(own)} as specified"
        match self.record.verdict:
            case "another":
                found = f"another reading is clearly better: {best.name} ({both})"
                return f"{found}, though it is not good either" if _is_poor(best) else found
            case "undecided":
                return f"another reading seems better: {best.name} ({both}), but that may be chance"
            case "specified":
                found = f"no reading is better than the specification ({_told(own)})"
                return (
                    f"{found}, but {counted(len(self.alike), 'other')} cannot be told from it"
                    if self.alike
                    else found
                )
            case _:
                return f"no reading is good: the specification is as good as any ({_told(own)})"

    @property
    def advice(self) -> str:
        """Return what to do, as one imperative."""
        match self.record.verdict:
            case "another":
                return f"change the specification: {'; '.join(map(edit_in_words, self.best.edits))}{self._about_rays}"
            case "undecided":
                return "try more scenarios (--scenarios) before you change the specification"
            case "specified":
                return "keep the specification"
            case _:
                return "look for a mistake that no reading mends (robot, control interval, goal), or a weak policy"

    @property
    def headline(self) -> Headline:
        """Return how the policy does as specified."""
        share = self.specified.share
        return Headline(share.percentage(), f"of {self._things(share)}, as specified", share.of())

    def _things(self, share: Share) -> str:
        if self.record.method == "driven":
            return f"{counted(share.total, 'scenario')} reach the goal"
        return f"{counted(share.total, 'recorded command')} explained"

    @property
    def terms(self) -> Mapping[str, str]:
        """Return what the readings were tried on."""
        return {"method": self.record.method, "tried on": self.record.source, "seed": str(self.record.seed)}

    @property
    def subject(self) -> Sequence[str]:
        """Return what the readings were tried on, and how many there were."""
        return [self.record.source, counted(len(self.record.readings), "reading")]

    @property
    def sections(self) -> Sequence[Section]:
        """Return the finding, what to change, and the readings."""
        change = [] if self.change is None else [self.change]
        return [Facts("Finding", self.facts), *change, self._readings()]

    @property
    def facts(self) -> tuple[tuple[str, str], ...]:
        """Return what was found, what to do, and which readings cannot be told apart."""
        facts = [("found", self.finding), ("advice", self._short_advice)]
        again = self.record.again
        if again is not None:
            shares = (again.driven.success.share, again.specified.success.share)
            told = f"{shares[0].of()} against {shares[1].of()} as specified"
            facts.append(("driven again", f"{again.name}: {told}, on scenarios that did not choose it"))
        if self.record.stopped:
            facts.append(("not tried", self.record.stopped))
        if self.alike:
            told = ", ".join(self.alike[:_SHOWN]) + (", ..." if len(self.alike) > _SHOWN else "")
            facts.append(("not told apart", f"{told}: {self._as_good}"))
        return tuple(facts)

    @property
    def alike(self) -> list[str]:
        """Return the names of the readings that do as well as the best, as far as can be told."""
        return [one.name for one in self.record.readings if one.as_good and one is not self.best]

    @property
    def _as_good(self) -> str:
        many = len(self.alike) > 1
        if self.record.method == "driven":
            drive = "these readings drive" if many else "this reading drives"
            return f"{drive} as well, and only a recording of commands can tell which is right (--trajectory)"
        return (
            f"{'these readings explain' if many else 'this reading explains'} the recorded commands as well"
        )

    @property
    def change(self) -> Table | None:
        """Return what to write in the specification, where a reading is named instead of it."""
        edits = [(edit.key, edit.now or "leave it out", edit.was or "nothing") for edit in self.best.edits]
        if not edits or self.record.verdict not in ("another", "undecided"):
            return None
        return Table(("key", "write", "instead of"), tuple(edits), title="In the specification", texts=2)

    @property
    def _short_advice(self) -> str:
        if self.record.verdict == "another":
            return f"change {counted(len(self.best.edits), 'key')} of the specification{self._about_rays}"
        return self.advice

    @property
    def _about_rays(self) -> str:
        rays = any(".lidar." in edit.key.partition(".")[2] for edit in self.best.edits)
        return " (docs/lidar.md draws what they mean)" if rays else ""

    def _readings(self) -> Table:
        """Return the readings, the best first; the specification is always among them."""
        chosen = self.record.readings[:_SHOWN]
        if self.specified not in chosen:
            chosen = [*chosen, self.specified]
        rows = tuple(self.row(reading) for reading in chosen)
        left = len(self.record.readings) - len(chosen)
        remark = f"the best {len(chosen)} of {len(self.record.readings)}" if left else ""
        return Table(self.head, rows, title="Readings", remark=remark)

    @property
    def head(self) -> tuple[str, ...]:
        """Return what the figures of a reading are."""
        against = ("better/worse", "chance")
        if self.record.method == "driven":
            return "reading", "goals", "95 %", "collide", "time out", *against
        return "reading", "explained", "median", "90 %", *against

    def row(self, reading: ReadingRecord) -> tuple[str, ...]:
        """Return the figures of a reading."""
        name = f"{reading.name} *" if reading is self.best else reading.name
        chance = significant(reading.chance, 2) if reading.chance >= _RARE else f"< {_RARE:g}"
        against = (f"{reading.better}/{reading.worse}", chance)
        if reading is self.specified:
            against = ("", "")
        if reading.driven is not None:
            low, high = (f"{100.0 * end:.0f}" for end in reading.driven.success.interval)
            others = (reading.driven.collision, reading.driven.timeout)
            ended = [one.share.percentage(0) for one in others]
            return name, reading.share.of("/"), f"{low} to {high}", *ended, *against
        assert reading.compared is not None
        found = reading.compared.difference
        shares = [f"{100.0 * part:.3g} %" for part in (found.median, found.most)]
        return name, reading.share.percentage(1), *shares, *against

    @property
    def assumptions(self) -> Mapping[str, str]:
        """Return what the finding rests on."""
        tried = "readings with one change, and with more as long as none is good; a mistake that is none of them stays"
        alike = "readings that drive alike, such as commands that are clipped either way, are not told apart"
        return {**self.terms, "tried": tried, "told apart": alike}

    @property
    def rates(self) -> Mapping[str, Share]:
        """Return how the specification and the best reading do."""
        return {"overall": self.specified.share, "best": self.best.share}

    @property
    def size(self) -> int:
        """Return how many readings were tried."""
        return len(self.record.readings)

    @property
    def tallies(self) -> Sequence[Tally]:
        """Return how many scenarios or states are well as specified and under the best reading."""
        return [
            Tally(name, share.part, share.of(), 1)
            for name, share in (("as specified", self.specified.share), ("best reading", self.best.share))
        ]

    def annotations(self) -> Sequence[Annotation]:
        """Return a warning unless the specification does as well as any reading, and well."""
        if self.record.verdict == "specified":
            return []
        return [Annotation("warning", "the specification", f"{self.finding}; {self.advice}")]

    def columns(self) -> Sequence[str]:
        """Return what a row tells of its reading."""
        return COLUMNS

    def rows(self) -> Iterator[Sequence[object]]:
        """Yield a row for each reading."""
        for one in self.record.readings:
            share, told = one.share, "; ".join(map(edit_in_words, one.edits))
            figures = (share.part, share.total, one.better, one.worse, one.chance, one.as_good)
            yield [one.name, len(one.changes), *figures, told]


def edit_in_words(edit: EditRecord) -> str:
    """Write one edit in words."""
    if not edit.now:
        return f"leave out {edit.key}"
    return f"{edit.key}: {edit.now}" + (f" instead of {edit.was}" if edit.was else "")


def _told(reading: ReadingRecord) -> str:
    return f"{reading.share.percentage(0)}, {reading.share.of()}"


def _is_poor(reading: ReadingRecord) -> bool:
    return 2 * reading.share.part < reading.share.total
