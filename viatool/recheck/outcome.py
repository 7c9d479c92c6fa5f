"""What was found of an evidence folder."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from numpy.typing import NDArray

CONFIRMED, CONTRADICTED, UNREADABLE, NOTHING = 0, 1, 2, 5
_NAMED = 20


class UnreadableFolder(Exception):  # noqa: N818  # the name says what is wrong
    """The folder is no evidence folder, or one of another version."""


@dataclass
class Outcome:
    """What is confirmed, contradicted, not confirmed, and not rechecked at all.

    Parameters
    ----------
    digest : str
        sha256 of the manifest: a folder in which anything was changed has another one.
    confirmed, contradicted, unconfirmed, not_rechecked : list of str
        One line for each finding.
    verdicts : int
        How many verdicts were confirmed one by one.
    """

    digest: str = ""
    confirmed: list[str] = field(default_factory=list)
    contradicted: list[str] = field(default_factory=list)
    unconfirmed: list[str] = field(default_factory=list)
    not_rechecked: list[str] = field(default_factory=list)
    verdicts: int = 0

    @property
    def code(self) -> int:
        """Return the exit code: 1 contradicted or not confirmed, 5 if no verdict could be rechecked, else 0."""
        if self.contradicted or self.unconfirmed:
            return CONTRADICTED
        return CONFIRMED if self.verdicts else NOTHING

    @property
    def result(self) -> str:
        """Return the last line."""
        if self.contradicted:
            told = f"contradicted in {_things(self.contradicted)}"
        elif self.unconfirmed:
            told = f"not confirmed in {_things(self.unconfirmed)}"
        elif self.verdicts:
            told = f"confirmed, {self.verdicts:,} verdicts one by one"
        else:
            told = "no verdict could be rechecked"
        return told + (f"; not rechecked: {_things(self.not_rechecked)}" if self.not_rechecked else "")

    def lines(self) -> list[str]:
        """Return everything that is to be told, the result last."""
        parts = {
            "confirmed": self.confirmed,
            "not rechecked": self.not_rechecked,
            "not confirmed": self.unconfirmed,
            "contradicted": self.contradicted,
        }
        told = [f"{name}: {line}" for name, lines in parts.items() for line in lines]
        return [f"manifest sha256: {self.digest}", *told, f"result: {self.result}"]

    def expect(self, holds: bool, message: str) -> None:
        """Note a contradiction where something does not hold."""
        if not holds:
            self.contradicted.append(message)


def _things(lines: Sequence[str]) -> str:
    return f"{len(lines)} thing{'s' * (len(lines) != 1)} named above"


def numbered(rows: Sequence[int] | NDArray[Any]) -> str:
    """Write the numbers of states, the first of many."""
    names = ", ".join(str(int(row)) for row in rows[:_NAMED])
    return (
        names + (f" and {len(rows) - _NAMED:,} more" if len(rows) > _NAMED else "") if len(rows) else "none"
    )
