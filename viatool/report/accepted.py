"""Accepted findings: what somebody has looked at and answers for, until a date, so that the gate does not fail for it.

An accepted finding changes no verdict and no rate. It is only not counted by ``--fail-under``, ``--max-unsafe`` and
``--max-unknown``, is named wherever the gate is shown, and fails the run when its time is over or nothing is there that
it accepts.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import date
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator
from typing_extensions import Self

from viatool.errors import ConfigurationError
from viatool.report.document import Document, Located
from viatool.report.numbers import counted
from viatool.report.sections import Check, Finding, Key
from viatool.toml_text import read_toml, toml_key, toml_value
from viatool.typed_toml import validated_toml

_COVERS = {"unsafe": ("unsafe", "unknown"), "unknown": ("unknown",)}


class Acceptance(BaseModel):
    """A finding that somebody answers for: which one, why, and until when."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    cell: str = Field(
        default="",
        description="in a project file: the cell in which it is, or the first words of the names of several, each of "
        "which must have it",
    )
    verdict: Literal["unsafe", "unknown"] = Field(
        description="the worst that is accepted: what is only accepted as unknown counts again when it is refuted"
    )
    state: Annotated[int, Field(ge=0, strict=True)] | None = Field(
        default=None, description="of verify and margin: the number of the state"
    )
    scenario: str | None = Field(
        default=None, description="the scenario: a mission, or all of a drive's states in it"
    )
    place: str | None = Field(
        default=None,
        description="the place as SARIF names it, such as 'past/3.200' for a state, or the half metre of a certificate",
    )
    at_most: Annotated[int, Field(ge=1, strict=True)] = Field(
        default=1,
        alias="at-most",
        description="how many states, missions or cells it accepts; where more are found, none is accepted",
    )
    reason: str = Field(min_length=1, description="why it is accepted")
    expires: date = Field(strict=True, description="the last day on which it is accepted, a TOML date")

    @model_validator(mode="after")
    def _names_one(self) -> Self:
        if sum(name is not None for name in (self.state, self.scenario, self.place)) != 1:
            raise ValueError("names its finding by one of 'state', 'scenario' and 'place'")
        if not self.reason.strip():
            raise ValueError("says no reason")
        return self

    @property
    def words(self) -> str:
        """Return which finding it is about."""
        named = {"state": self.state, "scenario": self.scenario, "place": self.place}
        name, value = next((name, value) for name, value in named.items() if value is not None)
        return f"{self.verdict} {name} {value}"

    def is_of(self, finding: Finding) -> bool:
        """Tell whether it accepts a finding."""
        if finding.verdict not in _COVERS[self.verdict] or not finding.takes:
            return False
        if self.state is not None:
            return finding.state == self.state
        if self.place is not None:
            return finding.place == self.place
        return finding.scenario == self.scenario


class AcceptedFile(BaseModel):
    """A file of accepted findings."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    accepted: tuple[Acceptance, ...] = ()


@dataclass(frozen=True)
class Settled:
    """What accepted findings change about a gate.

    Parameters
    ----------
    uncounted : mapping
        How many of the failures behind each rate and each limit are accepted, by name.
    checks : tuple of Check
        What became of each accepted finding.
    accepted : frozenset of Key
        Which parts of the run they are.
    """

    uncounted: Mapping[str, int] = field(default_factory=dict)
    checks: tuple[Check, ...] = ()
    accepted: frozenset[Key] = frozenset()

    def excuses(self, finding: Finding, name: str) -> bool:
        """Return whether one of the rates or limits does not count a finding, as it is accepted."""
        return finding.key in self.accepted and name in finding.takes


NOTHING_ACCEPTED = Settled()


def load_accepted(path: Path) -> tuple[Acceptance, ...]:
    """Read a file of accepted findings.

    Raises
    ------
    ConfigurationError
        If it cannot be read or a field is wrong; names file, line and field.
    """
    return validated_toml(read_toml(path), AcceptedFile).accepted


def accepted_text(accepted: Iterable[Acceptance]) -> str:
    """Return the file that `load_accepted` reads."""
    tables = (one.model_dump(by_alias=True, exclude_none=True) for one in accepted)
    return "\n".join(
        "\n".join(
            ["[[accepted]]", *(f"{toml_key(name)} = {toml_value(value)}" for name, value in table.items())]
        )
        + "\n"
        for table in tables
    )


def settle(
    accepted: Sequence[Acceptance], document: Document, today: date, weak: Sequence[Finding] = ()
) -> Settled:
    """Find what is accepted among the findings of a document.

    Parameters
    ----------
    accepted : sequence of Acceptance
        What is accepted.
    document : Document
        What was found.
    today : date
        Decides what has expired.
    weak : sequence of Finding
        What is found besides, because a gate asks for an error that not everything survives.

    Raises
    ------
    ConfigurationError
        If such a document has no findings to accept.
    """
    if not accepted:
        return NOTHING_ACCEPTED
    if not isinstance(document, Located):
        raise ConfigurationError(
            f"findings of {document.WHAT} cannot be accepted",
            f"accept them where they are found, at viatool {document.COMMAND}",
        )
    findings, _ = document.findings()
    matches: list[list[Finding]] = [[] for _ in accepted]
    for finding in (*findings, *weak):
        for one, found in zip(accepted, matches, strict=True):
            if one.is_of(finding):
                found.append(finding)
    decided = [_decide(one, found, today) for one, found in zip(accepted, matches, strict=True)]
    kept = {
        id(finding): finding
        for found, check in zip(matches, decided, strict=True)
        if check.passed
        for finding in found
    }
    uncounted: Counter[str] = Counter()
    for finding in kept.values():  # once, however many accept it
        uncounted.update(finding.takes)
    return Settled(uncounted, tuple(decided), frozenset(finding.key for finding in kept.values()))


def _decide(one: Acceptance, found: Sequence[Finding], today: date) -> Check:
    """Return whether one is in force, and why."""
    size = sum(finding.size for finding in found)
    condition = f"accepted until {one.expires}: {one.words}"
    if not found:
        return Check(
            condition,
            False,
            "there is no such finding",
            hint="take it out of the accepted findings, or correct it",
            unfounded=True,
        )
    if today > one.expires:
        return Check(
            condition,
            False,
            f"expired, so {counted(size, 'finding')} of it counts again: {one.reason}",
            failing=tuple(found),
        )
    if size > one.at_most:
        return Check(
            condition,
            False,
            f"{counted(size, 'finding')} where at most {one.at_most} may be: {one.reason}",
            failing=tuple(found),
        )
    return Check(condition, True, f"{counted(size, 'finding')}: {one.reason}")
