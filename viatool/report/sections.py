"""What documents are made of: sections for people, cases and findings for programs, and decided conditions."""

from __future__ import annotations

from collections.abc import Collection, Hashable, Mapping
from dataclasses import dataclass, field
from typing import TypeAlias

from viatool.report.numbers import count, percentage

Key: TypeAlias = tuple[str, Hashable]
"""Which part of a run is meant, among all of its report: a table, or a kind of part, and the place in it."""


@dataclass(frozen=True)
class Finding:
    """A place that is not safe.

    Parameters
    ----------
    rule : str
        Which rule it is of.
    text : str
        What is said.
    place : str
        Where, in words.
    identity : str
        What makes it the same finding in the next run.
    verdict : str
        unsafe or unknown; what is refuted is unsafe.
    scenario : str
        Of which scenario it is.
    state : int, optional
        The number of the state that it is.
    takes : mapping
        How much is taken from the part of each rate, and counted by each limit, because of it, by the names that a gate
        has for them; a finding without is none that a gate counts.
    size : int
        How many states, missions or cells it is.
    subject : Key, optional
        Which part of this run it is of; its identity, if that tells it from all others.
    """

    rule: str
    text: str
    place: str
    identity: str
    verdict: str = ""
    scenario: str = ""
    state: int | None = None
    takes: Mapping[str, int] = field(default_factory=dict)
    size: int = 1
    subject: Key | None = None

    @property
    def key(self) -> Key:
        """Return which part of this run it is of."""
        return ("", self.identity) if self.subject is None else self.subject


@dataclass(frozen=True)
class Check:
    """One decided condition of a gate.

    Parameters
    ----------
    condition : str
        What was asked for.
    passed : bool
        Whether it holds.
    figures : str
        What decided it.
    empty : bool
        There was nothing to decide on; such a condition never passes.
    hint : str
        What to do then.
    unfounded : bool
        It is about what does not exist, so what was asked is wrong; such a condition never passes either.
    failing : tuple of Finding
        What made it fail.
    waived : bool
        It does not hold, which is reported and fails nothing, as ``--exit-zero`` asks.
    open : bool
        What was left out decides whether it holds; it is not taken to hold.
    may_be_empty : bool
        And whether there is anything to decide on.
    """

    condition: str
    passed: bool
    figures: str
    empty: bool = False
    hint: str = "evaluate more scenarios, or gate on another rate"
    unfounded: bool = False
    failing: tuple[Finding, ...] = ()
    waived: bool = False
    open: bool = False
    may_be_empty: bool = False

    @property
    def outcome(self) -> str:
        """Return passed, warning (if it is waived), failure, or error if nothing could be decided."""
        if self.empty or self.unfounded:
            return "error"
        return "passed" if self.passed else "warning" if self.waived else "failure"

    @property
    def word(self) -> str:
        """Return the outcome for people."""
        if self.open:
            return "NOT DECIDED"
        return {"passed": "passed", "warning": "FAILED, exit 0"}.get(self.outcome, "FAILED")

    @property
    def evidence(self) -> tuple[str, ...]:
        """Return what made it fail, in a sentence each."""
        return tuple(finding.text for finding in self.failing)

    def some_evidence(self, most: int) -> tuple[str, ...]:
        """Return what made it fail, in at most so many sentences and one more that says how many others there are."""
        left = len(self.failing) - most
        told = [finding.text for finding in self.failing[:most]]
        return (*told, *([f"And {count(left)} more."] if left > 0 else []))


@dataclass(frozen=True)
class Share:
    """A part of a whole, both counted; there is no rate where the whole is 0."""

    part: int
    total: int

    def percentage(self, digits: int = 2) -> str:
        """Write the rate, rounded down."""
        return percentage(self.part, self.total, digits)

    def of(self, word: str = " of ") -> str:
        """Write the part and the whole."""
        return f"{count(self.part)}{word}{count(self.total)}"


NOTHING = Share(0, 0)


@dataclass(frozen=True)
class Headline:
    """A rate (none if empty), what it is of, the figures behind it, and before all that what was at stake."""

    rate: str
    rest: str
    figures: str = ""
    stake: str = ""

    def __str__(self) -> str:
        """Write rate and rest."""
        return f"{self.rate} {self.rest}" if self.rate else self.rest


@dataclass(frozen=True)
class Part:
    """One part of a breakdown: a name, its figures, what the name means, and how large the part is.

    `tone` is the verdict whose colour it has: safe, unknown or unsafe, or none.
    """

    name: str
    figures: tuple[str, ...]
    meaning: str
    weight: float
    tone: str = ""


@dataclass(frozen=True)
class Breakdown:
    """What the whole falls into; `head` names the columns of names, figures and meanings."""

    head: tuple[str, ...]
    parts: tuple[Part, ...]


@dataclass(frozen=True)
class Rates:
    """Rates of several things, overall and in groups."""

    title: str
    groups: tuple[str, ...]
    rows: Mapping[str, tuple[Share, ...]]


@dataclass(frozen=True)
class Table:
    """Rows below their head, after a remark; columns after the first are numbers, but the last `texts` ones."""

    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    title: str = ""
    remark: str = ""
    texts: int = 0


@dataclass(frozen=True)
class Facts:
    """Names with their values; a nameless one goes on."""

    title: str
    pairs: tuple[tuple[str, str], ...]


Section: TypeAlias = Breakdown | Rates | Table | Facts


@dataclass(frozen=True)
class Case:
    """One part of a run that passed or did not.

    Parameters
    ----------
    group, name : str
        Unique together within a document.
    outcome : str
        passed, warning (something in it is not safe) or skipped; that it fails only the gate says.
    message, figures : str
        Why, in short and at length.
    evidence : tuple of str
        What is not safe in it, in a sentence each, where it has more to tell of that.
    subjects : collection of Key
        Of what it is: it fails if the gate fails because of one of them.
    """

    group: str
    name: str
    outcome: str = "passed"
    message: str = ""
    figures: str = ""
    evidence: tuple[str, ...] = ()
    subjects: Collection[Key] = ()


@dataclass(frozen=True)
class Annotation:
    """A remark for a log, of level warning or notice; an error is one of whose `subjects` fails the gate."""

    level: str
    title: str
    message: str
    subjects: Collection[Key] = ()


Rules: TypeAlias = Mapping[str, tuple[str, str]]
"""Level and description by the name of the rule."""


@dataclass(frozen=True)
class Count:
    """How many of what, as a gate limits them."""

    number: int
    noun: str


@dataclass(frozen=True)
class Survivor:
    """A subject of a run, in words, the error that it survives (None if not even 0), and what it is if that is low.

    `refuted` is the least error within which it was seen to fail, if it was.
    """

    name: str
    error: float | None
    finding: Finding
    refuted: float | None = None


@dataclass(frozen=True)
class Tally:
    """A figure of a comparison; `better` is +1 if more is better, -1 if less is, 0 if neither."""

    name: str
    number: float
    text: str
    better: int = 0
