"""What was found of a specification, as data: the typed form of its JSON."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from viatool.report.records import Amount, Count, Fraction, ReportPart, RunRecord
from viatool.report.sections import Share
from viatool.report.simulations.record import EpisodeCount


class ChangeRecord(ReportPart):
    """One thing that is read in another way: what it is about, and how it is read."""

    family: str
    words: str


class EditRecord(ReportPart):
    """One key of the specification: what to write there (if empty, leave it out), and what is there now."""

    key: str
    now: str
    was: str


class DrivenRecord(ReportPart):
    """How the scenarios ended."""

    success: EpisodeCount
    collision: EpisodeCount
    timeout: EpisodeCount


class DifferenceRecord(ReportPart):
    """How far commands are from recorded ones: the median, and what nine of ten states stay within."""

    median: Amount
    most: Amount


class ComparedRecord(ReportPart):
    """How many states were compared; differences in ranges of the actions, the largest of a command, and by action."""

    states: Count
    explained: Count
    difference: DifferenceRecord
    actions: dict[str, DifferenceRecord]


class ReadingRecord(ReportPart):
    """One reading: what it changes, how it fares, and how it fares against the specification.

    `better` and `worse` count the scenarios or states in which it alone does better than the specification, and worse;
    `chance` is the probability of so uneven a count among equals (two-sided sign test). `as_good` says that it cannot
    be told from the best one.
    """

    name: str
    changes: list[ChangeRecord]
    edits: list[EditRecord]
    driven: DrivenRecord | None
    compared: ComparedRecord | None
    better: Count
    worse: Count
    chance: Fraction
    as_good: bool

    @property
    def share(self) -> Share:
        """Return in how many of the scenarios the goal is reached, or of the states the command is explained."""
        if self.driven is not None:
            return self.driven.success.share
        assert self.compared is not None
        return Share(self.compared.explained, self.compared.states)

    @model_validator(mode="after")
    def _found(self) -> ReadingRecord:
        if (self.driven is None) == (self.compared is None):
            raise ValueError(f"reading '{self.name}' was either driven or compared")
        return self


class RepeatRecord(ReportPart):
    """Scenarios that did not choose a reading: how it fares there, and how the specification does."""

    name: str
    driven: DrivenRecord
    specified: DrivenRecord
    better: Count
    worse: Count
    chance: Fraction


class DiagnosisRecord(RunRecord):
    """All that was found: the readings, the best first, and which of them is the specification and which the best.

    `stopped` says why readings with more changes were not all tried, though none is good.
    """

    method: Literal["driven", "recorded"]
    source: str
    seed: int
    verdict: Literal["specified", "another", "undecided", "none"]
    readings: Annotated[list[ReadingRecord], Field(min_length=1)]
    specified: Count
    best: Count
    again: RepeatRecord | None = None
    stopped: str = ""
    seconds: Amount

    @model_validator(mode="after")
    def _numbered(self) -> DiagnosisRecord:
        for name in ("specified", "best"):
            if getattr(self, name) >= len(self.readings):
                raise ValueError(f"{name} is {getattr(self, name)} of {len(self.readings)} readings")
        return self

    @property
    def stages(self) -> dict[str, float]:
        """Return nothing: there is one stage."""
        return {}

    @property
    def total_seconds(self) -> float:
        """Return the wall time."""
        return self.seconds
